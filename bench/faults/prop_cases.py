"""Faults of sessions with a prop or a board."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Charuco, Markers, Target
from posefuse.core import Camera, Rig

from .sessions import (
    TIME_STEPS,
    Session,
    board_session,
    merged,
    moved,
    of_camera,
    one_changed,
    prop_session,
    restamped,
    ring,
    solve,
    switched,
    zoomed,
)
from .verdict import Answer, Case
from .waved_props import Waving, cube

TOGETHER = Options(time_steps=TIME_STEPS, clocks="together")
MIDDLE_S = 15.0

Build = Callable[[Session, int], tuple[CornerObservations, tuple[Camera, ...], Target]]


def _case(name: str, cause: str, build: Build, options: Options | None = None, group: str = "prop", why: str = "") -> Case:
    def run(seed: int) -> Answer:
        session = board_session(seed) if group == "board" else prop_session(seed)
        return solve(session.rig, *build(session, seed), options)

    return Case(name, group, cause, run, why)


def _intrinsics(change: Callable[[tuple[Camera, ...]], tuple[Camera, ...]]) -> Build:
    return lambda s, seed: (s.watch(), change(s.rig.cameras), s.target)


def _images(change: Callable[[Session, int], CornerObservations]) -> Build:
    return lambda s, seed: (change(s, seed), s.rig.cameras, s.target)


def _zoom_all(by: float) -> Build:
    return _intrinsics(lambda cameras: tuple(zoomed(camera, by) for camera in cameras))


def _zoom_one(by: float) -> Build:
    return _intrinsics(lambda cameras: one_changed(cameras, 1, zoomed(cameras[1], by)))


def _lens_of(source: Camera, camera: Camera) -> Camera:
    return replace(camera, K=source.K, distortion=source.distortion)


def _permuted(order: tuple[int, ...]) -> Build:
    """Camera i gets the intrinsics of camera order[i], as when the videos' names are swapped."""
    return _intrinsics(lambda cameras: tuple(_lens_of(cameras[order[i]], camera) for i, camera in enumerate(cameras)))


def _no_distortion(which: tuple[int, ...]) -> Build:
    bare = np.zeros(5)
    return _intrinsics(lambda cs: tuple(replace(c, distortion=bare) if i in which else c for i, c in enumerate(cs)))


def _fisheye(session: Session, seed: int) -> tuple[CornerObservations, tuple[Camera, ...], Target]:
    real = ring(4, seed, model="fisheye").cameras[1]
    rig = Rig(one_changed(session.rig.cameras, 1, replace(session.rig.cameras[1], distortion=real.distortion, model="fisheye")))
    return session.watch(rig), session.rig.cameras, session.target


def _turned(which: tuple[int, ...], group: str = "prop") -> Build:
    def build(s: Session, seed: int) -> CornerObservations:
        seen, size = s.watch(), np.array(s.rig.cameras[0].size_wh)
        for camera in which:
            seen = of_camera(seen, camera, size - 1 - seen.xy_img)
        return seen

    return _images(build)


def _twice(noise_px: float) -> Build:
    def build(s: Session, seed: int) -> CornerObservations:
        seen = s.watch()
        copy = seen.rows(seen.camera == 0)
        noise = np.random.default_rng(seed).normal(0, noise_px, copy.xy_img.shape)
        copy = replace(copy, camera=np.ones(len(copy), np.int64), xy_img=copy.xy_img + noise)
        return merged(seen.rows(seen.camera != 1), copy)

    return _images(build)


def _late(*late_s: float) -> Build:
    return _images(lambda s, seed: s.watch(delay_s=late_s))


def _moved(shift_m: float, turn_deg: float, at_s: float = MIDDLE_S) -> Build:
    def build(s: Session, seed: int) -> CornerObservations:
        after = Rig(one_changed(s.rig.cameras, 2, moved(s.rig.cameras[2], shift_m, turn_deg, seed)))
        return switched(s.watch(), s.watch(after), 2, at_s)

    return _images(build)


