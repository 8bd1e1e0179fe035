"""Faults of sessions in which a person walks: 2D poses in files, through the function that users call."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import posefuse as pf
from posefuse.calibration.clocks.person_tracks import PersonTrack
from posefuse.core import CalibrationError, Camera, InputError, Rig
from posefuse.core.arrays import Array

from .sessions import errors, moved, one_changed, ring, zoomed
from .verdict import Answer, Case
from .walkers import BODY, RATE_HZ, Gait, gait_of, watch

# what a person gives is coarser than what a prop gives
_COARSER = 6.0
SECONDS, STATURE_M = 24.0, 1.75


def person_rig(seed: int) -> Rig:
    """Four cameras."""
    return ring(4, seed, radius_m=4.5, size_wh=(1280, 720))


def calibrate(
    truth: Rig, tracks: Sequence[PersonTrack], cameras: tuple[Camera, ...], height_m: float = STATURE_M, clocks: str = "auto"
) -> Answer:
    """Write the tracks as COCO files, call `posefuse.calibrate_person`, and compare with the truth."""
    with tempfile.TemporaryDirectory() as name:
        files = {track.camera: _written(Path(name) / f"{track.camera}.json", track) for track in tracks}
        try:
            found = pf.calibrate_person(
                files, intrinsics=Rig(cameras), height_m=height_m, rate_hz=RATE_HZ, clocks=clocks, max_offset_s=5.0
            )
        except (CalibrationError, InputError) as error:
            return Answer(True, str(error))
    millimetres, degrees = errors(truth, found.rig)
    return Answer(False, "; ".join(found.report.notes), millimetres / _COARSER, degrees / _COARSER)


def _written(path: Path, track: PersonTrack) -> Path:
    rows = np.concatenate([np.nan_to_num(track.xy_img).round(2), track.score[..., None]], axis=-1).reshape(len(track.t_ns), -1)
    entries = [{"image_id": i, "category_id": 1, "score": 1.0, "keypoints": row.tolist()} for i, row in enumerate(rows)]
    path.write_text(json.dumps(entries))
    return path


Change = Callable[[list[PersonTrack], Rig, int], list[PersonTrack]]


def _case(
    name: str, cause: str, change: Change, height_m: float = STATURE_M, why: str = "", clocks: str = "auto", zoom: float = 0.0
) -> Case:
    """zoom: by which share the stated focal length of cam01 is too large."""

    def run(seed: int) -> Answer:
        truth = person_rig(seed)
        seen = change(watch(truth, gait_of(seed), SECONDS, seed=seed), truth, seed)
        return calibrate(truth, seen, one_changed(truth.cameras, 1, zoomed(truth.cameras[1], zoom)), height_m, clocks)

    return Case(name, "person", cause, run, why)


def _same(seen: list[PersonTrack], rig: Rig, seed: int) -> list[PersonTrack]:
    return seen


def _with(seen: list[PersonTrack], camera: int, xy: Array) -> list[PersonTrack]:
    return [replace(track, xy_img=xy) if c == camera else track for c, track in enumerate(seen)]


def _mirrored(which: tuple[int, ...]) -> Change:
    def change(seen: list[PersonTrack], rig: Rig, seed: int) -> list[PersonTrack]:
        for c in which:
            # a network names sides by their looks
            seen = _with(seen, c, (seen[c].xy_img * [-1, 1] + [rig.cameras[c].size_wh[0] - 1, 0])[:, BODY.mirror])
        return seen

    return change


def _turned(seen: list[PersonTrack], rig: Rig, seed: int) -> list[PersonTrack]:
    return _with(seen, 1, np.array(rig.cameras[1].size_wh) - 1 - seen[1].xy_img)


def _standing(seen: list[PersonTrack], rig: Rig, seed: int) -> list[PersonTrack]:
    return watch(rig, replace(gait_of(seed), speed_m_s=0.01, reach_m=0.05), SECONDS, seed=seed)


def _other_person(seen: list[PersonTrack], rig: Rig, seed: int) -> list[PersonTrack]:
    """Another way, another gait, another height."""
    other = watch(rig, Gait(seed + 1000, 1.62, 6.9, 0.8, 0.8, 1.2), SECONDS, seed=seed)
    return [*seen[:3], other[3]]


def _no_person(seen: list[PersonTrack], rig: Rig, seed: int) -> list[PersonTrack]:
    return [*seen[:3], replace(seen[3], xy_img=np.full(seen[3].xy_img.shape, np.nan), score=0 * seen[3].score)]


def _twice(seen: list[PersonTrack], rig: Rig, seed: int) -> list[PersonTrack]:
    return [seen[0], replace(seen[0], camera=seen[1].camera), *seen[2:]]


def _moved(which: tuple[int, ...], shift_m: float, turn_deg: float, at_s: float = SECONDS / 2) -> Change:
    def change(seen: list[PersonTrack], rig: Rig, seed: int) -> list[PersonTrack]:
        for c in which:
            after = Rig(one_changed(rig.cameras, c, moved(rig.cameras[c], shift_m, turn_deg, seed + c)))
            later = watch(after, gait_of(seed), SECONDS, seed=seed)[c].xy_img
            seen = _with(seen, c, np.where((seen[c].t_s >= at_s)[:, None, None], later, seen[c].xy_img))
        return seen

    return change


def _late(*late_s: float) -> Change:
    return lambda seen, rig, seed: watch(rig, gait_of(seed), SECONDS, late_s=late_s, seed=seed)


def _frames_lost(seen: list[PersonTrack], rig: Rig, seed: int) -> list[PersonTrack]:
    """Ten frames of one camera are gone, and the rest numbered as if they were not."""
    track, kept = seen[2], np.r_[:144, 154 : len(seen[2].t_ns)]
    return [*seen[:2], replace(track.at(kept), t_ns=track.t_ns[: len(kept)]), seen[3]]


def _of_another_rate(seen: list[PersonTrack], rig: Rig, seed: int) -> list[PersonTrack]:
    """One file has 10 frames per second, and is read as one of 12."""
    track = watch(rig, gait_of(seed), SECONDS, seed=seed, rate_hz=10.0)[2]
    return [*seen[:2], replace(track, t_ns=seen[2].t_ns[: len(track.t_ns)]), seen[3]]


CASES = (
    _case("person: height 0.5 m stated", r"height.*0\.5", _same, 0.5),
    _case("person: height 178 m stated", r"height.*178", _same, 178.0),
    _case("person: height 10 % too large", r"height", _same, 1.1 * STATURE_M, why="everything scales with the height"),
    _case("person: images of all mirrored", r"mirrored", _mirrored((0, 1, 2, 3)),
          why="a mirrored room is a room, and a network names sides by their looks"),
    _case("person: image of one mirrored", r"cam01.*mirrored|mirrored.*cam01", _mirrored((1,))),
    _case("person: image of one turned by 180 deg", r"upside down: cam01|cam01.*turned by 180", _turned),
    _case("person: stands in one place", r"walks about", _standing),
    _case("person: another person in one camera", r"cam03.*(another|other) person|another person.*cam03", _other_person),
    _case("person: one camera sees no person", r"cam03 \(0 of", _no_person),
    _case("person: one video given twice", r"cam00 and cam01.*(same video|nearest)", _twice),
    _case("person: a camera moved by 6 deg and 300 mm", r"cam02 was moved", _moved((2,), 0.3, 6.0)),
    _case("person: a camera turned by 1 deg", r"cam02 was moved", _moved((2,), 0.0, 1.0)),
    _case("person: a camera turned by 3 deg near the end", r"cam02 was moved", _moved((2,), 0.0, 3.0, 0.8 * SECONDS)),
    _case("person: two cameras turned by 2 deg", r"cam00 was moved.*cam02 was moved|cam02 was moved.*cam00 was moved",
          _moved((0, 2), 0.0, 2.0)),
    _case("person: focal length of one +25 %", r"cam01.*(intrinsics|focal)|intrinsics of cam01", _same, zoom=0.25),
    _case("person: one camera 100 ms late", r"clock", _late(0, 0, 0.1, 0)),
    _case("person: one camera 100 ms late, stated as synchronised", r"cam02.*(clock|late|unsynchronised)", _late(0, 0, 0.1, 0),
          clocks="together"),
    _case("person: one camera 1.4 s late", r"cam02.*(clock|late|unsynchronised)", _late(0, 0, 1.4, 0)),
    _case("person: 10 frames of one camera lost, the others renumbered", r"cam02.*(frames were lost|later|clock)", _frames_lost),
    _case("person: one file of another frame rate", r"cam02.*(rate|clock|later)", _of_another_rate),
)  # fmt: skip
