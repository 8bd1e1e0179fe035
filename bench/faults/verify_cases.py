"""Rigs that are no longer correct, and the answer of `verify` with a marker held in the room.

    PYTHONPATH=bench python -m faults.verify_cases [--seeds 0 1 2]

prints which cameras are named when one camera of a rig is wrong: eight errors, two set-ups, in a camera drawn by the seed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np

from posefuse.calibration.solving.rotations import angle_between
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Charuco, Target
from posefuse.calibration.verify import verify
from posefuse.core import CalibrationError, Camera, Rig

from .sessions import moved, one_changed, prop_session, ring, zoomed
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


BENDS: dict[str, Callable[[Camera, int], Camera]] = {
    "moved by 15 mm": lambda camera, seed: moved(camera, 0.015, 0.0, seed),
    "moved by 30 mm": lambda camera, seed: moved(camera, 0.03, 0.0, seed),
    "moved by 60 mm": lambda camera, seed: moved(camera, 0.06, 0.0, seed),
    "turned by 0.3 deg": lambda camera, seed: moved(camera, 0.0, 0.3, seed),
    "turned by 0.5 deg": lambda camera, seed: moved(camera, 0.0, 0.5, seed),
    "turned by 1 deg": lambda camera, seed: moved(camera, 0.0, 1.0, seed),
    "focal length +1.2 %": lambda camera, seed: zoomed(camera, 0.012),
    "focal length +3 %": lambda camera, seed: zoomed(camera, 0.03),
}


@cache
def true_session(set_up: str, seed: int) -> tuple[Rig, Target, CornerObservations]:
    """A rig that is right, and what its cameras see of a target."""
    if set_up == "board, four on one side":
        truth = room(seed)
        return truth, TARGET, held_board(truth, seed)
    session = prop_session(seed)
    return session.rig, session.target, session.watch()


def bent(set_up: str, bend: str, seed: int) -> tuple[str, str, float]:
    """Who is named ("right", "right and others", "only others", "passed"), the words, and how many stated standard errors the
    stated pose of the culprit is from the true one."""
    index, (truth, target, seen) = list(BENDS).index(bend), true_session(set_up, seed)
    culprit = int(np.random.default_rng([seed, index]).integers(len(truth)))
    camera = BENDS[bend](truth.cameras[culprit], 100 * seed + index)
    found = verify(Rig(one_changed(truth.cameras, culprit, camera)), seen, target)
    named = {one.name for one in found.cameras if one.excess > 1}
    mine, own = found.cameras[culprit], truth.cameras[culprit]
    turn_rad = angle_between(*(one.cam_from_world.matrix()[None] for one in (camera, own)))[0]
    shift_m = np.linalg.norm(camera.centre_world - own.centre_world)
    off = max(abs(mine.turn_rad - turn_rad) / mine.turn_sigma, abs(mine.shift_m - shift_m) / mine.shift_sigma)
    right = own.name in named
    who = ("right and others" if len(named) > 1 else "right") if right else "only others" if named else "passed"
    return who, next(check.detail for check in found.report.checks), float(off)


def main() -> None:
    from harness import answer as answered
    from harness import arguments, note

    args = arguments(__doc__, seeds=(0, 1, 2))
    names, off = ("right", "right and others", "only others", "passed"), []
    rows = {bend: dict.fromkeys(names, 0) for bend in BENDS}
    for bend, set_up, seed in product(BENDS, ("board, four on one side", "cube, ring of four"), args.seeds):
        who, words, sigmas = bent(set_up, bend, seed)
        rows[bend][who] += 1
        off.append(sigmas)
        note(f"{bend}, {set_up}, {seed}: {who}, {sigmas:.1f} sigma: {words}")
    errors = {"median": float(np.nanmedian(off)), "90 %": float(np.nanquantile(off, 0.9))}
    rows[f"all {len(off)}"] = {name: sum(row[name] for row in rows.values()) for name in names}
    named = [{"one camera is": bend, **row} for bend, row in rows.items()]
    answered(args, {"Named": named, "Error over stated standard error": [errors]})


if __name__ == "__main__":
    main()
