"""Numbers that are legal in a rig file but implausible: each is named with its probable cause."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import SE3, CalibrationError, Camera, Rig
from posefuse.core.arrays import Array


@dataclass(frozen=True)
class PlausibleLimits:
    """What cameras and rigs are like; all by judgement, far outside of what is sold.

    Attributes:
        aspect: fx over fy, or the inverse. Anamorphic pixels reach 1.5.
        focal_widths: focal length in image widths, least and most: 150 deg of view to a long tele lens.
        centre_off: distance of the principal point from the middle, in widths and heights, that an image size in the wrong order
            causes; a lens stays below half of it.
        rim: part of the half diagonal inside which a lens must be invertible.
        apart_m: two cameras nearer than this are one.
        common_view: share of a camera's view that others must see, below which inverse poses are tried.
        inverse_ratio: by how much more the cameras must see in common with poses read in another way.
        seen_by_all: share of what the other cameras see together that a camera must see with its pose read in another way.
        upright: cosine between the mean of the images' up and an axis of the world, above which that axis is the world's up.
    """

    aspect: float = 1.6
    focal_widths: tuple[float, float] = (0.13, 60.0)
    centre_off: float = 0.15
    rim: float = 0.6
    apart_m: float = 0.002
    common_view: float = 0.3
    inverse_ratio: float = 1.7
    seen_by_all: float = 0.7
    upright: float = 0.9


LIMITS = PlausibleLimits()
# depths, in distances between cameras, and image points at which a view is sampled
_DEPTHS, _GRID = (0.25, 0.5, 1.0, 2.0), np.linspace(0.1, 0.9, 5)


def require_plausible(where: str, camera: Camera, cropped: bool) -> Camera:
    """The camera; raises CalibrationError for intrinsics that cannot be meant.

    Args:
        cropped: the file states that the images are a part of the sensor, which may lie anywhere about the principal point.
    """
    problem = "" if cropped else _size_problem(camera)
    problem = problem or _matrix_problem(camera)
    problem = problem or ("" if cropped else centre_problem(camera)) or _lens_problem(camera)
    if problem:
        raise CalibrationError(f"{where}: {problem}")
    return camera


def _matrix_problem(camera: Camera) -> str:
    fx, fy, (width, height) = camera.K[0, 0], camera.K[1, 1], camera.size_wh
    if max(fx / fy, fy / fx) > LIMITS.aspect:
        return (
            f"matrix: fx {fx:.1f} and fy {fy:.1f} px differ by more than pixels do; expected a ratio of at most {LIMITS.aspect:g}"
        )
    least, most = LIMITS.focal_widths
    if not least <= fx / max(width, height) <= most:
        return (
            f"matrix: expected a focal length of {least * max(width, height):.0f} to {most * max(width, height):.0f} px"
            f" for images of {width}x{height} px, got {fx:.1f}; is it in millimetres, or of another image size?"
        )
    return ""


def centre_problem(camera: Camera) -> str:
    """What is wrong with a principal point outside of the image; empty where it lies inside."""
    (cx, cy), (width, height) = camera.K[:2, 2], camera.size_wh
    if not (-0.5 <= cx <= width - 0.5 and -0.5 <= cy <= height - 0.5):
        return (
            f"matrix: the principal point ({cx:.0f}, {cy:.0f}) px lies outside of the image of {width}x{height} px;"
            " if images are cut out of the sensor's, state cropped = true for this camera (in a .toml)"
        )
    return ""


def _size_problem(camera: Camera) -> str:
    size, centre = np.array(camera.size_wh, np.float64), camera.K[:2, 2]
    off, swapped = np.abs(centre / size - 0.5), np.abs(centre / size[::-1] - 0.5)
    if (off > LIMITS.centre_off).all() and (swapped < LIMITS.centre_off / 2).all():
        width, height = camera.size_wh
        return (
            f"size: {width}x{height} px with a principal point of ({centre[0]:.0f}, {centre[1]:.0f}) px:"
            f" width and height are swapped, expected [{height}, {width}]"
        )
    return ""


def _lens_problem(camera: Camera) -> str:
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    half = np.array(camera.size_wh) / 2
    rim = half - 0.5 + LIMITS.rim * half * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if np.isfinite(camera.norm_from_px(rim)).all():
        return ""
    return (
        f"distortion: {camera.distortion.tolist()} folds the image well inside of its border;"
        f" are these coefficients of {camera.model}?"
    )


def require_placed(where: str, rig: Rig) -> Rig:
    """The rig; raises CalibrationError for impossible camera positions."""
    if len(rig) < 2:
        return rig
    away = _apart_m(rig)
    if away.max() < LIMITS.apart_m:
        raise CalibrationError(
            f"{where}: all {len(rig)} cameras are at one place: these are intrinsics only;"
            " `posefuse calibrate extrinsics` finds where the cameras stand"
        )
    shared, others = _common_view(rig), _common_views_reread(rig)
    if shared < LIMITS.common_view and others[_INVERSE] > LIMITS.inverse_ratio * max(shared, 1e-3):
        words = max(others, key=lambda reading: others[reading])
        raise CalibrationError(
            f"{where}: the cameras see {shared:.0%} of their views in common, and {others[words]:.0%} if the file holds {words};"
            f" {_EXPECTED}"
        )
    a, b = np.unravel_index(np.argmin(away + np.eye(len(rig)) * 1e9), away.shape)
    if away[a, b] < LIMITS.apart_m:
        raise CalibrationError(f"{where}: {rig.names[a]} and {rig.names[b]} are at the same place; expected one pose per camera")
    return rig


_EXPECTED = "expected camera_from_world, x_cam = R x_world + t"
# what else a file may hold for R and t, and the pose that is meant by it
_INVERSE = "the inverse of poses (world_from_camera)"
_READINGS: Mapping[str, Callable[[SE3], SE3]] = {
    _INVERSE: lambda pose: pose.inverse(),
    "camera centres for t": lambda pose: SE3(pose.wxyz, -(pose.matrix() @ pose.xyz)),
    "transposed rotations": lambda pose: SE3.from_matrix(pose.matrix().T, pose.xyz),
}


def _common_views_reread(rig: Rig) -> dict[str, float]:
    """The common view with all poses read in another way, by what the file would then hold."""
    return {
        words: _common_view(Rig(tuple(replace(camera, cam_from_world=read(camera.cam_from_world)) for camera in rig)))
        for words, read in _READINGS.items()
    }


def doubts(where: str, rig: Rig) -> tuple[str, ...]:
    """What is odd about the poses of a placed rig, and may yet be meant: all poses, single cameras, the axes of the world."""
    if len(rig) < 2:
        return ()
    shared, others = _common_view(rig), _common_views_reread(rig)
    words = max(others, key=lambda reading: others[reading])
    lines = _lonely_cameras(where, rig)
    if max(shared, LIMITS.common_view / 2) * LIMITS.inverse_ratio < others[words]:
        lines = [f"{where}: the cameras hardly see anything in common, and would if the file held {words}; {_EXPECTED}"]
    up = -np.mean([camera.cam_from_world.matrix()[1] for camera in rig], axis=0)
    axis = int(np.argmax(np.abs(up)))
    if (axis, np.sign(up[axis])) != (2, 1) and abs(up[axis]) > LIMITS.upright:
        found = f"{'-' if up[axis] < 0 else ''}{'XYZ'[axis]}"
        lines.append(f"{where}: up in the images is {found} of the world; expected Z: the results will not stand upright")
    return tuple(lines)


def _lonely_cameras(where: str, rig: Rig) -> list[str]:
    """Cameras that see nothing of what most of the others see together, and would if their poses were read in another way."""
    points = np.concatenate([_view(camera, _usual_m(rig)) for camera in rig])
    seen = np.stack([_seen(camera, points) for camera in rig])
    lines = []
    for c, camera in enumerate(rig):
        by_others = np.delete(seen, c, axis=0).sum(axis=0)
        together = by_others == by_others.max()
        if by_others.max() < 2 or seen[c, together].any():
            continue
        for words, read in _READINGS.items():
            other = _seen(replace(camera, cam_from_world=read(camera.cam_from_world)), points[together]).mean()
            if other >= LIMITS.seen_by_all:
                lines.append(
                    f"{where}: {camera.name} sees nothing of what {by_others.max()} others see together, and would if the file"
                    f" held {words}; {_EXPECTED}"
                )
                break
    return lines


def _apart_m(rig: Rig) -> Array:
    """(C, C) distances between cameras."""
    centres = rig.centres_world()
    return np.asarray(np.linalg.norm(centres[:, None] - centres[None], axis=-1))


def _usual_m(rig: Rig) -> float:
    return float(np.median(_apart_m(rig)[~np.eye(len(rig), dtype=bool)]))


def _common_view(rig: Rig) -> float:
    """Mean share of each camera's view, sampled over depths, that the other cameras see; the mean of all pairs."""
    usual_m, shares = _usual_m(rig), []
    for a, camera in enumerate(rig):
        points = _view(camera, usual_m)
        shares.append(np.mean([_seen(other, points).mean() for b, other in enumerate(rig) if b != a]))
    return float(np.mean(shares))


def _view(camera: Camera, usual_m: float) -> Array:
    """(P, 3) points in a camera's view."""
    x, y = np.meshgrid(_GRID * camera.size_wh[0], _GRID * camera.size_wh[1])
    norm = (np.stack([x.ravel(), y.ravel()], axis=1) - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]]
    rays = np.concatenate([norm, np.ones((len(norm), 1))], axis=1)
    return camera.cam_from_world.inverse() @ np.concatenate([usual_m * depth * rays for depth in _DEPTHS])


def _seen(camera: Camera, xyz_world: Array) -> Array:
    """(P,) whether a camera sees points, its lens taken as straight."""
    xyz = camera.cam_from_world @ xyz_world
    with np.errstate(divide="ignore", invalid="ignore"):
        xy = xyz[:, :2] / xyz[:, 2:] * camera.K[[0, 1], [0, 1]] + camera.K[:2, 2]
    return (xyz[:, 2] > 0) & (xy >= 0).all(axis=1) & (xy < camera.size_wh).all(axis=1)
