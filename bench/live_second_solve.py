"""What a second solve over all of time makes of a live session, compared with its own output and with `posefuse track`.

    python bench/live_second_solve.py [SESSION ...] [--seconds 8] [--gaps]

Sessions are rendered ones (default: examples/demo; others are made with `posefuse simulate`). Each is played to `posefuse live`
at the pace of the clock and recorded, then:

* *live*: the poses that were published, at output time
* *second solve*: `posefuse solve LIVE.mcap`
* *track, same frames*: the detections of `posefuse track SESSION`, of those frames only that the live session used, solved with
  the settings of the second solve; so a slow machine, which uses fewer frames, does not blur the comparison
* *track, all frames*: `posefuse track SESSION`

Error of 14 joints against the truth in mm, from 1.5 s (the live tracker needs a moment) to `--seconds`. A table on stderr, one
JSON object on stdout. `--gaps` plays nothing: it drops frames of `posefuse track` by chance and solves the rest with several
values of `live_gap_s`.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from harness import DEMO, answer, arguments, live_recording, tracked, truth_of

from posefuse.core import Observations, PoseSequence, Recording, Truth
from posefuse.core.observations import LIVE_STEP, observations_from_frames
from posefuse.evaluation.metrics import joint_errors
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.solve import config_of, solve_again

_SETTLED_NS = 1_500_000_000
# two frames of a camera are the same if their times differ by no more
_SAME_NS = 2_000_000
_KEPT_SHARES, _GAPS_S = (0.75, 0.5, 0.3), (0.0, 0.07, 0.105, 0.14, 0.2, 0.3)


def last_looks(recording: Recording, wanted: np.ndarray) -> Recording:
    """As a live session would have recorded those frames: the rows (F,) `wanted` of the log, at their own times."""
    log = recording.observations
    frames = [log.detections(i) for i in np.flatnonzero(wanted)]
    return replace(recording, observations=observations_from_frames(log.skeleton, log.camera_names, frames))


def is_last_look(log: Observations) -> np.ndarray:
    """(F,) whether it is the last look at its frame; live, each frame is looked at once."""
    key = np.stack([log.frame_camera, log.frame_step])
    _, last = np.unique(key[:, ::-1], axis=1, return_index=True)
    found = np.zeros(len(log.frame_t_ns), np.bool_)
    found[len(found) - 1 - last] = True
    return found & (log.frame_step != LIVE_STEP)


def used_by(live: Observations, log: Observations) -> np.ndarray:
    """(F,) whether the live session used the frame."""
    used = np.zeros(len(log.frame_t_ns), np.bool_)
    for c, name in enumerate(log.camera_names):
        mine = log.frame_camera == c
        times = np.sort(live.frame_t_ns[live.frame_camera == live.camera_names.index(name)])
        if len(times):
            at = np.searchsorted(times, log.frame_t_ns[mine]).clip(1, max(len(times) - 1, 1))
            near = (np.abs(times[place.clip(max=len(times) - 1)] - log.frame_t_ns[mine]) for place in (at - 1, at))
            used[mine] = np.minimum(*near) <= _SAME_NS
    return used


def error(poses: PoseSequence, truth: Truth, seconds: float) -> dict:
    """mm over all joints, and how often they were found."""
    inside = (poses.t_ns >= _SETTLED_NS) & (poses.t_ns <= min(truth.t_ns[-1], seconds * 1e9))
    found = joint_errors(poses.part(inside), truth)
    return {"mm": found.mpjpe_mm, "p95_mm": float(np.nanmean(found.p95_mm)), "found": float(np.mean(found.found))}


def compared(session: Path, seconds: float) -> dict:
    """One row of the table."""
    truth, track = truth_of(session), tracked(session, end_s=seconds)
    recording, figures = live_recording(session, "--networks", "blazepose_full", "--duration", seconds + 1)
    last = is_last_look(track.observations)
    used = used_by(recording.observations, track.observations) & last
    poses = {
        "live": recording.poses,
        "second solve": solve_again(recording, replace(config_of(recording.provenance), end_s=seconds)).poses,
        "track, same frames": solve_again(last_looks(track, used)).poses,
        "track, all frames": track.poses,
    }
    mm = {name: error(one, truth, seconds)["mm"] for name, one in poses.items()}
    return {
        "session": session.name,
        "frames_used": used.sum() / last.sum(),
        "latency_p50_ms": figures["latency"]["all_cameras_total_ms"]["p50"],
        **mm,
        "against_track": mm["second solve"] / mm["track, same frames"] - 1,
        "against_live": mm["second solve"] / mm["live"] - 1,
    }


def gaps(session: Path, seconds: float) -> list[dict]:
    """Errors with frames dropped by chance, for several gaps."""
    truth, track, rows = truth_of(session), tracked(session, end_s=seconds), []
    for share in _KEPT_SHARES:
        kept = is_last_look(track.observations) & (np.random.default_rng(0).random(len(track.observations.frame_t_ns)) < share)
        for gap_s in _GAPS_S:
            solved = solve_again(last_looks(track, kept), replace(TrackConfig(), live_gap_s=gap_s))
            rows.append({"session": session.name, "kept": share, "gap_s": gap_s, **error(solved.poses, truth, seconds)})
    return rows


def main() -> None:
    args = arguments(__doc__, positional=("sessions",), sessions=(DEMO,), seconds=8.0, gaps=False)
    if args.gaps:
        rows = [row for session in args.sessions for row in gaps(session, args.seconds)]
    else:
        rows = [compared(session, args.seconds) for session in args.sessions]
    answer(args, {"mm": rows})


if __name__ == "__main__":
    main()
