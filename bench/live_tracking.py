"""Live tracking of moving people: how far the skeleton is from the truth at the moment it comes out.

    python bench/live_tracking.py [--seconds 20] [--cameras 4] [--seed 0]

Cameras of 30 frames/s that are not synchronised (random phases), every view 25 to 125 ms old when it arrives, 5 % lost; output
at 100 Hz. Noise as the default network's on the demo clip: its size, and how much of it lasts from frame to frame. Tables on
stderr, one JSON object on stdout. NEES is the squared error in units of the stated covariance: 3 when it is honest.

Two more rows show what limits the tracker: *exact views* leaves what cannot be foreseen while views are on their
way, *at once* (views without latency) what noise leaves.
"""

import time
from collections.abc import Sequence

import numpy as np
from harness import answer, arguments, covariances, played, score
from scenes import (
    WARM_UP_S,
    Arrivals,
    Place,
    arriving,
    circle,
    jumping,
    new_tracker,
    output_ticks,
    scene_of_person,
    swinging,
    view_of,
)

from posefuse.core import Rig
from posefuse.core.skeleton import ANATOMICAL23, BLAZEPOSE33

# motion, what the person does in addition, and the keypoints whose error counts as moving; where no others are named: all
MOTIONS = {
    "stand": ({"kind": "idle"}, None, ANATOMICAL23.keypoints),
    "walk": (circle(1.4), None, ("left_ankle", "right_ankle", "left_wrist", "right_wrist")),
    "arm swing": ({"kind": "idle"}, swinging, ("left_wrist", "right_wrist", "left_elbow", "right_elbow")),
    "jump": ({"kind": "idle"}, jumping, ANATOMICAL23.keypoints),
}
# the least noise the tracker reckons with, and no confusions; no latency
WAYS: dict[str, dict] = {"as in use": {}, "exact views": {"sigma_px": 0.3}, "at once": {"latency_s": (0.0, 0.001)}}


def accuracy(rig: Rig, place: Place, moving: Sequence[str], come: Arrivals, seconds: float) -> dict:
    """Errors of the first person against the truth at output time, and of the keypoints `moving` fast."""
    poses = [p for p in played(new_tracker(rig, ANATOMICAL23), come, output_ticks(seconds)) if p.t_ns >= WARM_UP_S * 1e9]
    missing = np.full((len(ANATOMICAL23), 3), np.nan)
    got = np.array([pose.xyz_world[0] if len(pose.person_id) else missing for pose in poses])
    error, cov = got - place(np.array([pose.t_ns for pose in poses]) / 1e9), covariances(poses, ANATOMICAL23.keypoints)
    fast = ANATOMICAL23.indices(moving)
    of_fast = score(error[:, fast], cov[:, fast])
    return {**score(error, cov), **{f"fast_{name}": of_fast[name] for name in ("mean_mm", "p95_mm", "nees")}}


def microseconds(seconds: float, cameras: int, seed: int) -> dict:
    """Of one `add` and one `at` for one person of 33 keypoints who walks."""
    rig, place = scene_of_person(MOTIONS["walk"][0], cameras, seconds, seed)
    places = np.resize(np.arange(len(ANATOMICAL23)), len(BLAZEPOSE33))
    tracker, ticks = new_tracker(rig, BLAZEPOSE33), iter(output_ticks(seconds + 1))
    spent: dict[str, list[float]] = {"add": [], "at": []}

    def timed(name: str, *given: object) -> None:
        began = time.perf_counter()
        getattr(tracker, name)(*given)
        spent[name].append(1e6 * (time.perf_counter() - began))

    due_ns = next(ticks)
    for at_ns, view in arriving(rig, place, seconds, seed):
        timed("add", view_of(view.camera, view.t_ns, BLAZEPOSE33, view.xy_img[0, places]))
        while due_ns <= at_ns:
            timed("at", due_ns)
            due_ns = next(ticks)
    return {f"{name}_us_p{share}": float(np.percentile(us, share)) for name, us in spent.items() for share in (50, 95)}


def main() -> None:
    args = arguments(__doc__, seconds=20.0, cameras=4, seed=0)
    rows = []
    for name, (motion, change, moving) in MOTIONS.items():
        rig, place = scene_of_person(motion, args.cameras, args.seconds, args.seed)
        place = change(place) if change else place
        for way, changes in WAYS.items():
            come = arriving(rig, place, args.seconds, args.seed, **changes)
            rows.append({"motion": name, "views": way, **accuracy(rig, place, moving, come, args.seconds)})
    speed = microseconds(min(args.seconds, 10.0), args.cameras, args.seed)
    tables = {"Error against the truth at output time": rows, "33 keypoints: microseconds of the tracker": [speed]}
    answer(args, tables, cameras=args.cameras, seconds=args.seconds)


if __name__ == "__main__":
    main()
