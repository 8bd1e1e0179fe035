"""Where live poses lie next to recorded ones: how fast the lengths of the person's segments are learnt.

    python bench/live_centres.py [SESSION ...] [--seconds 12] [--usual-s S ...]

Sessions have one person (default: examples/demo). Each is tracked as a recording; its views then go to the
live tracker, every frame as soon as it is taken. Every pose that comes out is moved to joint centres by lengths learnt so far,
and by those that the recording found over all its time: *apart* is the mean distance between the two over the joints of the
table, by seconds since the person was found, with nothing learnt (*usual*) and as it is (*learnt*), mm. A table on stderr, one
JSON object on stdout.

`--usual-s` tries other values of how long a new person counts as usual (`tracking/joint_centres.py`). It was chosen on the
scenes of `bench/fit_lasting_errors.py`, whose people appear in no reported measurement.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from bodies import table_of
from harness import DEMO, answer, arguments, arrivals, medians, played, tracked

from posefuse.core import JointCentres, Pose3D, Recording
from posefuse.core.skeleton import SIDES, pick_keypoints
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.second_pass import poses_over_time
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.tracking import LearntLengths, at_joint_centres
from posefuse.tracking.body_directions import HEAD, segment_lengths
from posefuse.tracking.joint_centres import JOINTS, USUAL_S

NAMES = tuple(f"{side}_{joint}" for side in SIDES for joint in JOINTS if joint not in HEAD)
# seconds since a person was found
SINCE_S = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, np.inf)
COLUMNS = ("apart_usual", "apart_learnt")
_OF_PEOPLE = ("person_id", "xyz_world", "cov_world", "reproj_px", "n_views", "kind")


def recorded_lengths(recording: Recording, table: JointCentres) -> np.ndarray:
    """(N, S) metres as the recording has them."""
    landmarks = poses_over_time(recording.views, recording.rig, TrackConfig().fuse, None)
    return segment_lengths(at_joint_centres(landmarks, table, table.usual).xyz_world, landmarks.skeleton)


def live_poses(recording: Recording) -> list[Pose3D]:
    """Landmarks at every output tick, from every frame of the recording at once."""
    views, rig, config = recording.views, recording.rig, LiveConfig()
    ticks = range(int(views.t_ns[0]), int(views.t_ns[-1]), round(1e9 / config.rate_hz))
    return list(played(warmed_up(rig, views.skeleton, config).tracker, arrivals(views, rig), ticks))


def compared(poses: list[Pose3D], found: np.ndarray, table: JointCentres, usual_s: float) -> list[dict]:
    """One row per stretch of `SINCE_S`, mm."""
    learnt, rows = LearntLengths(table, usual_s=usual_s), []
    for pose in poses:
        lengths = learnt.step(pose)
        if not len(pose.person_id):
            continue
        first = replace(pose, **{name: getattr(pose, name)[:1] for name in _OF_PEOPLE})
        recorded, usual, now = (joints(at_joint_centres(first, table, one)) for one in (found[:1], table.usual, lengths[:1]))
        rows.append((pose.t_ns, *(1000 * np.nanmean(np.linalg.norm(recorded - one, axis=-1)) for one in (usual, now))))
    times, *columns = np.array(rows, np.float64).T
    since_s = (times - times[0]) * 1e-9
    parts = []
    for start, end in pairwise(SINCE_S):
        inside = (since_s >= start) & (since_s < end)
        if inside.any():
            means = (float(np.nanmean(value[inside])) for value in columns)
            parts.append({"usual_s": usual_s, "from_s": start, **dict(zip(COLUMNS, means, strict=True))})
    return parts


def joints(pose: Pose3D) -> np.ndarray:
    return pick_keypoints(pose.xyz_world[0], pose.skeleton, NAMES)


def main() -> None:
    args = arguments(__doc__, positional=("sessions",), sessions=(DEMO,), seconds=12.0, usual_s=(USUAL_S,))
    parts: list[dict] = []
    for session in args.sessions:
        recording = tracked(session, end_s=args.seconds)
        table, poses = table_of(recording), live_poses(recording)
        found = recorded_lengths(recording, table)
        parts += [part for usual_s in args.usual_s for part in compared(poses, found, table, usual_s)]
    cases = dict.fromkeys((part["usual_s"], part["from_s"]) for part in parts)
    same = [[part for part in parts if (part["usual_s"], part["from_s"]) == case] for case in cases]
    rows = [{"people": len(some), **medians(some, np.mean)} for some in same]
    answer(args, {"mm over joints": rows}, sessions=[one.name for one in args.sessions])


if __name__ == "__main__":
    main()
