"""Whether each camera stands still while it records: corners of its background, early against late.

People and the target cover a part of an image, and the background covers the rest. So corners are sought everywhere, found
again in later frames (Shi and Tomasi 1994, Lucas and Kanade 1981), and one rotation of the camera has to explain most
of the image; every region counts as much as every other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from posefuse.calibration.geometry import nearest_rotation
from posefuse.calibration.report import CalibrationReport, Check
from posefuse.core import Camera, Frame, SourceError
from posefuse.core.arrays import Array
from posefuse.sources import RecordedSource

from .rig_monitor import MOVED, RigFinding

CHECK = "background stands still"
# shares of the recording, since hands are at the cameras when it begins and ends: the frame at the first is compared with that at
# the second and, where they differ, with so many that halve the time of the move, the first of which must show the background
_LOOKS, _BETWEEN, _LEAST_BETWEEN, _LEAST_FRAMES = (0.04, 0.96), 6, 2, 5
# smallest rotation reported: the smallest that is noticed in a person; below it, image stabilisation and breathing mounts lie
_LEAST_RAD = float(np.deg2rad(0.35))
# no result is better in larger images; in px of these: how well a corner has to be found again from both sides, and how far
# off its place a background corner may be
_WIDTH_PX, _BACK_PX, _OFF_PX = 960, 0.5, 1.0
# neighbourhood in px in which brightness and contrast are measured, and contrast in grey levels that is noise
_AROUND_PX, _NOISE = (31, 31), 6.0
# regions of the image, across and down, and corners in each; a region is known by so many corners found again
_ACROSS, _DOWN, _CORNERS, _KNOWN_BY = 8, 6, 10, 2
# least number of known regions, the quarters of the image in which they must lie, and the share of them that has to move alike
_LEAST_KNOWN, _LEAST_QUARTERS, _ALIKE = 8, 3, 0.5
# share of the known regions that stand still at which the camera does
_STILL = 0.3
_TRIES = 200


@dataclass(frozen=True, kw_only=True)
class BackgroundFound:
    """What the backgrounds show.

    Attributes:
        moved: cameras that were turned, each with the time. still, unknown: cameras that stand still, and those whose images
            do not show it.
    """

    moved: tuple[RigFinding, ...]
    still: tuple[str, ...]
    unknown: tuple[str, ...]

    @property
    def lines(self) -> tuple[str, ...]:
        """One line each for cameras of which the images do not show whether they stand still."""
        if not self.unknown:
            return ()
        names = ", ".join(self.unknown)
        return (f"{CHECK}: not checked in {names}, where too little of the background is found again",)

    @property
    def report(self) -> CalibrationReport:
        """The same as a check of a calibration; without one where no camera could be checked, and lines about the others."""
        still = f"{', '.join(self.still)}: turned by less than {np.rad2deg(_LEAST_RAD):.2f} deg"
        words = "; ".join(one.detail for one in self.moved) or still
        checks = (Check(CHECK, not self.moved, words, "fix the camera and record again"),) if self.moved or self.still else ()
        return CalibrationReport("background", checks, self.lines)


def background_of(
    sources: Sequence[RecordedSource], cameras: Sequence[Camera], used_ns: tuple[int, int] | None = None
) -> BackgroundFound:
    """Compare the backgrounds of a recording; two frames of a camera that stands still are decoded, of others up to eight.

    Args:
        sources: of these cameras. cameras: their intrinsics. used_ns: first and last time that is used; None: all.
    """
    named = {camera.name: camera for camera in cameras}
    moved, still, unknown = list[RigFinding](), list[str](), list[str]()
    for source in sources:
        camera = named[source.camera]
        found = _watched(source, camera, used_ns)
        if isinstance(found, RigFinding):
            moved.append(found)
        else:
            (still if found else unknown).append(camera.name)
    return BackgroundFound(moved=tuple(moved), still=tuple(still), unknown=tuple(unknown))


def _watched(source: RecordedSource, camera: Camera, used_ns: tuple[int, int] | None) -> RigFinding | bool:
    """How a camera was moved, or whether it is known to have stood still."""
    times_ns = np.asarray(source.times_ns())
    if used_ns is not None:
        times_ns = times_ns[(times_ns >= used_ns[0]) & (times_ns <= used_ns[1])]
    if len(times_ns) < _LEAST_FRAMES:
        return False
    first_ns, last_ns = times_ns[np.round(np.array(_LOOKS) * (len(times_ns) - 1)).astype(int)].tolist()
    first = _frame_at(source, first_ns)
    if first is None:
        return False
    corners = _Corners.of(first, camera)

    def turn_at(t_ns: int) -> Array | None:
        frame = _frame_at(source, t_ns)
        return None if frame is None else corners.turned_in(frame)

    last = turn_at(last_ns)
    if last is None or np.linalg.norm(last) < _LEAST_RAD:
        return last is not None
    when_ns = _when_ns((first_ns, last_ns), last, turn_at)
    return when_ns is not None and _finding(camera, last, when_ns)


def _when_ns(between_ns: tuple[int, int], last: Array, turn_at: Callable[[int], Array | None]) -> tuple[int, int] | None:
    """The times between which most of a rotation happens; None where too little shows, or anything but a part of the rotation."""
    before_ns, after_ns = between_ns
    for look in range(_BETWEEN):
        middle_ns = (before_ns + after_ns) // 2
        turn = turn_at(middle_ns)
        if turn is None:
            return (before_ns, after_ns) if look >= _LEAST_BETWEEN else None
        early_rad, late_rad = np.linalg.norm(turn), np.linalg.norm(last - turn)
        # a thing that moves before the camera takes all directions; a camera that was moved stays there
        if early_rad + late_rad > np.linalg.norm(last) + _LEAST_RAD:
            return None
        before_ns, after_ns = (before_ns, middle_ns) if late_rad < early_rad else (middle_ns, after_ns)
    return before_ns, after_ns


def _finding(camera: Camera, turn: Array, when_ns: tuple[int, int]) -> RigFinding:
    angle = float(np.linalg.norm(turn))
    shift_px = angle * float(camera.K[0, 0])
    words = (
        f"the background of {camera.name} turns by {np.rad2deg(angle):.2f} deg (about {shift_px:.0f} px) between"
        f" {when_ns[0] / 1e9:.1f} and {when_ns[1] / 1e9:.1f} s: the camera was moved"
    )
    return RigFinding(kind=MOVED, cameras=(camera.name,), t_ns=when_ns[1], detail=words, displaced_m=float("nan"), amount=angle)


def _frame_at(source: RecordedSource, t_ns: int) -> Frame | None:
    """The first frame from a time on; None where none can be read."""
    try:
        return next(iter(source.frames_from(t_ns)), None)
    except SourceError:
        return None


@dataclass(frozen=True, kw_only=True, eq=False)
class _Corners:
    """Corners of one frame.

    Attributes:
        camera: for the small image. grey: the small image. xy_px: (N, 2) float32 corners in it. ray: (N, 3) their unit
            directions. region: (N,) region of each.
    """

    camera: Camera
    grey: Array
    xy_px: Array
    ray: Array
    region: Array

    @staticmethod
    def of(frame: Frame, camera: Camera) -> _Corners:
        grey = _small(frame)
        small = camera.scaled((grey.shape[1], grey.shape[0]))
        xy_px, region = _corners(grey)
        return _Corners(camera=small, grey=grey, xy_px=xy_px, ray=_rays(small, xy_px), region=region)

    def turned_in(self, frame: Frame) -> Array | None:
        """Rotation vector, rad, by which the background of another frame is turned; None where that does not show."""
        if not len(self.xy_px):
            return None
        later = _small(frame)
        forward, found, _ = cv2.calcOpticalFlowPyrLK(self.grey, later, self.xy_px, None, maxLevel=4)  # type: ignore[call-overload]
        back, again, _ = cv2.calcOpticalFlowPyrLK(later, self.grey, forward, None, maxLevel=4)  # type: ignore[call-overload]
        ray = _rays(self.camera, forward)
        kept = (found & again)[:, 0].astype(bool) & (np.linalg.norm(back - self.xy_px, axis=1) < _BACK_PX)
        kept &= np.isfinite(ray).all(axis=1) & np.isfinite(self.ray).all(axis=1)
        count = np.bincount(self.region[kept], minlength=_ACROSS * _DOWN)
        kept &= count[self.region] >= _KNOWN_BY
        count[count < _KNOWN_BY] = 0
        quarters = {(r % _ACROSS * 2 // _ACROSS, r // _ACROSS * 2 // _DOWN) for r in np.flatnonzero(count).tolist()}
        if (count > 0).sum() < _LEAST_KNOWN or len(quarters) < _LEAST_QUARTERS:
            return None
        weight = 1 / count[self.region[kept]] / (count > 0).sum()
        return _rotation(self.ray[kept], ray[kept], weight, _OFF_PX / float(self.camera.K[0, 0]))


def _rotation(ray: Array, later: Array, weight: Array, off_rad: float) -> Array | None:
    """The rotation that takes most rays to the later ones; zero where enough stay; None where no rotation explains them."""
    if weight[np.linalg.norm(later - ray, axis=1) < off_rad].sum() >= _STILL:
        return np.zeros(3)
    pairs = np.random.default_rng(0).integers(len(ray), size=(_TRIES, 2))
    tried = _turns(ray[pairs], later[pairs])
    fits = np.linalg.norm(np.einsum("tij,nj->tni", tried, ray) - later, axis=-1) < off_rad
    best = fits[np.argmax(fits @ weight)]
    if best @ weight < _ALIKE:
        return None
    vector, _ = cv2.Rodrigues(_turns(ray[best][None], later[best][None])[0])
    return np.asarray(vector[:, 0])


def _turns(ray: Array, later: Array) -> Array:
    """(B, 3, 3) rotations that take rays (B, N, 3) to the later ones best (Kabsch 1976)."""
    return nearest_rotation(np.einsum("bni,bnj->bij", later, ray))


def _rays(camera: Camera, xy_px: Array) -> Array:
    norm = camera.norm_from_px(xy_px.astype(np.float64))
    ray = np.concatenate([norm, np.ones((len(norm), 1))], axis=1)
    return np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True))


def _small(frame: Frame) -> Array:
    """The image in grey, at most `_WIDTH_PX` wide, with one brightness and contrast everywhere: exposure and light may change."""
    grey = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY)
    height, width = grey.shape
    if width > _WIDTH_PX:
        grey = cv2.resize(grey, (_WIDTH_PX, round(height * _WIDTH_PX / width)), interpolation=cv2.INTER_AREA)
    over = grey - cv2.blur(grey.astype(np.float32), _AROUND_PX)
    contrast = np.sqrt(np.maximum(cv2.blur(over**2, _AROUND_PX), 0)) + _NOISE
    return np.asarray(np.clip(128 + 48 * over / contrast, 0, 255).astype(np.uint8))


def _corners(grey: Array) -> tuple[Array, Array]:
    """(N, 2) float32 corners and (N,) their regions: the best of each region, so that no bright target takes them all."""
    height, width = grey.shape
    found: list[Array]
    found, region = [np.zeros((0, 2), np.float32)], [np.zeros(0, np.int64)]
    for place in range(_ACROSS * _DOWN):
        left, right = (width * (place % _ACROSS + i) // _ACROSS for i in (0, 1))
        top, bottom = (height * (place // _ACROSS + i) // _DOWN for i in (0, 1))
        corners = cv2.goodFeaturesToTrack(np.ascontiguousarray(grey[top:bottom, left:right]), _CORNERS, 0.05, 5)
        if corners is not None:
            found.append(corners[:, 0] + np.array([left, top], np.float32))
            region.append(np.full(len(corners), place))
    return np.concatenate(found), np.concatenate(region)
