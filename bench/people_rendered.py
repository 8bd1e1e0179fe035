"""Two rendered people who cross at 0.28 m, five cameras, the bundled network: are they kept apart, and as exact as alone?

    python bench/people_rendered.py [--seconds 4] [--alone] [--kept FOLDER]

Figures as in `bench/people.py`; `--alone` renders and tracks each person alone, too. What is rendered is kept between runs. A
JSON object on stdout.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from crowds import crowd_row, person_distances
from harness import answer, arguments, rendered, scene_from, tracked, truth_of
from scenes import walk

from posefuse.core import PoseSequence, Truth
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at
from posefuse_sim.scene import Scene

RATE_HZ = 30.0
PATHS = (((-1.6, -0.14), (1.6, -0.14)), ((1.6, 0.14), (-1.6, 0.14)))
FOUND = 0.5


def scene(people: tuple[int, ...], seconds: float) -> Scene:
    persons = [
        {
            "body": {"random_seed": 4700 + n},
            "motion": walk({"shape": "back_forth", "start_m": PATHS[n][0], "end_m": PATHS[n][1]}, 1.2),
        }
        for n in people
    ]
    cameras = {"kind": "ring", "count": 5, "radius_m": 4.5, "height_m": 2.2, "image": {"horizontal_fov_deg": 65.0}}
    return scene_from({"duration_s": seconds, "rate_hz": RATE_HZ, "seed": 47, "cameras": cameras, "people": persons})


def compared(truth: Truth, poses: PoseSequence) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances (T, N, M), who is in the room (T, N), and which results there are (T, M): half of the joints at least."""
    true_xyz = pick_keypoints(true_xyz_at(truth, poses.t_ns), truth.skeleton, PAPER14.keypoints)
    xyz = pick_keypoints(poses.xyz_world, poses.skeleton, PAPER14.keypoints)
    there = np.isfinite(xyz[..., 0]).mean(axis=-1) >= FOUND
    distance = person_distances(true_xyz, np.where(there[..., None, None], xyz, np.nan))
    return distance, np.isfinite(true_xyz[..., 0]).all(axis=-1), there


def measured(people: tuple[int, ...], seconds: float, folder: Path) -> dict[str, float]:
    session = rendered(scene(people, seconds), folder / f"{'_'.join(map(str, people))}-{seconds:g}s", processes=None)
    poses = tracked(session, associate__max_people=len(people)).poses
    distance, asked, there = compared(truth_of(session), poses)
    both = float((there.sum(axis=1) >= distance.shape[1]).mean())
    return {"steps": len(poses), "both_share": both, **crowd_row(distance, asked, there, RATE_HZ)}


def main() -> None:
    args = arguments(__doc__, seconds=4.0, alone=False, kept=Path(tempfile.gettempdir()) / "posefuse_rendered_people")
    cases = [(0, 1), (0,), (1,)] if args.alone else [(0, 1)]
    answer(args, {"Two people": [{"people": str(case), **measured(case, args.seconds, args.kept)} for case in cases]})


if __name__ == "__main__":
    main()
