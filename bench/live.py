"""The live pipeline on this machine, as a user runs it: latencies, output tick, frames used, and the error at output time.

    python bench/live.py [--only WORD ...] [--repeat 3] [--seconds 9] [--session examples/demo]

A simulated session is played at the pace of the clock. Medians over the runs; tables on stderr, one JSON object on stdout.
Scenarios: four cameras; eight (each video given twice, as two cameras at one place); both also with the small network; the
network's landmarks as they are, not moved to joint centres. *every frame* is what a machine that
never drops a frame would give after the same delay: 2D poses of all frames, made beforehand, through the same tracker.
"""

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from harness import DEMO, JOINTS, answer, arguments, arrivals, errors, live, medians, played, score, sources_of, tracked, truth_of

from posefuse.core import LiveJointCentres, Pose3D, PoseSequence, Rig
from posefuse.core.se3 import SE3
from posefuse.core.skeleton import PAPER14
from posefuse.detection.build import build_detector
from posefuse.evaluation.metrics import typical_nees
from posefuse.formats.rig import read_rig, write_rig
from posefuse.pipeline.config import changes_of, read_changed
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse_ros.bags import read_poses

# the tracker needs a moment to know speeds and bones
_SETTLED_S = 1.5
TWIN = "_twin"
# by so much a twin stands next to its camera, as a rig file takes no two cameras at one place
_ASIDE_M = 0.005
_NETWORK = "detector.options.landmarks"
# cameras, and settings of the session
SCENARIOS = {
    "4 cameras": (4, f"{_NETWORK}=blazepose_full"),
    "4, small network": (4, f"{_NETWORK}=blazepose_lite"),
    "4, as the network marks": (4, f"{_NETWORK}=blazepose_full", "joint_centres=false"),
    "8 cameras": (8, f"{_NETWORK}=blazepose_full"),
    "8, small network": (8, f"{_NETWORK}=blazepose_lite"),
}


def poses_of_every_frame(rig: Rig, session: Path, delay_ms: float, settings: Sequence[str]) -> list[Pose3D]:
    """The tracker's output at every output tick when each frame's 2D poses reach it `delay_ms` after exposure."""
    changes = changes_of(settings)
    config = read_changed(None, changes, LiveConfig)
    of_detector = {key.replace(".", "__"): value for key, value in changes.items() if key.startswith("detector")}
    views, late_ns = tracked(session, **of_detector).views, round(delay_ms * 1e6)
    estimator = warmed_up(rig, views.skeleton, config)
    table = build_detector(config.detector, rig).joint_centres
    estimator.centring.learn(LiveJointCentres(t_ns=0, cameras=rig.names, table=table))
    come = arrivals(views, rig, late_ns, lambda name: name.replace(TWIN, ""))
    ticks = range(0, int(views.t_ns[-1]) + late_ns, round(1e9 / config.rate_hz))
    return [estimator.centring.moved(pose) for pose in played(estimator.tracker, come, ticks)]


def accuracy(poses: Sequence[Pose3D], session: Path) -> dict:
    """Error of the 14 joints against the truth at output time, typical NEES, and share of outputs with the person."""
    truth = truth_of(session)
    counted = [pose for pose in poses if _SETTLED_S * 1e9 <= pose.t_ns <= truth.t_ns[-1]]
    shown = [pose for pose in counted if len(pose.person_id)]
    found = score(errors(shown, truth, PAPER14.keypoints))
    nees = typical_nees(PoseSequence.from_poses(shown), truth, JOINTS)
    return {"mean_mm": found["mean_mm"], "p95_mm": found["p95_mm"], "nees": nees, "shown_share": len(shown) / len(counted)}


def played_live(rig: Path, sources: Sequence[str], session: Path, seconds: float, settings: Sequence[str]) -> dict:
    """Figures of one session."""
    with tempfile.TemporaryDirectory() as scratch:
        recording, options = Path(scratch) / "live.mcap", [word for setting in settings for word in ("--set", setting)]
        figures = live(rig, sources, "--duration", seconds, "--record", recording, *options)
        poses = [replace(pose, t_ns=pose.t_ns - figures["zero_ns"]) for pose, _ in read_poses(recording)]
    total, output = figures["latency"]["all_cameras_total_ms"], figures["latency"]["output"]
    return {
        **{f"{name}_ms": total[name] for name in ("p50", "p95", "p99")},
        "output_p99_ms": output["period_deviation_ms"]["p99"],
        **{name: figures[name] for name in ("poses_per_s", "used_share", "memory_mb")},
        "cpu_share": figures["cpu_fusion_share"] + figures["cpu_children_share"],
        **accuracy(poses, session),
    }


def twins(session: Path, path: Path) -> list[str]:
    """A rig with every camera and a twin of it, and the videos as sources: no place and no file serves two cameras."""
    rig = read_rig(session / "rig.toml")
    aside = rig.moved(SE3.from_rotvec(np.zeros(3), np.array([_ASIDE_M, 0.0, 0.0])))
    twin = aside.renamed({name: f"{name}{TWIN}" for name in rig.names})
    write_rig(path, replace(rig, cameras=(*rig.cameras, *twin.cameras)))
    (copies := path.with_name("videos")).mkdir()
    for video in (session / "videos").glob("*.mp4"):
        shutil.copy(video, copies / f"{video.stem}{TWIN}.mp4")
    return [*sources_of(session), *sources_of(path.parent)]


def main() -> None:
    args = arguments(__doc__, only=(str,), repeat=3, seconds=9.0, session=DEMO)
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        doubled = Path(scratch) / "rig.toml"
        inputs = {4: (args.session / "rig.toml", [f"sim:{args.session}"]), 8: (doubled, twins(args.session, doubled))}
        for name, (cameras, *settings) in SCENARIOS.items():
            if args.only and not any(word in name for word in args.only):
                continue
            rig, sources = inputs[cameras]
            row = medians([played_live(rig, sources, args.session, args.seconds, settings) for _ in range(args.repeat)])
            ideal = accuracy(poses_of_every_frame(read_rig(rig), args.session, row["p50_ms"], settings), args.session)
            rows.append({"scenario": name, **row, "every_frame_mm": ideal["mean_mm"], "every_frame_nees": ideal["nees"]})
    answer(args, {"Live": rows}, seconds=args.seconds, repeat=args.repeat)


if __name__ == "__main__":
    main()
