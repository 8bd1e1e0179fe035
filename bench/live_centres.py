"""Where live poses lie next to recorded ones: how fast the lengths of the person's segments are learnt, and what that is worth.

    python bench/live_centres.py [SESSION ...] [--seconds 12] [--usual-s S ...]

Sessions are rendered ones with one person (default: examples/demo). Each is tracked as a recording; its views then go to the
live tracker, every frame as soon as it is taken. Every pose that comes out is moved to joint centres by lengths learnt so far,
and by those that the recording found over all its time: *apart* is the mean distance between the two over the joints of the
table, by seconds since the person was found, with nothing learnt (*usual*) and as it is (*learnt*). Errors are those of the same
joints against the truth. A table on stderr, one JSON object on stdout.

`--usual-s` tries other values of how long a new person counts as usual (`tracking/joint_centres.py`). It was chosen on the
scenes of `bench/fit_lasting_errors.py render`, whose people appear in no reported measurement.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from posefuse.core import Detections2D, JointCentres, Pose3D, Truth
from posefuse.core.skeleton import pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.truth import read_truth
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.run import Tracked, track_session
from posefuse.pipeline.second_pass import poses_over_time
from posefuse.pipeline.session import find_session
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.tracking import LearntLengths, at_joint_centres
from posefuse.tracking.body_directions import HEAD, SIDES
from posefuse.tracking.joint_centres import JOINTS, USUAL_S
from posefuse.tracking.segments import segment_lengths

NAMES = tuple(f"{side}_{joint}" for side in SIDES for joint in JOINTS if joint not in HEAD)
# seconds since a person was found
SINCE_S = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)


def tracked(session: Path, seconds: float) -> Tracked:
    """The session as a recording."""
    config = TrackConfig(outputs={}, end_s=seconds)
    return track_session(find_session(session, config), config, StageClock(), lambda *_: None, lambda _: None, print)


def recorded_lengths(done: Tracked, table: JointCentres) -> np.ndarray:
    """(N, S) metres as the recording has them."""
    landmarks = poses_over_time(done.recording.views, done.recording.rig, TrackConfig().fuse, None)
    return segment_lengths(at_joint_centres(landmarks, table, table.usual).xyz_world, landmarks.skeleton)


def live_poses(done: Tracked) -> Iterator[Pose3D]:
    """Landmarks at every output tick, from every frame of the recording at once."""
    views, rig, config = done.recording.views, done.recording.rig, LiveConfig()
    tracker = warmed_up(rig, views.skeleton, config).tracker
    period_ns, due_ns = round(1e9 / config.rate_hz), int(views.t_ns[0])
    for i, t_ns in enumerate(views.t_ns):
        while due_ns < t_ns:
            yield tracker.at(due_ns)
            due_ns += period_ns
        for c, name in enumerate(rig.names):
            seen = {"xy_img": views.xy_img[i, :, c], "score": views.score[i, :, c], "sigma_px": views.sigma_px[i, :, c]}
            box = np.full((len(views.person_id), 4), np.nan)
            tracker.add(Detections2D(camera=name, t_ns=int(t_ns), skeleton=views.skeleton, box_img=box, **seen))


def compared(done: Tracked, poses: list[Pose3D], found: np.ndarray, truth: Truth, usual_s: float) -> list[dict]:
    """One row per stretch of `SINCE_S`, mm."""
    table = done.joint_centres
    learnt, rows = LearntLengths(table, usual_s=usual_s), []
    for pose in poses:
        lengths = learnt.step(pose)
        if not len(pose.person_id):
            continue
        first = replace(pose, **{name: getattr(pose, name)[:1] for name in (
            "person_id", "xyz_world", "cov_world", "reproj_px", "n_views", "kind"
        )})  # fmt: skip
        moved = [joints(at_joint_centres(first, table, one)) for one in (found[:1], table.usual, lengths[:1])]
        true = pick_keypoints(true_xyz_at(truth, np.array([pose.t_ns]))[0, 0], truth.skeleton, NAMES)
        away = [distance_mm(moved[0], one) for one in moved[1:]] + [distance_mm(true, one) for one in moved]
        rows.append((pose.t_ns, *away))
    times, *columns = np.array(rows, np.float64).T
    since_s = (times - times[0]) * 1e-9
    parts = []
    for start, end in zip(SINCE_S, (*SINCE_S[1:], np.inf), strict=True):
        inside = (since_s >= start) & (since_s < end)
        if inside.any():
            values = dict(
                zip(("apart_usual", "apart_learnt", "error_recorded", "error_usual", "error_learnt"), columns, strict=True)
            )
            parts.append({"from_s": start, **{name: float(np.nanmean(value[inside])) for name, value in values.items()}})
    return parts


def joints(pose: Pose3D) -> np.ndarray:
    return pick_keypoints(pose.xyz_world[0], pose.skeleton, NAMES)


def distance_mm(one: np.ndarray, two: np.ndarray) -> float:
    return float(1000 * np.nanmean(np.linalg.norm(one - two, axis=-1)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sessions", type=Path, nargs="*", default=[Path(__file__).resolve().parents[1] / "examples" / "demo"])
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--usual-s", type=float, nargs="+", default=[USUAL_S])
    args = parser.parse_args()
    per_value: dict[float, list[list[dict]]] = {value: [] for value in args.usual_s}
    for session in args.sessions:
        done, truth = tracked(session, args.seconds), read_truth(session / "truth" / "truth.npz")
        poses, found = list(live_poses(done)), recorded_lengths(done, done.joint_centres)
        for usual_s, sessions in per_value.items():
            sessions.append(compared(done, poses, found, truth, usual_s))
        print(f"{session.name}: done", flush=True)
    rows = [
        {"usual_s": usual_s, "from_s": start, "people": len(same), **mean(same)}
        for usual_s, sessions in per_value.items()
        for start in SINCE_S
        if (same := [part for parts in sessions for part in parts if part["from_s"] == start])
    ]
    table = Table(*rows[0], title="mm over joints", title_justify="left")
    for row in rows:
        table.add_row(*(f"{value:.2f}" if isinstance(value, float) else str(value) for value in row.values()))
    Console(stderr=True, width=140).print(table)
    print(json.dumps({"sessions": [one.name for one in args.sessions], "rows": rows}, indent=2))


def mean(parts: list[dict]) -> dict:
    """Over sessions."""
    return {f"{name}_mm": float(np.mean([part[name] for part in parts])) for name in parts[0] if name != "from_s"}


if __name__ == "__main__":
    main()
