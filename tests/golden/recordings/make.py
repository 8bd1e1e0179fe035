"""Makes the golden recordings: run it only when a stored format is changed on purpose, and say so in CHANGELOG.md.

PYTHONPATH=$PWD/tests/support:$PWD/tests/cli python tests/golden/recordings/make.py
"""

import contextlib
import json
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from studies import write_session

from posefuse.cli.main import main
from posefuse.core import Camera, Rig
from posefuse.formats.detection_log import LOG_FILE
from posefuse.formats.recording import read_recording
from posefuse.formats.rig import write_rig
from posefuse.foundation.output_folder import find_unfinished
from posefuse.pipeline.edits import Edits, Exclusion
from posefuse_sim.cameras import looking_at
from posefuse_studio.pages.recording import write_edits

HERE = Path(__file__).parent


def golden_rig() -> Rig:
    K = np.array([[576.0, 0, 319.5], [0, 576.0, 239.5], [0, 0, 1]])
    centres = [np.array([4 * np.cos(a), 4 * np.sin(a), 2.0]) for a in (0.3, 2.4, 4.5)]
    poses = [looking_at(centre, np.array([0, 0, 1.0])) for centre in centres]
    cameras = [Camera(name=f"cam{i}", size_wh=(640, 480), K=K, cam_from_world=pose) for i, pose in enumerate(poses)]
    return Rig(tuple(cameras), world_set_by="golden")


# a process that stops in the middle of a recording, as after Ctrl-C
STOPPED = """
import sys
from interrupting import interrupt
from posefuse.cli.main import main
interrupt("posefuse.pipeline.result_folder", "DetectionStore.append", 6, "SIGINT")
sys.exit(main(sys.argv[1:]))
"""


def make(work: Path) -> None:
    session = work / "session"
    session.mkdir()
    write_rig(session / "rig.toml", golden_rig())
    write_session(session, golden_rig())
    command = ["track", "session", "--set", "rate_hz=50", "--outputs", "mcap", "--out"]
    assert main([*command, "result"]) == 0
    subprocess.run([sys.executable, "-c", STOPPED, *command, "stopped"], check=False, timeout=300)
    write_edits(work / "result", Edits(exclusions=(Exclusion(start_s=0.1, end_s=0.2, camera="cam1"),), person=0, names=("Ada",)))
    shutil.rmtree(HERE / "result", ignore_errors=True)
    shutil.copytree(work / "result", HERE / "result")
    shutil.move(HERE / "result" / "pose.mcap", HERE / "exported.mcap")
    [left] = find_unfinished(work / "stopped")
    shutil.copyfile(left / LOG_FILE, HERE / LOG_FILE)
    poses = read_recording(HERE / "result").poses
    facts = {"xyz_mm": np.round(1e3 * poses.xyz_world[7, 0], 3).tolist(), "time_steps": len(poses)}
    (HERE / "facts.json").write_text(json.dumps(facts) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with TemporaryDirectory() as folder, contextlib.chdir(folder):
        make(Path(folder))
