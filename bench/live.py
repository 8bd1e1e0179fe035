"""The live pipeline on this machine, as a user runs it: latencies, output tick, frames used, and the error at output time.

    python bench/live.py [--only WORD ...] [--repeat 3] [--seconds 9] [--session examples/demo]

A simulated session is played at the pace of the clock. Medians over the runs; tables on stderr, one JSON object on stdout.
Scenarios: four cameras; eight (each video given twice, as two cameras at one place); both also with the small network; the
network's landmarks as they are, not moved to joint centres. *every frame* is what a machine that
never drops a frame would give after the same delay: 2D poses of all frames, made beforehand, through the same tracker.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from posefuse.core import Detections2D, Kind, Pose3D, PoseSequence, Rig
from posefuse.core.se3 import SE3
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.detection.build import build_detector
from posefuse.evaluation.metrics import true_xyz_at, typical_nees
from posefuse.formats.rig import read_rig, write_rig
from posefuse.formats.truth import read_truth
from posefuse.messages.bags import read_poses
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import TrackConfig, changes_of, read_changed
from posefuse.pipeline.run import track_session
from posefuse.pipeline.session import find_session
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.realtime.messages import Centres

# the tracker needs a moment to know speeds and bones
_SETTLED_S = 1.5
# joints that have a covariance of their own
_ASKED = tuple(joint for joint in PAPER14.keypoints if joint not in ("neck", "mid_hip"))
TWIN = "_twin"
# by so much a twin stands next to its camera, as a rig file takes no two cameras at one place
_ASIDE_M = 0.005
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def live(rig: Path, sources: list[str], seconds: float, *options: str) -> dict:
    """Figures of one `posefuse live`."""
    command = [sys.executable, "-m", "posefuse.cli.main", "live", str(rig), "--json", "--duration", str(seconds), *options]
    command += [part for source in sources for part in ("--source", source)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def recorded_poses(recording: Path, zero_ns: int) -> list[Pose3D]:
    """The poses a session recorded, in session time."""
    return [replace(pose, t_ns=pose.t_ns - zero_ns) for pose, _ in read_poses(recording)]


def poses_of_every_frame(rig: Rig, session: Path, delay_ms: float, settings: tuple[str, ...]) -> list[Pose3D]:
    """The tracker's output at every output tick when each frame's 2D poses reach it `delay_ms` after exposure."""
    config = read_changed(None, changes_of(settings), LiveConfig)
    track = replace(TrackConfig(), detector=config.detector, outputs={})
    done = track_session(find_session(session, track), track, StageClock(), lambda *_: None, lambda _: None, lambda _: None)
    views = done.recording.views
    estimator = warmed_up(rig, views.skeleton, config)
    tracker, centring = estimator.tracker, estimator.centring
    centring.learn(Centres(rig.names, build_detector(config.detector, rig).joint_centres))
    period_ns, late_ns = round(1e9 / config.rate_hz), round(delay_ms * 1e6)
    due_ns, poses = 0, []
    for i, t_ns in enumerate(views.t_ns):
        while due_ns < t_ns + late_ns:
            poses.append(centring.moved(tracker.at(due_ns)))
            due_ns += period_ns
        for name in rig.names:
            c = views.camera_names.index(name.replace(TWIN, ""))
            seen = {"xy_img": views.xy_img[i, :, c], "score": views.score[i, :, c], "sigma_px": views.sigma_px[i, :, c]}
            box = np.full((len(views.person_id), 4), np.nan)
            tracker.add(Detections2D(camera=name, t_ns=int(t_ns), skeleton=views.skeleton, box_img=box, **seen))
    return poses


def errors(poses: list[Pose3D], session: Path) -> dict:
    """Error of the 14 joints against the truth at output time, mm, typical NEES, and share of outputs with the person."""
    truth = read_truth(session / "truth" / "truth.npz")
    counted = [pose for pose in poses if _SETTLED_S * 1e9 <= pose.t_ns <= truth.t_ns[-1]]
    shown = [pose for pose in counted if len(pose.person_id)]
    apart = [distances_mm(pose, true_xyz_at(truth, np.array([pose.t_ns]))[0, 0], truth.skeleton) for pose in shown]
    together = np.array(apart)
    return {
        "mean_mm": float(np.nanmean(together)),
        "p95_mm": float(np.nanpercentile(together, 95)),
        "nees": typical_nees(PoseSequence.from_poses(shown), truth, _ASKED),
        "shown_share": len(shown) / len(counted),
    }


def distances_mm(pose: Pose3D, true_xyz: np.ndarray, true_skeleton: object) -> np.ndarray:
    """(14,) of the first person."""
    known = np.where((pose.kind[0] != Kind.MISSING)[:, None], pose.xyz_world[0], np.nan)
    got = pick_keypoints(known, pose.skeleton, PAPER14.keypoints)
    return 1000 * np.linalg.norm(got - pick_keypoints(true_xyz, true_skeleton, PAPER14.keypoints), axis=-1)


def scenario(name: str, rig: Path, sources: list[str], args: argparse.Namespace, *options: str) -> dict:
    """Medians over the runs of one scenario, and the error that every frame would have given."""
    runs = []
    with tempfile.TemporaryDirectory() as scratch:
        for i in range(args.repeat):
            recording = Path(scratch) / f"{i}.mcap"
            figures = live(rig, sources, args.seconds, "--record", str(recording), *options)
            runs.append({**flat(figures), **errors(recorded_poses(recording, figures["zero_ns"]), args.session)})
    row = {"scenario": name, **{key: statistics.median(run[key] for run in runs) for key in runs[0]}}
    overrides = tuple(value for key, value in zip(options[::2], options[1::2], strict=True) if key == "--set")
    ideal = errors(poses_of_every_frame(read_rig(rig), args.session, row["p50_ms"], overrides), args.session)
    return row | {"every_frame_mm": ideal["mean_mm"], "every_frame_nees": ideal["nees"]}


def flat(figures: dict) -> dict:
    """The figures that go into the table."""
    total, beat = figures["latency"]["all_cameras_total_ms"], figures["latency"]["output"]
    return {
        "p50_ms": total["p50"],
        "p95_ms": total["p95"],
        "p99_ms": total["p99"],
        "beat_p99_ms": beat["period_deviation_ms"]["p99"],
        "poses_per_s": figures["poses_per_s"],
        "used_share": figures["used_share"],
        "cpu_share": figures["cpu_fusion_share"] + figures["cpu_children_share"],
        "memory_mb": figures["memory_mb"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[], help="scenarios whose name holds one of these words")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=9.0)
    parser.add_argument("--session", type=Path, default=Path(__file__).resolve().parents[1] / "examples" / "demo")
    args = parser.parse_args()
    session = args.session
    rig = session / "rig.toml"
    full, small = (("--set", f"detector.options.landmarks=blazepose_{size}") for size in ("full", "lite"))
    with tempfile.TemporaryDirectory() as scratch:
        doubled = Path(scratch) / "rig.toml"
        twin_sources = twins(session, doubled)
        scenarios = {
            "4 cameras": (rig, [f"sim:{session}"], *full),
            "4, small network": (rig, [f"sim:{session}"], *small),
            "4, as the network marks": (rig, [f"sim:{session}"], *full, "--set", "joint_centres=false"),
            "8 cameras": (doubled, twin_sources, *full),
            "8, small network": (doubled, twin_sources, *small),
        }
        chosen = [name for name in scenarios if not args.only or any(word in name for word in args.only)]
        rows = [scenario(name, *scenarios[name][:2], args, *scenarios[name][2:]) for name in chosen]
    table = Table(*rows[0])
    for row in rows:
        table.add_row(*(value if isinstance(value, str) else f"{value:.2f}" for value in row.values()))
    Console(stderr=True, width=200).print(table)
    print(json.dumps({"seconds": args.seconds, "repeat": args.repeat, "scenarios": rows}, indent=2))


def twins(session: Path, path: Path, copies: int = 1) -> list[str]:
    """A rig with every camera and so many twins of it, and the videos as sources; a rig file refuses two cameras at one place."""
    rig = read_rig(session / "rig.toml")
    names = ("", *(TWIN * (i + 1) for i in range(copies)))
    cameras = [
        replace(c, name=f"{c.name}{name}", cam_from_world=SE3(_UPRIGHT, np.array([i * _ASIDE_M, 0.0, 0.0])) @ c.cam_from_world)
        for i, name in enumerate(names)
        for c in rig.cameras
    ]
    write_rig(path, replace(rig, cameras=tuple(cameras)))
    videos = {camera.name: session / "videos" / f"{camera.name}.mp4" for camera in rig}
    return [f"{name}{twin}=video:{video}" for name, video in videos.items() for twin in names]


if __name__ == "__main__":
    main()
