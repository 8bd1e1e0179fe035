"""A process that reads damaged files one after the other; `drive` restarts it when it crashes or hangs.

What libraries print goes to a file, in which warnings and traces count against the reader.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import math
import os
import re
import shlex
import signal
import sys
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from examples import DEMO, EXAMPLES, NETWORK
from posefuse.core import InputError, PosefuseError

_LONGEST_LINE = 4000
# a UserWarning is posefuse's own line about what it left out; these come from libraries, about input that posefuse did not check
_NOISE = re.compile(r"Traceback|(Runtime|Deprecation|Future|Syntax|Resource)Warning:")
_MISBEHAVIOURS = ("trace", "warning", "hang", "crash", "clear", "accepted")
_ENDED_WELL, _KNOWN_ERROR = 0, 1


def _readers() -> dict[str, Callable[[Path], Any]]:
    from posefuse.calibration.extrinsics.world import read_floor_points
    from posefuse.detection.card import read_card
    from posefuse.evaluation.tracks import read_tracks
    from posefuse.formats.c3d import read_c3d
    from posefuse.formats.mot import read_mot
    from posefuse.formats.pose2d import read_openpose_folder
    from posefuse.formats.recording import read_recording
    from posefuse.formats.rig import read_rig
    from posefuse.formats.trc import read_trc
    from posefuse.formats.truth import read_truth
    from posefuse.pipeline.config import read_config
    from posefuse_sim.motion.bvh import read_bvh
    from posefuse_sim.scene import read_scene

    readers: dict[str, Callable[[Path], Any]] = {
        "scene YAML": read_scene,
        "posefuse.toml": lambda path: read_config(path),
        "floor points TOML": read_floor_points,
        "model card TOML": read_card,
        "TRC": read_trc,
        "C3D": read_c3d,
        "BVH": lambda path: read_bvh(path).world(),
        "MOT": read_mot,
        "CSV wide": read_tracks,
        "CSV long": read_tracks,
        "MVNX": read_tracks,
        "recording.npz": lambda path: read_recording(path.parent),
        "recording.json": lambda path: read_recording(path.parent),
        "truth.npz": read_truth,
        "MP4": _video,
        "image": lambda path: _images(path.parent),
        "timestamps.csv": lambda path: _images(path.parent),
        "OpenPose JSON": lambda path: list(read_openpose_folder(path.parent, "cam00").frames(30.0)),
        **dict.fromkeys(("AlphaPose JSON", "COCO JSON", "MMPose JSON", "DeepLabCut CSV"), _pose2d),
        "wheel": lambda path: _model("blazepose_full", path),
        "npm package": lambda path: _model("blazepose_heavy", path),
        "MCAP": _mcap,
    }
    readers |= {f"self-test {what}": lambda _, what=what: _misbehave(what) for what in _MISBEHAVIOURS}
    return readers | {kind: read_rig for kind in EXAMPLES if kind.startswith("rig ")}


def _misbehave(what: str) -> None:
    """Deliberate failures that the fuzz stage must detect, see `test_fuzz`."""
    if what == "trace":
        raise KeyError("a bug")
    if what == "warning":
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)
    if what == "hang":
        threading.Event().wait(3600)
    if what == "crash":
        os.kill(os.getpid(), signal.SIGTERM)
    if what == "clear":
        raise InputError("a clear line")


def _pose2d(path: Path) -> None:
    from posefuse.formats.pose2d import read_pose2d

    read_pose2d(path, "cam").frame(0, 0)


def _video(path: Path) -> None:
    from posefuse.sources import VideoConfig

    source = VideoConfig(path, "cam").build()
    source.times_ns()
    list(source.frames())


def _images(folder: Path) -> None:
    from posefuse.sources import ImagesConfig

    source = ImagesConfig(folder, "cam", rate_hz=30.0).build()
    source.times_ns()
    list(source.frames())


def _model(card: str, archive: Path) -> None:
    from posefuse.detection.card import read_card
    from posefuse.detection.files import fetch

    made = {"size_bytes": len(NETWORK), "sha256": hashlib.sha256(NETWORK).hexdigest()}
    fetch(dataclasses.replace(read_card(card), **made), archive.parent / "cache", archive)


def _mcap(path: Path) -> None:
    from posefuse_ros import bags

    bags.read_rig(path)
    list(bags.read_mcap(path))


def _command(kind: str, path: Path, folder: Path) -> list[str]:
    if kind.startswith("compare"):
        return ["compare", str(folder / "sound.trc"), str(path)]
    if kind.startswith("options"):
        return [word.replace("FOLDER", str(folder)) for word in shlex.split(path.read_text())]
    out = ["--out", str(folder.with_name("out"))]
    if kind.startswith(("report", "export", "solve")):
        return [kind.partition(",")[0], str(folder), *out]
    command = ["track", str(folder), *out, "--set", "raw=true", "--outputs", "csv"]
    if kind == "track, MP4":
        command += ["--set", "detector.name=oracle", "--set", f"detector.options.truth={DEMO / 'truth' / 'truth.npz'}"]
        command += ["--end", "0.3"]
    return command


def _outcome(kind: str, path: Path, folder: Path, readers: dict[str, Callable[[Path], Any]]) -> tuple[str, str]:
    """The outcome: "accepted", "clear", or "trace" with the error that was raised."""
    if kind in readers:
        try:
            readers[kind](path)
        except PosefuseError as error:
            text = str(error)
            return ("clear", text) if "\n" not in text and len(text) < _LONGEST_LINE else ("trace", f"not one line: {text[:300]}")
        except Exception:  # noqa: BLE001 - any exception is a finding
            return "trace", traceback.format_exc()
        return "accepted", ""
    from posefuse.cli.main import main

    try:
        code = main(_command(kind, path, folder))
    except SystemExit as ended:
        code = int(ended.code or 0)
    if code not in (_ENDED_WELL, _KNOWN_ERROR):
        return "trace", f"exit code {code}"
    return ("accepted" if code == _ENDED_WELL else "clear"), ""


def _end_at(cpu_s: float) -> None:
    """At this processor time the system ends the process, whatever it is in; on Windows waiting alone is limited."""
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(cpu_s), resource.getrlimit(resource.RLIMIT_CPU)[1]))


def answers(requests: Connection) -> None:
    """Give (outcome, detail) for every (kind, folder, file, limit of processor time in s) until the other side closes."""
    readers = _readers()
    warnings.simplefilter("always")
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
        requests.send("ready")
        while True:
            kind, folder, file, limit_s = requests.recv()
            _end_at(sum(os.times()[:2]) + limit_s)
            said.seek(0)
            said.truncate()
            outcome, detail = _outcome(kind, folder / file, folder, readers)
            for stream in (sys.stdout, sys.stderr):
                with contextlib.suppress(OSError, ValueError):
                    stream.flush()
            said.seek(0)
            noise = said.read().decode("utf-8", errors="replace")
            if outcome != "trace" and _NOISE.search(noise):
                outcome, detail = "trace", "printed"
            requests.send((outcome, f"{detail}\n{noise[-3000:]}" if outcome == "trace" else detail))