def _wobbling(s: Session, seed: int) -> CornerObservations:
    seen = s.watch()
    for at_s in np.arange(3.0, 30.0, 3.0):
        turned = moved(s.rig.cameras[2], 0.0, 0.1 * at_s / 3.0, seed)
        seen = switched(seen, s.watch(Rig(one_changed(s.rig.cameras, 2, turned))), 2, float(at_s))
    return seen


def _clock_step(step_s: float) -> Build:
    return _images(lambda s, seed: switched(s.watch(), s.watch(delay_s=(0.0, 0.0, step_s, 0.0)), 2, MIDDLE_S))


def _uneven_stamps(s: Session, seed: int) -> CornerObservations:
    """Every third frame of one camera is stamped a frame too late."""
    seen, period_ns = s.watch(), round(1e9 / s.motion.rate_hz)
    number = np.round(seen.t_ns / period_ns).astype(np.int64)
    return restamped(seen, 2, seen.t_ns + np.where(number % 3 == 0, period_ns * 9 // 10, 0))


def _loose_markers(s: Session, seed: int) -> CornerObservations:
    """Half of the markers move against the others: the prop is not rigid."""
    seen, other = s.watch(), s.watch(motion=replace(s.motion, seed=seed + 50))
    return merged(seen.rows(seen.patch < 3), other.rows(other.patch >= 3))


def _other_side(factor: float) -> Build:
    def build(s: Session, seed: int) -> tuple[CornerObservations, tuple[Camera, ...], Target]:
        assert isinstance(s.target, Markers)
        return s.watch(), s.rig.cameras, replace(s.target, side_m=s.target.side_m * factor)

    return build


def _printed(kind: type[Charuco]) -> Build:
    """The sheet is another one than is stated."""
    return lambda s, seed: (replace(s, target=kind(**vars(s.target))).watch(), s.rig.cameras, s.target)


class _Stretched(Charuco):
    def corners(self, patch: int) -> np.ndarray:
        return super().corners(patch) * [1.0, 1.03, 1.0]


class _Bent(Charuco):
    def corners(self, patch: int) -> np.ndarray:
        flat = super().corners(patch)
        return flat + 0.5 * np.square(flat[:, :1] - flat[:, 0].mean()) * [0.0, 0.0, 1.0]


def _resized(scale_w: float, scale_h: float) -> Build:
    def change(cameras: tuple[Camera, ...]) -> tuple[Camera, ...]:
        width, height = cameras[1].size_wh
        return one_changed(cameras, 1, cameras[1].scaled((round(width * scale_w), round(height * scale_h))))

    return _intrinsics(change)


def _portrait(s: Session, seed: int) -> tuple[CornerObservations, tuple[Camera, ...], Target]:
    """Images recorded on their side, with intrinsics of upright ones."""
    seen, (width, height) = s.watch(), s.rig.cameras[1].size_wh
    sizes = tuple((height, width) if i == 1 else size for i, size in enumerate(seen.sizes_wh))
    turned = of_camera(seen, 1, np.stack([height - 1 - seen.xy_img[:, 1], seen.xy_img[:, 0]], axis=1))
    return replace(turned, sizes_wh=sizes), s.rig.cameras, s.target


def _absent_lens(s: Session, seed: int) -> tuple[CornerObservations, tuple[Camera, ...], Target]:
    return s.watch(), s.rig.cameras[:-1], s.target


def _shifted_centre(px: float) -> Build:
    def change(cameras: tuple[Camera, ...]) -> tuple[Camera, ...]:
        K = cameras[1].K + np.array([[0, 0, px], [0, 0, -px], [0, 0, 0]])
        return one_changed(cameras, 1, replace(cameras[1], K=K))

    return _intrinsics(change)


def _never_together(s: Session, seed: int) -> CornerObservations:
    seen = s.watch()
    late = seen.t_ns >= round(MIDDLE_S * 1e9)
    return seen.rows(np.where(seen.camera >= 2, late, ~late))


def _few_frames(s: Session, seed: int) -> CornerObservations:
    seen = s.watch()
    return seen.rows(np.isin(seen.t_ns, np.unique(seen.t_ns)[::70]))


def _second_prop(s: Session, seed: int) -> CornerObservations:
    other = replace(s, prop=cube(0.3, first_id=10), motion=replace(s.motion, seed=seed + 60, centre_m=(0.5, -0.4, 1.0)))
    return merged(s.watch(), other.watch(missed=0.5))


def _held_still(s: Session, seed: int) -> CornerObservations:
    still = Waving(seconds=30.0, rate_hz=15.0, seed=seed, reach_m=(0.02, 0.02, 0.02), swings_hz=0.02)
    return s.watch(motion=still)


_FOCAL = r"focal length.{0,40}(would rather|off by|moves)|intrinsics of WHO|lenses given are not"
_FOCAL_ALL = _FOCAL.replace("WHO", "all cameras")
_FOCAL_ONE = _FOCAL.replace("WHO", "cam01")
_LENS_ONE = r"intrinsics of cam01|distortion of cam01|lenses given are not"
_MOVED = r"cam02.{0,30} (was )?moved|cam02 disagrees.*moved"

CASES = (
    _case("focal lengths of all +1 %", _FOCAL_ALL, _zoom_all(0.01)),
    _case("focal lengths of all -1.5 %", _FOCAL_ALL, _zoom_all(-0.015)),
    _case("focal lengths of all +2.5 %", _FOCAL_ALL, _zoom_all(0.025)),
    _case("focal lengths of all +5 %", _FOCAL_ALL, _zoom_all(0.05)),
    _case("focal length of one +1.5 %", _FOCAL_ONE, _zoom_one(0.015)),
    _case("focal length of one +3 %", _FOCAL_ONE, _zoom_one(0.03)),
    _case("focal length of one -3 %", _FOCAL_ONE, _zoom_one(-0.03)),
    _case("focal length of one +10 %", _FOCAL_ONE, _zoom_one(0.1)),
    _case("distortion of one not given", _LENS_ONE, _no_distortion((1,))),
    _case(
        "distortion of all not given", r"intrinsics of all|distortion of all|lenses given are not", _no_distortion((0, 1, 2, 3))
    ),
    _case("a fisheye taken as a pinhole", _LENS_ONE, _fisheye),
    _case("principal point of one 25 px off", _LENS_ONE + "|principal point", _shifted_centre(25.0)),
    _case("intrinsics of images of twice the size", r"cam01: images are 640x480 px", _resized(2, 2)),
    _case("intrinsics of 16:9 for 4:3", r"cam01: images are 640x480 px", _resized(1, 0.75)),
    _case("images on their side, intrinsics upright", r"cam01: images are 480x640", _portrait),
    _case("a camera without intrinsics", r"cam03", _absent_lens),
    _case("image of one turned by 180 deg", r"cam01.*turned by 180|upside down: cam01", _turned((1,))),
    _case(
        "images of all turned by 180 deg",
        r"turned by 180|upside down",
        _turned((0, 1, 2, 3)),
        why=("a room seen upside down is a room; with a marker on the floor it is found (cameras are above the floor)"),
    ),
    _case("names of two cameras swapped", r"cam01.*cam02.*swapped", _permuted((0, 2, 1, 3))),
    _case("names of three cameras in a circle", r"cam01.*cam02.*cam03.*(swapped|order)", _permuted((0, 2, 3, 1))),
    _case("one video given twice", r"cam00 and cam01.*(same video|nearest, 0 mm)", _twice(0.0)),
    _case("one video given twice, compressed again", r"cam00 and cam01.*(same video|nearest, \d mm)", _twice(0.1)),
    _case("one camera 100 ms late", r"cam02.*clock|clock.*cam02", _late(0, 0, 0.1, 0)),
    _case(
        "one camera 100 ms late, stated as synchronised",
        r"cam02.*(ms late|clock)|clock.*cam02|cam02 \+1\d\d ms",
        _late(0, 0, 0.1, 0),
        TOGETHER,
    ),
    _case(
        "one camera 20 ms late, stated as synchronised", r"cam02.*(ms late|clock)|clock.*cam02", _late(0, 0, 0.02, 0), TOGETHER
    ),
    _case("one camera 1.2 s late", r"clock.*cam02|cam02.*clock|cam02 \+\d+ ms", _late(0, 0, 1.2, 0)),
    _case("one clock runs 3000 ppm fast", r"cam02.*(drift|ppm|fast)", _images(lambda s, seed: s.watch(drift=(0, 0, 3e-3, 0)))),
    _case("one camera loses a frame: clock jumps by 67 ms", r"clock of cam02 jumps", _clock_step(0.067)),
    _case("one clock jumps by 250 ms", r"clock of cam02 jumps", _clock_step(0.25)),
    _case("every third frame of one camera stamped late", r"(stamps|clock) of cam02", _images(_uneven_stamps)),
    _case("a camera moved by 1 deg and 30 mm", _MOVED, _moved(0.03, 1.0)),
    _case("a camera moved by 0.3 deg", _MOVED, _moved(0.0, 0.3)),
    _case("a camera moved by 30 mm", _MOVED, _moved(0.03, 0.0)),
    _case("a camera moved by 200 mm near the end", _MOVED, _moved(0.2, 0.0, 24.0)),
    _case("a camera that turns slowly, 0.9 deg in all", _MOVED, _images(_wobbling)),
    _case("a camera never sees the prop", r"not found by cam03", _images(lambda s, seed: (o := s.watch()).rows(o.camera != 3))),
    _case("two groups of cameras never see it together", r"cannot be linked", _images(_never_together)),
    _case("7 frames", r"time steps|frames|linked", _images(_few_frames)),
    _case("a second prop with ids of its own", "left out", _images(_second_prop)),
    _case(
        "two equal props",
        r"marker 2 in 81 frames of cam00",
        _images(lambda s, seed: replace(s.watch(), doubled=(("cam00", 2, 81),))),
    ),
    _case("a prop that is not rigid", r"not rigid|left out|never seen together|independently", _images(_loose_markers)),
    _case("the prop is held still", r"(held|kept) still|coverage|too little", _images(_held_still)),
    _case("marker side 24 mm stated for 240", r"marker|side", _other_side(0.1)),
    _case("marker side 0.24 mm stated for 240", r"marker side", _other_side(1e-3)),
    _case("marker side 2400 mm stated for 240", r"marker side", _other_side(10.0)),
    _case(
        "marker side 264 mm stated for 240",
        r"marker side",
        _other_side(1.1),
        why="everything scales with it; `verify` with another target shows it",
    ),
    _case("board: focal length of one +3 %", _FOCAL_ONE, _zoom_one(0.03), group="board"),
    _case("board: focal lengths of all +2 %", _FOCAL_ALL, _zoom_all(0.02), group="board"),
    _case("board: names of two cameras swapped", r"cam01.*cam02.*swapped", _permuted((0, 2, 1, 3)), group="board"),
    _case("board: a camera moved by 1 deg and 30 mm", _MOVED, _moved(0.03, 1.0, 20.0), group="board"),
    _case(
        "board: one camera 100 ms late, stated as synchronised",
        r"cam02.*(ms late|clock)|clock.*cam02|cam02 \+1\d\d ms",
        _late(0, 0, 0.1, 0),
        TOGETHER,
        group="board",
    ),
    _case(
        "board: printed 3 % too long",
        r"(board|target|print).{0,60}(stretched|longer|not as described)",
        _printed(_Stretched),
        group="board",
    ),
    _case("board: bent by 15 mm", r"(board|target).{0,40}(bent|flat|not as described)", _printed(_Bent), group="board"),
    _case("board: image of one turned by 180 deg", r"cam01.*turned by 180|upside down: cam01", _turned((1,)), group="board"),
    _case("board: one video given twice", r"cam00 and cam01.*(same video|nearest, 0 mm)", _twice(0.0), group="board"),
)
