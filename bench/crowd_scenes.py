"""Crowds with exact identities for `bench/people.py`: scenes, who counts when, and a stand-in for the 2D network."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from harness import Use, scene_from
from scenes import OUTLIER_PX, OUTLIERS, SWAPS, noise, walk

from paper.scenes.inertial import wander
from posefuse.core import CameraTruth, Detections2D, LookKind, Pose3D, Region, Truth
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.core.values import keypoint_boxes
from posefuse.detection import region_from_pose
from posefuse.detection.appearance import lab_from_srgb
from posefuse.formats.truth import read_truth, write_truth
from posefuse_sim.body.body import completed_shape
from posefuse_sim.body.mesh import BodyShapeSettings
from posefuse_sim.build import LiveScene, live_scene
from posefuse_sim.scene import Scene
from posefuse_sim.surroundings import FLESH_M, hidden_by_shapes, in_image

RATE_HZ, SECONDS, VISIBLE_EVERY = 30.0, 11.0, 3
# seeds of what is reported were drawn once the code was done
DEVELOPMENT_SEED, REPORTED_SEEDS = 11, (483, 46254)
# no person walks through another
LEAST_APART_M = 0.18
# the network finds a person if it sees this share of the keypoints, in most frames
LEAST_VISIBLE, MISSED = 0.4, 0.03
# keypoint noise as a share of a person's height in the picture: 2.4 px of the demo clip's 215
SIGMA_SHARE, HIDDEN_FACTOR, HIDDEN_SCORE, SEEN_SCORE = 0.011, 4.0, 0.3, 0.95
# of keypoints hidden behind another person, this share is taken from that person
CONFUSED = 0.3
# clothing colours L*, a*, b*, standard deviations: of a camera's exposure and white balance, of light that stays for a while,
# and of single frames
CAMERA_LAB, LIGHT_LAB, WHITE_LAB, LIGHT_S = np.array([6.0, 3.0, 3.0]), np.array([8.0, 3.0, 3.0]), np.array([2.0, 1.0, 1.0]), 1.0
CASES = (
    ("crossing", 2, 4), ("crossing", 4, 4), ("crossing", 6, 8),
    ("hugging", 2, 4), ("hugging", 4, 8),
    ("returning", 2, 4), ("returning", 4, 8), ("returning", 6, 8),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Crowd:
    """A scene and who is in the room when.

    Attributes:
        truth: exact; NaN in 3D and in every view while a person is away. asked: (T, N) who counts: in the room and seen by two
            cameras well enough.
    """

    truth: Truth
    asked: np.ndarray


def crowd(kind: str, people: int, cameras: int, seed: int, kept: Path) -> Crowd:
    """Made, or read from the folder `kept`."""
    path = kept / f"{kind}_{people}_{cameras}_{seed}.npz"
    if not path.is_file():
        kept.mkdir(parents=True, exist_ok=True)
        write_truth(path, _truth(_apart(kind, people, cameras, seed)))
    truth = read_truth(path)
    if kind == "returning":
        truth = _without(truth, absences(people, len(truth.t_ns)))
    seen = np.stack([view.visible.mean(axis=-1) >= LEAST_VISIBLE for view in truth.views])
    return Crowd(truth, seen.sum(axis=0) >= 2)


def _truth(live: LiveScene) -> Truth:
    """As `simulation.exact.truth_of` for perfect cameras, with visibility by shapes in every third frame: much faster."""
    t_ns = live.t_ns
    xyz = live.keypoints(t_ns / 1e9)
    frames, people, keypoints = xyz.shape[:3]
    places, flesh = xyz[::VISIBLE_EVERY].reshape(-1, people * keypoints, 3), np.tile(FLESH_M, people)
    views = []
    for camera in live.rig:
        hidden = hidden_by_shapes(camera.centre_world, places, flesh, live.boxes, xyz[::VISIBLE_EVERY])
        free = np.repeat(~hidden, VISIBLE_EVERY, axis=0)[:frames].reshape(frames, people, keypoints)
        xy = camera.project(xyz)
        views.append(CameraTruth(camera=camera.name, t_ns=t_ns, xy_img=xy, visible=free & in_image(camera, xy)))
    ids = np.arange(people)
    return Truth(rig=live.rig, t_ns=t_ns, skeleton=ANATOMICAL23, person_id=ids, xyz_world=xyz, views=tuple(views))


def absences(people: int, frames: int) -> np.ndarray:
    """(T, N) who is away: everybody but the first leaves and comes back elsewhere, most of them while others are away too."""
    t_s = np.arange(frames) / RATE_HZ
    away = np.zeros((frames, people), bool)
    for n in range(1, people):
        away[:, n] = (t_s > 3.0 + 0.35 * n) & (t_s < 7.2 + 0.25 * n)
    return away


def _apart(kind: str, people: int, cameras: int, seed: int) -> LiveScene:
    for attempt in range(60):
        scene = _scene(kind, people, cameras, seed, attempt)
        live = live_scene(scene)
        middle = live.keypoints(np.arange(0, SECONDS, 0.2)).mean(axis=2)[..., :2]
        gaps = np.linalg.norm(middle[:, :, None] - middle[:, None], axis=-1) + 9 * np.eye(people)
        if gaps.min() >= LEAST_APART_M:
            return live
    raise SystemExit(f"{kind}: found no way for {people} people to pass each other")


def _scene(kind: str, people: int, cameras: int, seed: int, attempt: int) -> Scene:
    rng = np.random.default_rng([seed, attempt])
    content: dict[str, Any] = {
        "duration_s": SECONDS, "rate_hz": RATE_HZ, "seed": seed,
        "cameras": {"kind": "ring", "count": cameras, "radius_m": 5.0, "height_m": 2.4, "image": {"horizontal_fov_deg": 70.0}},
        "people": [
            {"body": {"random_seed": 100 * seed + n}, "motion": motion} for n, motion in enumerate(_motions(kind, people, rng))
        ],
    }  # fmt: skip
    return scene_from(content, Use.DEVELOP if seed == DEVELOPMENT_SEED else Use.REPORT)


def _motions(kind: str, people: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    if kind == "crossing":
        return [_crossing(n, rng) for n in range(people)]
    if kind == "hugging":
        return [_meeting(n, rng) for n in range(people)]
    speed = rng.uniform(0.8, 1.4, people)
    return [
        walk(
            {"shape": "circle", "radius_m": 0.8 + 0.5 * n, "clockwise": n % 2 == 1, "start_deg": float(rng.uniform(0, 360))},
            float(min(speed[n], 1.4)),
        )
        for n in range(people)
    ]


def _crossing(n: int, rng: np.random.Generator) -> dict[str, Any]:
    """Two by two along parallel lines, in opposite directions, 0.3 m apart."""
    sense, middle = 1 - 2 * (n % 2), np.array([0.0, 1.75 * ((n // 2 + 1) // 2) * (-1) ** (n // 2)])
    ahead, left = np.array([sense, 0.0]), np.array([0.0, sense])
    start, end = middle - 2.0 * ahead - 0.15 * left, middle + 2.0 * ahead - 0.15 * left
    path = {"shape": "back_forth", "start_m": start.tolist(), "end_m": end.tolist()}
    return walk(path, float(rng.uniform(0.8, 1.4)))


def _meeting(n: int, rng: np.random.Generator) -> dict[str, Any]:
    """Two by two towards each other until they stand chest to chest."""
    middle, sense = np.array([0.0, 1.2 * (n // 2)]), 1 - 2 * (n % 2)
    path = {"shape": "line", "start_m": (middle - [2.2 * sense, 0]).tolist(), "end_m": (middle - [0.15 * sense, 0]).tolist()}
    return walk(path, float(rng.uniform(0.7, 1.1)))


def _without(truth: Truth, away: np.ndarray) -> Truth:
    gone = away[..., None]
    views = tuple(
        replace(view, xy_img=np.where(gone[..., None], np.nan, view.xy_img), visible=view.visible & ~gone) for view in truth.views
    )
    return replace(truth, xyz_world=np.where(gone[..., None], np.nan, truth.xyz_world), views=views)


class Network:
    """Answers as a 2D network that looks at regions or searches: with its noise, confusions, misses and duplicates.

    A region around a hidden person shows the person in front of them, so the same body comes back twice.
    """

    def __init__(self, made: Crowd, seed: int) -> None:
        truth, self.spent_s = made.truth, 0.0
        self.rig, self.skeleton, self.t_ns = truth.rig, truth.skeleton, truth.t_ns
        worn = worn_by(seed, len(truth.person_id))
        self._views = [
            (*_seen(truth, c, np.random.default_rng([seed, c])), _clothing(truth, c, worn, np.random.default_rng([seed, c, 1])))
            for c in range(len(truth.views))
        ]

    def look(self, i: int, c: int, regions: list[Region] | None) -> Detections2D:
        xy, score, sigma, clothing = (part[i] for part in self._views[c])
        there = np.flatnonzero((score > 0).any(axis=-1))
        if regions is None:
            chosen = there
        else:
            middle = np.array([np.nanmean(xy[n], axis=0) for n in there]).reshape(-1, 2)
            chosen = np.array([_inside(middle, there, region) for region in regions], int)
        absent = chosen < 0
        out_xy, out_score, out_sigma = xy[chosen].copy(), score[chosen].copy(), sigma[chosen].copy()
        out_clothing = np.where(absent[:, None, None], np.nan, clothing[chosen])
        out_xy[absent], out_score[absent], out_sigma[absent] = np.nan, 0.0, np.nan
        # looked at twice, a body is not marked in the very same places
        again = np.random.default_rng([i, c]).normal(0, 0.2, out_xy.shape) * out_sigma[..., None]
        out_xy = out_xy + (again if regions is not None else 0.0)
        box = keypoint_boxes(out_xy, out_score)
        parts = {"xy_img": out_xy, "score": out_score, "sigma_px": out_sigma, "box_img": box, "clothing_lab": out_clothing}
        return Detections2D(camera=self.rig.names[c], t_ns=int(self.t_ns[i]), skeleton=self.skeleton, **parts)

    def regions(self, c: int, xyz_world: np.ndarray) -> list[Region]:
        found = [region_from_pose(self.rig.cameras[c], xyz, self.skeleton) for xyz in xyz_world]
        return [region for region in found if region is not None]

    def steps(self) -> Iterator[Step]:
        return (Step(self, i) for i in range(len(self.t_ns)))


@dataclass(frozen=True)
class Step:
    """One time step for `pipeline.following`."""

    network: Network
    i: int

    @property
    def t_ns(self) -> int:
        return int(self.network.t_ns[self.i])

    def look(self, kind: LookKind, expected: Pose3D | None) -> tuple[Detections2D, ...]:
        one, began = self.network, time.thread_time()
        found = tuple(
            one.look(self.i, c, None if expected is None else one.regions(c, expected.xyz_world)) for c in range(len(one.rig))
        )
        one.spent_s += time.thread_time() - began
        return found


def worn_by(seed: int, people: int) -> np.ndarray:
    """(N, 3, 3) true colours of trunk, thighs and shanks: those of the scene's bodies."""
    bodies = [completed_shape(BodyShapeSettings(random_seed=100 * seed + n)) for n in range(people)]
    rgb = np.array([[[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in (b.shirt, b.trousers, b.trousers)] for b in bodies])
    return lab_from_srgb(rgb)


def _clothing(truth: Truth, c: int, worn: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(T, N, 3, 3) colours as a camera sees them: its own white balance, light that changes with the body's pose and place, and
    the clothes of the person in front."""
    view = truth.views[c]
    frames, people, _ = view.visible.shape
    shape = (frames, people, 3, 3)
    camera = rng.standard_normal((1, 1, 1, 3)) * CAMERA_LAB
    t_s = view.t_ns / 1e9
    slow = wander(t_s, LIGHT_S, shape[1:], rng)
    lab = worn[None] + camera + slow * LIGHT_LAB + rng.standard_normal(shape) * WHITE_LAB
    # what is hidden shows the clothes of the person nearest in the image
    middle = view.xy_img.mean(axis=2)
    apart = np.linalg.norm(middle[:, :, None] - middle[:, None], axis=-1)
    apart[:, np.arange(people), np.arange(people)] = np.inf
    other = np.where(np.isfinite(apart), apart, np.inf).argmin(axis=-1)
    names = truth.skeleton.keypoints
    for part, wanted in enumerate((("shoulder", "hip"), ("hip", "knee"), ("knee", "ankle"))):
        mine = [k for k, name in enumerate(names) if name.split("_")[-1] in wanted and name.split("_")[0] in ("left", "right")]
        hidden = view.visible[:, :, mine].mean(axis=-1) < 0.5
        theirs = np.take_along_axis(lab[:, :, part], other[..., None], axis=1)
        lab[:, :, part] = np.where(hidden[..., None], theirs, lab[:, :, part])
    return lab


def _inside(middle: np.ndarray, there: np.ndarray, region: Region) -> int:
    away = np.linalg.norm(middle - region.centre_img, axis=-1)
    return int(there[away.argmin()]) if len(there) and away.min() <= region.side_px / 2 else -1


def _seen(truth: Truth, c: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    view = truth.views[c]
    exact, visible = view.xy_img, view.visible
    frames, people, keypoints = visible.shape
    height = np.nan_to_num(np.ptp(np.nan_to_num(exact[..., 1]), axis=-1))[..., None]
    sigma = SIGMA_SHARE * np.maximum(height, 20.0) * np.where(visible, 1.0, HIDDEN_FACTOR)
    t_s = view.t_ns / 1e9
    errors = np.stack([noise(rng, t_s, keypoints) for _ in range(people)], axis=1)
    exact = _confused(exact, visible, rng)
    xy = exact + errors * sigma[..., None]
    wild = rng.random(visible.shape) < OUTLIERS
    xy = np.where(wild[..., None], exact + rng.uniform(-OUTLIER_PX, OUTLIER_PX, xy.shape), xy)
    score = np.where(visible, SEEN_SCORE, HIDDEN_SCORE)
    turned = rng.random((frames, people)) < SWAPS
    mirror = truth.skeleton.mirror
    xy = np.where(turned[..., None, None], xy[:, :, mirror], xy)
    found = (visible.mean(axis=-1) >= LEAST_VISIBLE) & (rng.random((frames, people)) >= MISSED)
    gone = ~found[..., None] | ~np.isfinite(xy).all(-1)
    return np.where(gone[..., None], np.nan, xy), np.where(gone, 0.0, score), np.where(gone, np.nan, sigma)


def _confused(exact: np.ndarray, visible: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Hidden keypoints near another person's same keypoint are sometimes taken from that person."""
    frames, people, keypoints = visible.shape
    apart = np.linalg.norm(exact[:, :, None] - exact[:, None], axis=-1)
    apart = np.where(np.isfinite(apart) & visible[:, None], apart, np.inf)
    apart[:, np.arange(people), np.arange(people)] = np.inf
    nearest = apart.argmin(axis=2)
    reach = 0.3 * np.nan_to_num(np.ptp(np.nan_to_num(exact[..., 1]), axis=-1))[..., None]
    # it lasts: a third of a second is confused or not as a whole
    drawn = np.repeat(rng.random((frames // 10 + 1, people, keypoints)), 10, axis=0)[:frames]
    taken = ~visible & (apart.min(axis=2) < reach) & (drawn < CONFUSED)
    other = np.take_along_axis(exact, nearest[..., None].repeat(2, -1), axis=1)
    return np.where(taken[..., None], other, exact)
