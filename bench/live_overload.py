"""The output of an overloaded session: poses far from the truth, and how many of them state a large uncertainty.

    python bench/live_overload.py [--seconds 60] [--seed 0]

A person walks a circle in front of four cameras; the clip is cut every 4.3 s, as a looped video is. Only every second frame is
used, views are up to 0.3 s old, and every 6 s all cameras but one fall silent for 1.2 s. Poses go out 100 times a second, once
as the tracker makes them and once through the gate of the settings. A hip is impossible where it is more than 0.5 m from
all places of the clip. Table on stderr, one JSON object on stdout.
"""

import numpy as np
from harness import answer, arguments, covariances, played
from scenes import WARM_UP_S, Arrivals, Place, arriving, circle, new_tracker, output_ticks, scene_of_person

from posefuse.core import Pose3D
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.realtime.config import KeypointGateSettings
from posefuse.realtime.estimator import KeypointGate

LATENCY_S, USED = (0.05, 0.3), 0.5
CUT_S, ALONE_EVERY_S, ALONE_S = 4.3, 6.0, 1.2
IMPOSSIBLE_M = 0.5
SIGMAS_M = (0.1, 0.15, 0.3, 1.0)
HIPS = ("left_hip", "right_hip")


def overloaded(come: Arrivals, cameras: int, seed: int) -> Arrivals:
    """The views that are left."""
    rng, left = np.random.default_rng(seed), []
    for at_ns, view in come:
        t_s = view.t_ns / 1e9
        only = f"cam{int(t_s / ALONE_EVERY_S) % cameras:02d}" if t_s % ALONE_EVERY_S > ALONE_EVERY_S - ALONE_S else None
        if rng.random() < USED and only in (None, view.camera):
            left.append((at_ns, view))
    return left


def outcome(poses: list[Pose3D], place: Place) -> dict:
    """Shares of hips that are stated unsure, and that are impossible, by what is stated."""
    at = ANATOMICAL23.indices(HIPS)
    clip = place(np.arange(0, CUT_S, 0.02))[:, at]
    got = np.array([pose.xyz_world[0, at] if len(pose.person_id) else np.full((2, 3), np.nan) for pose in poses])
    there = np.isfinite(got[..., 0])
    sigma = np.sqrt(np.trace(covariances(poses, HIPS), axis1=-2, axis2=-1) / 3)[there]
    away = np.linalg.norm(got[:, None] - clip, axis=-1).min(axis=1)[there]
    return {
        "found": float(there.mean()),
        **{f"sigma > {limit:g} m": float((sigma > limit).mean()) for limit in SIGMAS_M},
        "impossible": float((away > IMPOSSIBLE_M).mean()),
        "impossible_of_sure": float((away[sigma < 0.1] > IMPOSSIBLE_M).mean()),
        "p99_m": float(np.percentile(away, 99)),
        "farthest_m": float(away.max()),
    }


def main() -> None:
    args = arguments(__doc__, seconds=60.0, seed=0)
    rig, whole = scene_of_person(circle(1.4), 4, args.seconds, args.seed)

    def place(t_s: np.ndarray) -> np.ndarray:
        return whole(np.asarray(t_s) % CUT_S)

    come = overloaded(arriving(rig, place, args.seconds, args.seed, latency_s=LATENCY_S), len(rig), args.seed)
    gate = KeypointGate(KeypointGateSettings())
    made = list(played(new_tracker(rig, ANATOMICAL23), come, output_ticks(args.seconds)))
    late = [pose.t_ns >= WARM_UP_S * 1e9 for pose in made]
    rows = []
    for name, poses in (("tracker", made), ("sent", [gate.passed(pose) for pose in made])):
        rows.append({"poses": name, **outcome([pose for pose, kept in zip(poses, late, strict=True) if kept], place)})
    answer(args, {"Hips of an overloaded session": rows}, withheld=gate.figures())


if __name__ == "__main__":
    main()
