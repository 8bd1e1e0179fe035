"""Faults of sessions in which a person walks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from posefuse.calibration.clocks.person_tracks import PersonTrack
from posefuse.calibration.person.scale import KnownLength
from posefuse.calibration.person.settle import calibrate_out_of_step, unplaced_clocks
from posefuse.calibration.person.solve import calibrate_from_person
from posefuse.calibration.person.synthetic_walk import BODY, STATURE_M, walker, watch_walker
from posefuse.calibration.person.views import PersonViews
from posefuse.core import CalibrationError, Camera, Rig
from posefuse.core.arrays import Array

from .sessions import errors, moved, one_changed, ring, zoomed
from .verdict import Answer, Case

# what a person gives is coarser than what a prop gives
_COARSER = 6.0


def person_rig(seed: int) -> Rig:
    """Four cameras."""
    return ring(4, seed, radius_m=4.5)


def calibrate(truth: Rig, views: PersonViews, cameras: tuple[Camera, ...], length_m: float) -> Answer:
    """From synchronised views, compared with the truth."""
    try:
        found = calibrate_from_person(views, cameras, KnownLength(stature_m=length_m))
    except CalibrationError as error:
        return Answer(True, str(error))
    return _compared(truth, found.rig, "; ".join(found.report.notes))


def calibrate_with_clocks(truth: Rig, late_s: tuple[float, ...], clocks: str, noise_px: float, seed: int) -> Answer:
    """From cameras with clocks of their own."""
    random, stamps, length = np.random.default_rng([seed, 2]), np.arange(240) / 12, KnownLength(stature_m=STATURE_M)
    tracks = []
    for camera, late in zip(truth, late_s, strict=True):
        xy = camera.project(walker(stamps - late))
        every = np.ones(xy.shape[:2])
        noisy = xy + random.normal(0, noise_px, xy.shape)
        tracks.append(PersonTrack(camera.name, BODY, np.round(stamps * 1e9), noisy, 0.9 * every, noise_px * every))
    try:
        start = unplaced_clocks(tracks, truth.cameras, length, clocks, 1.0)
        if start is None:
            views = PersonViews(truth.names, BODY, tracks[0].t_ns, *(np.stack([getattr(t, n) for t in tracks])
                                for n in ("xy_img", "score", "sigma_px")))  # fmt: skip
            rig, words = calibrate_from_person(views, truth.cameras, length).rig, ""
        else:
            found, _ = calibrate_out_of_step(tracks, truth.cameras, length, start, False)
            rig, words = found.rig, "; ".join(found.report.notes)
    except CalibrationError as error:
        return Answer(True, str(error))
    return _compared(truth, rig, words)


def _compared(truth: Rig, found: Rig, words: str) -> Answer:
    millimetres, degrees = errors(truth, found)
    return Answer(False, words, millimetres / _COARSER, degrees / _COARSER)


Change = Callable[[PersonViews, Rig, int], PersonViews]


def _case(name: str, cause: str, change: Change, height_m: float = STATURE_M, why: str = "") -> Case:
    def run(seed: int) -> Answer:
        truth = person_rig(seed)
        return calibrate(truth, change(watch_walker(truth, seconds=20.0, seed=seed), truth, seed), truth.cameras, height_m)

    return Case(name, "person", cause, run, why)


def _lenses(name: str, cause: str, change: Callable[[tuple[Camera, ...]], tuple[Camera, ...]], why: str = "") -> Case:
    def run(seed: int) -> Answer:
        truth = person_rig(seed)
        return calibrate(truth, watch_walker(truth, seconds=20.0, seed=seed), change(truth.cameras), STATURE_M)

    return Case(name, "person", cause, run, why)


def _same(views: PersonViews, rig: Rig, seed: int) -> PersonViews:
    return views


def _with(views: PersonViews, camera: int, xy: Array) -> PersonViews:
    seen = views.xy_img.copy()
    seen[camera] = xy
    return replace(views, xy_img=seen)


def _mirrored(which: tuple[int, ...]) -> Change:
    def change(views: PersonViews, rig: Rig, seed: int) -> PersonViews:
        for c in which:
            views = _with(views, c, views.xy_img[c] * [-1, 1] + [rig.cameras[c].size_wh[0] - 1, 0])
        return views

    return change


def _turned(views: PersonViews, rig: Rig, seed: int) -> PersonViews:
    return _with(views, 1, np.array(rig.cameras[1].size_wh) - 1 - views.xy_img[1])


def _standing(views: PersonViews, rig: Rig, seed: int) -> PersonViews:
    still = np.stack([camera.project(walker(views.t_ns / 1e9, lap_rad_s=0.0)) for camera in rig])
    return replace(views, xy_img=still + np.random.default_rng(seed).normal(0, 1, still.shape))


def _other_person(views: PersonViews, rig: Rig, seed: int) -> PersonViews:
    return _with(views, 3, rig.cameras[3].project(walker(views.t_ns / 1e9 + 3.0, (0.8, 0.5))))


def _no_person(views: PersonViews, rig: Rig, seed: int) -> PersonViews:
    return _with(views, 3, np.full(views.xy_img[3].shape, np.nan))


def _twice(views: PersonViews, rig: Rig, seed: int) -> PersonViews:
    return _with(views, 1, views.xy_img[0])


def _moved_camera(views: PersonViews, rig: Rig, seed: int) -> PersonViews:
    after = Rig(one_changed(rig.cameras, 2, moved(rig.cameras[2], 0.3, 6.0, seed)))
    seen = watch_walker(after, seconds=20.0, seed=seed)
    late = (views.t_ns > 10_000_000_000)[:, None, None]
    return _with(views, 2, np.where(late, seen.xy_img[2], views.xy_img[2]))


def _late(name: str, late_s: float, clocks: str, cause: str) -> Case:
    return Case(name, "person", cause, lambda s: calibrate_with_clocks(person_rig(s), (0, 0, late_s, 0), clocks, 1.0, s))


CASES = (
    _case("person: height 0.5 m stated", r"height.*0\.5", _same, 0.5),
    _case("person: height 178 m stated", r"height.*178", _same, 178.0),
    _case("person: height 10 % too large", r"height", _same, 1.1 * STATURE_M, why="everything scales with the height"),
    _case("person: images of all mirrored", r"mirrored", _mirrored((0, 1, 2, 3))),
    _case("person: image of one mirrored", r"cam01.*mirrored|mirrored.*cam01", _mirrored((1,))),
    _case("person: image of one turned by 180 deg", r"upside down: cam01|cam01.*turned by 180", _turned),
    _case("person: stands in one place", r"walks about", _standing),
    _case("person: another person in one camera", r"cam03.*(another|other) person|another person.*cam03", _other_person),
    _case("person: one camera sees no person", r"cam03 \(0 of", _no_person),
    _case("person: one video given twice", r"cam00 and cam01.*(same video|nearest)", _twice),
    _case("person: a camera moved by 6 deg and 300 mm", r"cam02.*moved", _moved_camera),
    _lenses("person: focal length of one +25 %", r"cam01.*(intrinsics|focal)|intrinsics of cam01",
            lambda cs: one_changed(cs, 1, zoomed(cs[1], 0.25))),
    _late("person: one camera 100 ms late", 0.1, "auto", r"clock"),
    _late("person: one camera 100 ms late, stated as synchronised", 0.1, "together", r"cam02.*(clock|late|unsynchronised)"),
)  # fmt: skip
