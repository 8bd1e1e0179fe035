"""Live tracking of rendered people with the default network's own errors: how far the skeleton is off when it comes out.

    python bench/live_rendered.py --keep DIR [--bodies 2] [--seeds 1,2] [--rows idle] [--session DIR] [--arrive late]
    python bench/live_rendered.py --keep DIR --develop --seeds 7300,7301 --body off on --from-s 1.5

Four cameras of 640 x 480 at 30 frames/s look at bodies that no constant was fitted to: their seeds are drawn by chance at the
first run and kept in DIR, with the scenes; `--develop` takes bodies of the development, too. Views arrive 20 to 60 ms after their
exposure (*late*), as in a session of two cores, or *at once*; poses come out at 100 Hz, at joint centres, and are compared with
the truth at their own time. `--session` adds a rendered session, such as examples/demo.

By row: mean error of 12 joints; NEES, 3 where the stated covariance is honest; the share of joints that came out; the standard
deviation over time of the lengths of arms and legs; the largest distance between two places of a foot that in truth stands, over
all of the stance and without its first 0.2 s, in which no causal tracker knows of it. Before 1.5 s a skeleton is still learnt.
Tables on stderr, one JSON object on stdout.
"""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from bodies import ARRIVE, MOVES, WARM_UP_S, Trial, seeds_of, trial_session
from body_figures import skate_mm
from harness import OUT, Use, answer, arguments, covariances, errors, medians, score

from posefuse.core import Pose3D, PoseSequence, Truth
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.realtime.config import LiveConfig

BONES = [
    [end.format(side=side) for end in SEGMENT_ENDS[bone]]
    for side in ("left", "right")
    for bone in ("upper_arm", "forearm", "thigh", "shank")
]
LATER_S = 0.2


def figures(poses: list[Pose3D], truth: Truth) -> dict[str, float]:
    skeleton, xyz = poses[0].skeleton, np.array([pose.xyz_world[0] for pose in poses])
    lengths = [np.linalg.norm(xyz[:, skeleton.index(a)] - xyz[:, skeleton.index(b)], axis=-1) for a, b in BONES]
    found, sequence = score(errors(poses, truth), covariances(poses)), PoseSequence.from_poses(poses)
    return {
        **{name: found[name] for name in ("mean_mm", "nees", "found")},
        "lengths_sd_mm": 1000 * float(np.nanmean(np.nanstd(lengths, axis=1))),
        "slide_mm": skate_mm(sequence, truth),
        "slide_later_mm": skate_mm(sequence, truth, after_s=LATER_S),
    }


def measured(session: Path, seed: int, arrive: str, body: str, from_s: float) -> dict[str, float]:
    trial = Trial.of(session, arrive, seed)
    begin_ns = int(trial.truth.t_ns[0]) + round(1e9 * from_s)
    return figures([pose for pose in trial.poses(replace(LiveConfig(), body=body)) if pose.t_ns >= begin_ns], trial.truth)


def main() -> None:
    args = arguments(
        __doc__, keep=OUT / "scenes", bodies=2, seeds="", rows=dict.fromkeys(MOVES), session=Path, arrive=ARRIVE, body=("auto",),
        from_s=WARM_UP_S, develop=False,
    )  # fmt: skip
    use, seeds = Use.DEVELOP if args.develop else Use.REPORT, seeds_of(args.keep, args.bodies, args.seeds)
    sessions = {row: [(trial_session(args.keep, row, seed, use), seed) for seed in seeds] for row in args.rows}
    sessions |= {args.session.name: [(args.session, 0)]} if args.session else {}
    rows, each = [], []
    for motion, arrive, body in product(sessions, args.arrive, args.body):
        about = {"motion": motion, "views": arrive, "body": body}
        found = [measured(session, seed, arrive, body, args.from_s) for session, seed in sessions[motion]]
        each += [{**about, "seed": seed, **one} for (_, seed), one in zip(sessions[motion], found, strict=True)]
        rows.append({**about, **medians(found, np.nanmean)})
    answer(args, {"Each body": each, "Means": rows}, seeds=seeds)


if __name__ == "__main__":
    main()
