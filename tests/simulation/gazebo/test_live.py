"""Gazebo's part played by another process: images, CameraInfo and /clock over DDS, tracked live, compared with the truth."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from own_domain import own_domain
from running import Running
from scenes import scene

pytest.importorskip("cyclonedds")
pytest.importorskip("mujoco")

from posefuse_ros.bags import read_clock, read_mcap
from posefuse_sim.gazebo import export_world
from posefuse_sim.session import simulate

pytestmark = [pytest.mark.slow, pytest.mark.gl]
DOMAIN = own_domain()
RATE, POSES_S, PATIENCE_S = 0.4, 6.0, 240.0
# a wrong length of the motion, and what has to be recorded to tell it from the true one, in simulated time
WRONG_LOOP_NS, LEAST_SIM_NS = 3_000_000_000, 5_000_000_000
IMAGE, SENSOR = {"size_px": [320, 240], "horizontal_fov_deg": 60}, {"noise_dn": 2.0}
SCENE = scene(
    duration_s=6.0,
    rate_hz=10,
    seed=5,
    cameras={"kind": "ring", "count": 3, "radius_m": 3.5, "image": IMAGE, "sensor": SENSOR},
    people=[{"motion": {"kind": "walk", "speed_mps": 1.0, "path": {"shape": "circle", "radius_m": 0.9}}}],
)


def compared(world: Path, recording: Path) -> dict:
    command = [sys.executable, "-m", "posefuse.cli.main", "compare", str(world), str(recording), "--json"]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True, timeout=200).stdout)


def wait_for_poses(recording: Path, live: Running) -> None:
    """Until so many seconds with a person in them are recorded, and enough of simulated time has passed."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s and live.process.poll() is None:
        time.sleep(2.0)
        if recording.exists():
            entries = read_mcap(recording, {"/posefuse/pose"}, lambda line: None)
            sim_ns = read_clock(recording, lambda line: None)[1]
            shown = sum(len(one.msg.person_id) > 0 for one in entries)
            if shown > 100 * POSES_S and len(sim_ns) and sim_ns[-1] >= LEAST_SIM_NS:
                return
    raise AssertionError(live.err.rest() if live.process.poll() is not None else "too few poses")


def test_images_of_a_simulator_are_tracked_and_compared_by_simulation_time(tmp_path: Path) -> None:
    world, session, recording = tmp_path / "gz", tmp_path / "session", tmp_path / "run.mcap"
    export_world(SCENE, world)
    simulate(SCENE, session, lambda done, total: None, None)
    program = [sys.executable, str(Path(__file__).with_name("stand_in.py")), str(DOMAIN), str(world), str(session), str(RATE)]
    sources = [word for c in range(3) for word in ("--source", f"cam{c:02d}=ros:/cam{c:02d}/image")]
    command = [sys.executable, "-m", "posefuse.cli.main", "live", str(world / "rig.toml"), "--sim-time", *sources]
    command += ["--local-only", "--domain", str(DOMAIN), "--record", str(recording), "--networks", "blazepose_lite", "--json"]
    with Running(program), Running(command) as live:
        wait_for_poses(recording, live)
        live.process.send_signal(signal.SIGINT)
        out, err = live.finished()
        assert live.process.returncode == 0, err
    figures = json.loads(out)
    assert "differs from the rig" not in err
    found = compared(world, recording)
    print({name: camera["used_share"] for name, camera in figures["cameras"].items()}, found["mean_mm"], found["walked_m"])
    assert found["offset_s"] == 0 and found["walked_m"] > 1.0
    # one small image ten times a second, and a person who jumps where the loop starts again
    assert found["mean_mm"] < 150
    # and it is simulation time that does it: with a truth of another length they would be somewhere else
    other = tmp_path / "other"
    shutil.copytree(world, other)
    (other / "truth" / "loop.json").write_text(json.dumps({"loop_ns": WRONG_LOOP_NS}))
    assert compared(other, recording)["mean_mm"] > 2 * found["mean_mm"]
