"""What travels between rooms: frozen, checked once at birth.

Axes: C cameras, N people, K keypoints, S segments, J joint angles, T time steps. Times int64 ns on the session clock,
mid-exposure. Lengths m, angles rad, image px. Missing is NaN with score 0 (never (0, 0)).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from .arrays import Array, FrozenArrays, freeze_fields, frozen_fields, taken
from .errors import ShapeError
from .skeleton import Skeleton

# in place of the number of a detection: the camera does not see the person
UNSEEN = -1
# the arrays of `Detections2D` and their axes
DETECTION_ARRAYS = {
    "xy_img": "P K 2",
    "score": "P K",
    "sigma_px": "P K",
    "box_img": "P 4",
    "clothing_lab": "P 3 3",
    "track_id": "P",
}
DETECTION_DTYPES: dict[str, DTypeLike] = {**dict.fromkeys(DETECTION_ARRAYS, np.float32), "track_id": np.int64}
# the arrays of one person per row and camera, of `Views`, and their axes
VIEW_ARRAYS = {"person_id": "N", "xy_img": "N C K 2", "score": "N C K", "sigma_px": "N C K"}
NO_TRACK = -1


def check_keypoints(value: Any, sizes: Mapping[str, int]) -> None:
    """Raise ShapeError when the arrays of a value have another number of keypoints than its skeleton."""
    skeleton: Skeleton = value.skeleton
    if sizes["K"] != len(skeleton):
        raise ShapeError(
            f"{type(value).__name__}: skeleton {skeleton.name} has {len(skeleton)} keypoints, arrays have {sizes['K']}"
        )


def freeze_depth(value: Any, dtype: DTypeLike) -> None:
    """Freeze ``depth_m`` of a value, if it has any: (..., 2) of its ``score`` (...)."""
    if value.depth_m is not None:
        freeze_fields(value, {"depth_m": dtype})
        if value.depth_m.shape != (*value.score.shape, 2):
            raise ShapeError(
                f"{type(value).__name__}.depth_m: expected shape {(*value.score.shape, 2)}, got {value.depth_m.shape}"
            )


def check_views(value: Any, axes: Mapping[str, str]) -> None:
    """Freeze and check the arrays of `Views` or `ViewSequence`, whose axes are `axes`."""
    sizes = frozen_fields(value, axes)
    check_keypoints(value, sizes)
    freeze_depth(value, np.float64)
    if sizes["C"] != len(value.camera_names):
        raise ShapeError(f"{type(value).__name__}: {len(value.camera_names)} camera names, arrays have {sizes['C']} cameras")


def unseen_planes(shape: tuple[int, ...], with_depth: bool = False) -> dict[str, Array]:
    """Arrays of keypoints (...) that no one saw, to be filled: ``score``, ``sigma_px``, and ``xy_img``, ``depth_m`` (..., 2)."""
    planes = {"xy_img": np.full((*shape, 2), np.nan), "score": np.zeros(shape), "sigma_px": np.full(shape, np.nan)}
    return {**planes, "depth_m": np.full((*shape, 2), np.nan)} if with_depth else planes


def keypoint_boxes(xy_img: Array, score: Array) -> Array:
    """(P, 4) left, top, right, bottom of the keypoints (P, K, 2) that were seen; NaN where none was."""
    seen = ((score > 0) & np.isfinite(xy_img).all(axis=-1))[..., None]
    low, high = np.where(seen, xy_img, np.inf).min(axis=1), np.where(seen, xy_img, -np.inf).max(axis=1)
    box = np.concatenate([low, high], axis=-1)
    return np.where(np.isfinite(box), box, np.nan)


@dataclass(frozen=True, eq=False, kw_only=True)
class Region(FrozenArrays):
    """A square of the image, possibly turned, in which one person is expected.

    Attributes:
        centre_img: (2,) raw px.
        side_px: edge length.
        angle_rad: how far the person's up direction is turned from the image's up (-y), clockwise as seen on screen.
    """

    centre_img: Array
    side_px: float
    angle_rad: float = 0.0

    def __post_init__(self) -> None:
        frozen_fields(self, {"centre_img": "2"})
        if not (np.isfinite(self.centre_img).all() and self.side_px > 0 and np.isfinite(self.angle_rad)):
            raise ShapeError(
                f"Region: expected finite centre, angle and side > 0, got {self.centre_img}, {self.angle_rad}, {self.side_px}"
            )


@dataclass(frozen=True, eq=False, kw_only=True)
class Detections2D(FrozenArrays):
    """All people that one camera saw at one time step.

    Attributes:
        camera: its name.
        t_ns: session clock.
        skeleton: names axis K.
        xy_img: (P, K, 2) float32 raw distorted px; NaN where a keypoint is missing.
        score: (P, K) float32 in [0, 1]; 0 where missing.
        sigma_px: (P, K) float32 standard deviation of each image coordinate; NaN where missing.
        box_img: (P, 4) float32 left, top, right, bottom.
        clothing_lab: (P, 3, 3) float32 colours (CIE L*, a*, b*) of trunk, thighs and shanks; NaN where unknown.
        track_id: (P,) int64 numbers that another tool's tracker gave to the people of this camera; -1: none.
        depth_m: (P, K, 2) float32 depth of the surface at each keypoint along the optical axis, and its standard deviation; NaN
            where unknown. None from a camera without depth.
    """

    camera: str
    t_ns: int
    skeleton: Skeleton
    xy_img: Array
    score: Array
    sigma_px: Array
    box_img: Array
    clothing_lab: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    track_id: Array = field(default_factory=lambda: np.zeros(0))
    depth_m: Array | None = None

    def __post_init__(self) -> None:
        people = len(self.xy_img)
        if not len(self.clothing_lab):
            object.__setattr__(self, "clothing_lab", np.full((people, 3, 3), np.nan))
        if not len(self.track_id):
            object.__setattr__(self, "track_id", np.full(people, NO_TRACK))
        check_keypoints(self, frozen_fields(self, DETECTION_ARRAYS, DETECTION_DTYPES))
        freeze_depth(self, np.float32)

    def __repr__(self) -> str:
        return f"Detections2D({len(self)} people in {self.camera} at {self.t_ns} ns, {self.skeleton})"

    def __len__(self) -> int:
        return len(self.xy_img)

    def people(self, rows: Array) -> Detections2D:
        """Some of the people: indices, or (P,) bool."""
        return replace(self, **taken(self, (*DETECTION_ARRAYS, "depth_m"), rows))

    @staticmethod
    def of(camera: str, t_ns: int, skeleton: Skeleton, xy_img: Any, score: Any, sigma_px: Any) -> Detections2D:
        """People (P, K) with boxes about what is seen of them; P may be 0."""
        xy, score = np.reshape(xy_img, (-1, len(skeleton), 2)), np.reshape(score, (-1, len(skeleton)))
        return Detections2D(
            camera=camera,
            t_ns=t_ns,
            skeleton=skeleton,
            xy_img=xy,
            score=score,
            sigma_px=np.reshape(sigma_px, score.shape),
            box_img=keypoint_boxes(xy, score) if len(xy) else np.zeros((0, 4)),
        )

    @staticmethod
    def empty(camera: str, t_ns: int, skeleton: Skeleton) -> Detections2D:
        """No person seen."""
        return Detections2D.of(camera, t_ns, skeleton, (), (), ())


@dataclass(frozen=True, eq=False, kw_only=True)
class Views(FrozenArrays):
    """The same people in every camera, at one time step.

    Attributes:
        t_ns: session clock. camera_names: axis C.
        person_id: (N,) int64, stable over time.
        xy_img: (N, C, K, 2) raw distorted px; NaN where unseen.
        score: (N, C, K) in [0, 1]; 0 where unseen.
        sigma_px: (N, C, K); NaN where unseen.
        depth_m: (N, C, K, 2) as in `Detections2D`; None where no camera has depth.
    """

    t_ns: int
    skeleton: Skeleton
    camera_names: tuple[str, ...]
    person_id: Array
    xy_img: Array
    score: Array
    sigma_px: Array
    depth_m: Array | None = None

    def __post_init__(self) -> None:
        check_views(self, VIEW_ARRAYS)

    @staticmethod
    def of(detections: Sequence[Detections2D], t_ns: int, person_id: Array, place: Array) -> Views:
        """People (N,) whose detection in camera c is number place[n, c], or `UNSEEN`; one `Detections2D` per camera."""
        skeleton, with_depth = detections[0].skeleton, any(seen.depth_m is not None for seen in detections)
        planes = unseen_planes((*place.shape, len(skeleton)), with_depth)
        for row, c in np.argwhere(place != UNSEEN):
            for name, plane in planes.items():
                if (values := getattr(detections[c], name)) is not None:
                    plane[row, c] = values[place[row, c]]
        names = tuple(seen.camera for seen in detections)
        return Views(t_ns=t_ns, skeleton=skeleton, camera_names=names, person_id=person_id, **planes)

    def people(self, which: Array) -> Views:
        """These people only: `which` is (N,) bool, or their places on axis N in the order wanted."""
        return replace(self, **taken(self, (*VIEW_ARRAYS, "depth_m"), which))
