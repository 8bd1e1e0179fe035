"""False alarms about healthy cameras, per camera-hour of simulated time.

    python bench/false_alarms.py [--hours 10] [--seed 0] [--only "30/s, loop" ...] [--without pause gap]

Four healthy cameras look at a person who walks, hurries or stands in turn; what they see goes through the rig watch as in a
live session (`realtime.rig_watch.RigWatcher`), as fast as the processor can. Frames come at a rate of 5 to 60 a second, jitter,
are lost, half of them are not used (overload), or the clip begins again every 4.3 s, after the pause that looped sources make.
Noise is the default network's on the demo clip. Table on stderr, one JSON object on stdout.

`--without` takes a rule away, on the same scenes and noise: `pause` leaves none between two showings, `gap` interpolates
between views however far apart they are.
"""

import numpy as np
from harness import answer, arguments, note
from scenes import SIGMA_PX, Place, circle, noise, scene_of_person

from posefuse.calibration.keypoints import limb_keypoints
from posefuse.core import Rig
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.health import misalignment
from posefuse.realtime.capture import LOOP_PAUSE_S
from posefuse.realtime.rig_watch import RigWatcher

LIMBS = limb_keypoints(ANATOMICAL23.keypoints)
BLOCK_S = 60.0
MOTIONS = (circle(1.4), circle(1.6, 1.9), {"kind": "idle"})
# rate, jitter of the exposure in periods, share that is lost, seconds between cuts
CASES = {
    "30/s": (30.0, 0.0, 0.0, None),
    "30/s, jitter, 10 % lost": (30.0, 0.3, 0.1, None),
    "60/s": (60.0, 0.05, 0.02, None),
    "10/s": (10.0, 0.05, 0.0, None),
    "10/s, jitter, 10 % lost": (10.0, 0.3, 0.1, None),
    "5/s": (5.0, 0.05, 0.0, None),
    "30/s, overload": (30.0, 0.05, 0.5, None),
    "30/s, loop": (30.0, 0.05, 0.02, 4.3),
}


def alarms(rig: Rig, place: Place, case: tuple, seed: int, pause_s: float = LOOP_PAUSE_S) -> list[str]:
    """What is reported about healthy cameras in one block of time. pause_s: between two showings of the clip."""
    rate_hz, jitter, lost, cut_s = case
    events = []
    for c, camera in enumerate(rig):
        rng = np.random.default_rng([seed, c])
        t_s = rng.uniform(0, 1 / rate_hz) + np.arange(int(BLOCK_S * rate_hz) - 1) / rate_hz
        t_s = np.sort(t_s + rng.uniform(-jitter / 2, jitter / 2, len(t_s)) / rate_hz)
        t_s = t_s[rng.random(len(t_s)) >= lost]
        exact = camera.project(place(t_s if cut_s is None else t_s % cut_s))
        xy = exact + SIGMA_PX * noise(rng, t_s, exact.shape[1])
        shown_s = t_s if cut_s is None else t_s + np.floor(t_s / cut_s) * pause_s
        events += [(t, camera.name, one[LIMBS]) for t, one in zip(shown_s, xy, strict=True)]
    watcher, said, before, looked_s = RigWatcher(rig, clocks=False), [], set(), 0.0
    for t, name, xy in sorted(events, key=lambda one: one[0]):
        watcher.add(name, 10**15 + round(t * 1e9), xy, np.full(len(xy), 0.9))
        if t - looked_s > 0.25:
            looked_s = t
            faulty = {(camera, verdict.state) for camera, verdict in watcher.look().faulty.items()}
            said += [f"{camera}: {state}" for camera, state in sorted(faulty - before)]
            before = faulty
    return said


def main() -> None:
    args = arguments(__doc__, hours=10.0, seed=0, only=CASES, without=frozenset(("pause", "gap")))
    if "gap" in args.without:
        misalignment._REACH_NS = 10**12
    pause_s = 0.0 if "pause" in args.without else LOOP_PAUSE_S
    scenes = [scene_of_person(motion, 4, BLOCK_S, args.seed) for motion in MOTIONS]
    blocks = max(len(MOTIONS), round(args.hours * 3600 / BLOCK_S / len(args.only)))
    hours, rows = blocks * BLOCK_S / 3600 * 4, []
    for case in args.only:
        said = [
            line
            for block in range(blocks)
            for line in alarms(*scenes[block % len(scenes)], CASES[case], args.seed + block, pause_s)
        ]
        about = {"camera_hours": hours, "alarms": len(said), "per_camera_hour": len(said) / hours, "said": sorted(set(said))}
        rows.append({"case": case, **about})
        note(case, len(said))
    answer(args, {"False alarms about healthy cameras": rows})


if __name__ == "__main__":
    main()
