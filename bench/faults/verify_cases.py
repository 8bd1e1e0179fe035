"""Rigs that are no longer correct, and the answer of `verify` with a marker held in the room."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Charuco
from posefuse.calibration.verify import verify
from posefuse.core import CalibrationError, Rig

from .sessions import moved, one_changed, ring, zoomed
from .verdict import Answer, Case
from .waved_props import Faults, Waving, board, observe_prop

_WRONG = 1e6
TARGET = Charuco(columns=5, rows=7, square_m=0.09, marker_m=0.065)


def room(seed: int) -> Rig:
    """Four cameras that share a view of a board."""
    rig = ring(10, seed, radius_m=3.0)
    return Rig(tuple(replace(rig.cameras[i], name=f"cam{i:02d}") for i in range(4)))


def held_board(rig: Rig, seed: int, noise_px: float = 0.15, **faults: object) -> CornerObservations:
    """A board carried through the room for a minute: in less, a camera at the end of the row may hardly meet its face."""
    motion = Waving(seconds=60.0, rate_hz=10.0, seed=seed, reach_m=(0.7, 0.7, 0.5), swings_hz=0.2)
    return observe_prop(rig, board(), TARGET, motion, Faults(noise_px=noise_px, seed=seed, **faults))


def answer(rig: Rig, seen: CornerObservations, wrong: bool = True) -> Answer:
    """The result of verification; a rig that passes although it is wrong counts as silent."""
    try:
        verify(rig, seen, TARGET).report.require()
    except CalibrationError as error:
        return Answer(True, str(error))
    return Answer(False, "", _WRONG if wrong else 0.0)


def _case(name: str, cause: str, change: Callable[[Rig, int], Rig]) -> Case:
    def run(seed: int) -> Answer:
        truth = room(seed)
        return answer(change(truth, seed), held_board(truth, seed))

    return Case(name, "verify", cause, run)


def _one(change: Callable[[Rig, int], object]) -> Callable[[Rig, int], Rig]:
    return lambda rig, seed: Rig(one_changed(rig.cameras, 2, change(rig, seed)))


def _unseen(seed: int) -> Answer:
    truth = room(seed)
    seen = held_board(truth, seed)
    wrong = Rig(one_changed(truth.cameras, 3, moved(truth.cameras[3], 0.0, 5.0, seed)))
    return answer(wrong, seen.rows(seen.camera < 2))


def _scaled(rig: Rig) -> Rig:
    larger = [replace(c, cam_from_world=replace(c.cam_from_world, xyz=1.02 * c.cam_from_world.xyz)) for c in rig]
    return Rig(tuple(larger))


CASES = (
    _case("verify: a camera turned by 0.5 deg", r"cam02", _one(lambda r, s: moved(r.cameras[2], 0.0, 0.5, s))),
    _case("verify: a camera moved by 50 mm", r"cam02", _one(lambda r, s: moved(r.cameras[2], 0.05, 0.0, s))),
    _case("verify: a camera moved by 20 mm", r"cam02", _one(lambda r, s: moved(r.cameras[2], 0.02, 0.0, s))),
    _case("verify: focal length of one +3 %", r"cam02", _one(lambda r, s: zoomed(r.cameras[2], 0.03))),
    _case("verify: a camera turned by 3 deg", r"cam02", _one(lambda r, s: moved(r.cameras[2], 0.0, 3.0, s))),
    _case("verify: the rig 2 % too large", r"scale", lambda rig, seed: _scaled(rig)),
    Case("verify: two cameras never see the board, one is 5 deg off", "verify", r"cam02.*cam03|cam03", _unseen),
    Case("verify: one camera 100 ms late", "verify", r"cam02.*(late|clock)|clock.*cam02",
         lambda s: answer(room(s), held_board(room(s), s, delay_s=(0.0, 0.0, 0.1, 0.0)))),
)  # fmt: skip
