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

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from posefuse.core import Observations, PoseSequence, Recording, Truth
from posefuse.core.observations import LIVE_STEP, observations_from_frames
from posefuse.evaluation.metrics import joint_errors
from posefuse.formats.truth import read_truth
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.reading import read_result
from posefuse.pipeline.run import track_session
from posefuse.pipeline.session import find_session
from posefuse.pipeline.solve import config_of, solve_again

_SETTLED_NS = 1_500_000_000
# two frames of a camera are the same if their times differ by no more
_SAME_NS = 2_000_000
_KEPT_SHARES, _GAPS_S = (0.75, 0.5, 0.3), (0.0, 0.07, 0.105, 0.14, 0.2, 0.3)


def played(session: Path, seconds: float, scratch: Path) -> tuple[Recording, dict]:
    """The session played live and recorded, with the file's own times; and its figures."""
    recording = scratch / f"{session.name}.mcap"
    sources = [f"{path.stem}=video:{path}" for path in sorted((session / "videos").glob("*.mp4"))]
    command = [sys.executable, "-m", "posefuse.cli.main", "live", str(session / "rig.toml"), "--json", "--record", str(recording)]
    command += ["--networks", "blazepose_full"]
    command += ["--duration", str(seconds + 1), *(part for source in sources for part in ("--source", source))]
    figures = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    found = read_result(recording)
    return shifted(found, found.provenance["start_ns"] - figures["zero_ns"]), figures


def shifted(recording: Recording, later_ns: int) -> Recording:
    """The same with all times later."""
    poses = replace(recording.poses, t_ns=recording.poses.t_ns + later_ns)
    log = replace(recording.observations, frame_t_ns=recording.observations.frame_t_ns + later_ns)
    return replace(recording, poses=poses, observations=log)


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
            nearest = np.minimum(
                *(np.abs(times[place.clip(max=len(times) - 1)] - log.frame_t_ns[mine]) for place in (at - 1, at))
            )
            used[mine] = nearest <= _SAME_NS
    return used


def error(poses: PoseSequence, truth: Truth, seconds: float) -> dict:
    """mm over all joints, and how often they were found."""
    inside = (poses.t_ns >= _SETTLED_NS) & (poses.t_ns <= min(truth.t_ns[-1], seconds * 1e9))
    part = {name: getattr(poses, name)[inside] for name in ("t_ns", "xyz_world", "cov_world", "reproj_px", "n_views", "kind")}
    found = joint_errors(replace(poses, **part), truth)
    return {"mm": found.mpjpe_mm, "p95_mm": float(np.nanmean(found.p95_mm)), "found": float(np.mean(found.found))}


def tracked(session: Path, seconds: float) -> Recording:
    """`posefuse track`."""
    config = TrackConfig(outputs={}, end_s=seconds)
    say = lambda *_: None  # noqa: E731
    return track_session(find_session(session, config), config, StageClock(), say, say, say).recording


def compared(session: Path, seconds: float, scratch: Path) -> dict:
    """One row of the table."""
    truth, track = read_truth(session / "truth" / "truth.npz"), tracked(session, seconds)
    live, figures = played(session, seconds, scratch)
    log = track.observations
    used = used_by(live.observations, log) & is_last_look(log)
    rows = {
        "live": live.poses,
        "second solve": solve_again(live, replace(config_of(live), end_s=seconds)).poses,
        "track, same frames": solve_again(last_looks(track, used)).poses,
        "track, all frames": track.poses,
    }
    errors = {name: error(poses, truth, seconds) for name, poses in rows.items()}
    return {
        "session": session.name,
        "frames_used": used.sum() / is_last_look(log).sum(),
        "latency_p50_ms": figures["latency"]["all_cameras_total_ms"]["p50"],
        "errors": errors,
        "against_track": errors["second solve"]["mm"] / errors["track, same frames"]["mm"] - 1,
        "against_live": errors["second solve"]["mm"] / errors["live"]["mm"] - 1,
    }


def gaps(session: Path, seconds: float) -> list[dict]:
    """Errors with frames dropped by chance, for several gaps."""
    truth, track, rows = read_truth(session / "truth" / "truth.npz"), tracked(session, seconds), []
    for share in _KEPT_SHARES:
        kept = is_last_look(track.observations) & (np.random.default_rng(0).random(len(track.observations.frame_t_ns)) < share)
        for gap_s in _GAPS_S:
            solved = solve_again(last_looks(track, kept), replace(TrackConfig(), live_gap_s=gap_s))
            rows.append({"session": session.name, "kept": share, "gap_s": gap_s, **error(solved.poses, truth, seconds)})
    return rows


def show(rows: list[dict]) -> None:
    table = Table(*rows[0], title="mm", title_justify="left")
    for row in rows:
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()))
    Console(stderr=True, width=140).print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sessions", type=Path, nargs="*", default=[Path(__file__).resolve().parents[1] / "examples" / "demo"])
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--gaps", action="store_true")
    args = parser.parse_args()
    if args.gaps:
        rows = [row for session in args.sessions for row in gaps(session, args.seconds)]
        show(rows)
        print(json.dumps({"rows": rows}, indent=2))
        return
    found = []
    with tempfile.TemporaryDirectory() as scratch:
        for session in args.sessions:
            found.append(compared(session, args.seconds, Path(scratch)))
            flat = {**found[-1], **{f"{name} mm": one["mm"] for name, one in found[-1]["errors"].items()}}
            flat.pop("errors")
            show([flat])
    print(json.dumps({"sessions": found}, indent=2))


if __name__ == "__main__":
    main()
