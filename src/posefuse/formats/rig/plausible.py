"""Numbers that are legal in a rig file but implausible: each is named with its probable cause."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import CalibrationError, Camera, Rig
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
        inverse_ratio: by how much more the cameras must see in common with inverse poses.
    """

    aspect: float = 1.6
    focal_widths: tuple[float, float] = (0.13, 60.0)
    centre_off: float = 0.15
    rim: float = 0.6
    apart_m: float = 0.002
    common_view: float = 0.3
    inverse_ratio: float = 1.7


LIMITS = PlausibleLimits()
# depths, in distances between cameras, and image points at which a view is sampled
_DEPTHS, _GRID = (0.25, 0.5, 1.0, 2.0), np.linspace(0.1, 0.9, 5)


def require_plausible(where: str, camera: Camera, limits: PlausibleLimits = LIMITS) -> Camera:
    """The camera; raises CalibrationError for intrinsics that cannot be meant."""
    problem = _size_problem(camera, limits) or _matrix_problem(camera, limits) or _lens_problem(camera, limits)
    if problem:
        raise CalibrationError(f"{where}: {problem}")
    return camera


def _matrix_problem(camera: Camera, limits: PlausibleLimits) -> str:
    fx, fy, (width, height) = camera.K[0, 0], camera.K[1, 1], camera.size_wh
    if max(fx / fy, fy / fx) > limits.aspect:
        return (
            f"matrix: fx {fx:.1f} and fy {fy:.1f} px differ by more than pixels do; expected a ratio of at most {limits.aspect:g}"
        )
    least, most = limits.focal_widths
    if not least <= fx / max(width, height) <= most:
        return (
            f"matrix: expected a focal length of {least * max(width, height):.0f} to {most * max(width, height):.0f} px"
            f" for images of {width}x{height} px, got {fx:.1f}; is it in millimetres, or of another image size?"
        )
    cx, cy = camera.K[:2, 2]
    if not (-0.5 <= cx <= width - 0.5 and -0.5 <= cy <= height - 0.5):
        return f"matrix: the principal point ({cx:.0f}, {cy:.0f}) px lies outside of the image of {width}x{height} px"
    return ""


def _size_problem(camera: Camera, limits: PlausibleLimits) -> str:
    size, centre = np.array(camera.size_wh, np.float64), camera.K[:2, 2]
    off, swapped = np.abs(centre / size - 0.5), np.abs(centre / size[::-1] - 0.5)
    if (off > limits.centre_off).all() and (swapped < limits.centre_off / 2).all():
        width, height = camera.size_wh
        return (
            f"size: {width}x{height} px with a principal point of ({centre[0]:.0f}, {centre[1]:.0f}) px:"
            f" width and height are swapped, expected [{height}, {width}]"
        )
    return ""


def _lens_problem(camera: Camera, limits: PlausibleLimits) -> str:
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    half = np.array(camera.size_wh) / 2
    rim = half - 0.5 + limits.rim * half * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if np.isfinite(camera.norm_from_px(rim)).all():
        return ""
    return (
        f"distortion: {camera.distortion.tolist()} folds the image well inside of its border;"
        f" are these coefficients of {camera.model}?"
    )


def require_placed(where: str, rig: Rig, limits: PlausibleLimits = LIMITS) -> Rig:
    """The rig; raises CalibrationError for impossible camera positions."""
    if len(rig) < 2:
        return rig
    centres = rig.centres_world()
    away = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    if away.max() < limits.apart_m:
        raise CalibrationError(
            f"{where}: all {len(rig)} cameras are at one place: these are intrinsics only;"
            " `posefuse calibrate extrinsics` finds where the cameras stand"
        )
    shared, other = _common_view(rig), _common_view(_inverse(rig))
    if shared < limits.common_view and other > limits.inverse_ratio * max(shared, 1e-3):
        raise CalibrationError(
            f"{where}: the cameras see {shared:.0%} of their views in common, and {other:.0%} with the inverse of their poses:"
            " it holds world_from_camera; expected camera_from_world, x_cam = R x_world + t"
        )
    a, b = np.unravel_index(np.argmin(away + np.eye(len(rig)) * 1e9), away.shape)
    if away[a, b] < limits.apart_m:
        raise CalibrationError(f"{where}: {rig.names[a]} and {rig.names[b]} are at the same place; expected one pose per camera")
    return rig


def _inverse(rig: Rig) -> Rig:
    return Rig(tuple(replace(camera, cam_from_world=camera.cam_from_world.inverse()) for camera in rig))


def _common_view(rig: Rig) -> float:
    """Mean share of each camera's view, sampled over depths, that the other cameras see; the mean of all pairs."""
    centres = rig.centres_world()
    away = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    usual_m = float(np.median(away[~np.eye(len(rig), dtype=bool)]))
    shares = []
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
