"""Live sessions as users run them, in processes of their own, with an oracle for the detector."""

import json
import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from built import turned
from live_session import Live, command, fill, until
from replaying import provenance_of, replay

from posefuse.core import Pose3D
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.rig import read_rig, write_rig
from posefuse.formats.truth import read_truth
from posefuse_ros import topics
from posefuse_ros.bags import read_mcap, read_poses
from posefuse_ros.messages import detections_from_message, ns_from_time, pose_from_message

pytestmark = pytest.mark.realtime

pytest.importorskip("rosbags")
PERIOD_NS = 10_000_000
FRESH_NS = 70_000_000
# figures, the recording, process ids of the cameras
Killed = tuple[dict, Path, list[int]]


def gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(") ")[1].startswith("Z")
    except FileNotFoundError:
        return True


@pytest.fixture(scope="module")
def killed(demo_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Killed:
    """A session in which one camera process is killed, and that is then stopped as by Ctrl-C."""
    recording = tmp_path_factory.mktemp("live") / "killed.mcap"
    # shown again and again: a busy machine may need longer than the clip to start a process again
    live = Live(command(demo_session, "--loop", "10", "--record", str(recording)))
    pids = [int(pid) for pid in re.findall(r"in process (\d+)", live.wait_for("in process.*")[0])]
    live.wait_for(r"cam03: ok")
    time.sleep(1.0)
    os.kill(pids[0], signal.SIGKILL)
    live.wait_for(r"cam00: dead.*SIGKILL")
    live.wait_for(r"cam01: ok")
    time.sleep(1.5)
    live.process.send_signal(signal.SIGINT)
    return live.figures(), recording, pids


def test_a_killed_camera_process_is_named_and_comes_back(killed: Killed) -> None:
    figures, _, _ = killed
    assert figures["restarts"] == 1
    assert {camera["state"] for camera in figures["cameras"].values()} == {"ok"}
    states = [(event["camera"], event["state"]) for event in figures["events"]]
    assert states.index(("cam00", "dead")) < len(states) - 1 - states[::-1].index(("cam00", "ok"))
    assert all(camera["used"] <= camera["captured"] for camera in figures["cameras"].values())


def test_ctrl_c_leaves_a_whole_recording_and_no_process(killed: Killed) -> None:
    figures, recording, pids = killed
    assert figures["stopped_by"] == "SIGINT"
    assert len(list(read_poses(recording))) == figures["poses"] > 100
    assert figures["outputs"]["record"]["dropped"] == figures["outputs_lost"] == 0
    assert all(gone(pid) for pid in pids)


def test_poses_come_at_every_tick_and_are_near_the_truth_at_output_time(killed: Killed, demo_session: Path) -> None:
    figures, recording, _ = killed
    truth = read_truth(demo_session / "truth" / "truth.npz")
    poses = [pose for pose, _ in read_poses(recording)]
    beats = np.diff([pose.t_ns for pose in poses])
    assert (beats % PERIOD_NS == 0).all()
    errors = []
    for pose in well_informed(recording):
        t_ns = pose.t_ns - figures["zero_ns"]
        if len(pose.person_id) and 1e9 < t_ns < truth.t_ns[-1]:
            true = pick_keypoints(true_xyz_at(truth, np.array([t_ns]))[0, 0], truth.skeleton, PAPER14.keypoints)
            got = pick_keypoints(pose.xyz_world[0], pose.skeleton, PAPER14.keypoints)
            errors.append(np.nanmean(np.linalg.norm(got - true, axis=-1)))
    assert len(errors) > 50
    # a frame (33 ms) wrong in time would add 45 mm
    assert np.median(errors) < 0.03


def well_informed(recording: Path) -> Iterator[Pose3D]:
    """Poses that came out when three cameras' views were not older than `FRESH_NS`: a busy machine gives up frames, and then a
    pose is as far off as what no person has seen yet."""
    newest: dict[str, int] = {}
    for entry in read_mcap(recording, {topics.DETECTIONS.name, topics.POSE.name}):
        if entry.topic == topics.DETECTIONS.name:
            view, _ = detections_from_message(entry.msg)
            newest[view.camera] = view.t_ns
            continue
        pose, _ = pose_from_message(entry.msg)
        if sum(pose.t_ns - t_ns <= FRESH_NS for t_ns in newest.values()) >= 3:
            yield pose


def test_joint_angles_are_recorded_with_every_pose(killed: Killed) -> None:
    poses = {pose.t_ns: len(pose.person_id) for pose, _ in read_poses(killed[1])}
    angles = [entry for entry in read_mcap(killed[1]) if entry.topic.endswith("/joint_angles")]
    assert len(angles) == sum(poses.values()) > 50
    assert {ns_from_time(entry.msg.header.stamp) for entry in angles} == {t_ns for t_ns, people in poses.items() if people}
    knee = [float(entry.msg.angle_rad[list(entry.msg.name).index("left_knee/flexion")]) for entry in angles]
    assert np.isfinite(knee).mean() > 0.9


def test_a_recording_states_how_it_was_made(killed: Killed, demo_session: Path) -> None:
    rig, (cameras, rig_id, config) = read_rig(demo_session / "rig.toml"), provenance_of(killed[1])
    assert (cameras, rig_id, config.detector.name) == (rig.names, rig.id, "oracle")
    assert config.detector.options["noise"] == {"sigma_px": 1.0}


@pytest.mark.parametrize(("request_", "by_all"), [("SIGTERM", False), ("SIGTERM", True), ("SIGHUP", True)])
def test_a_request_to_end_that_one_or_every_process_gets_ends_the_session_in_order_and_it_replays_without_settings(
    request_: str, by_all: bool, demo_session: Path, tmp_path: Path
) -> None:
    """A closed terminal sends SIGHUP to all of its processes; services, containers and `timeout` do so with SIGTERM."""
    number = getattr(signal, request_, None) or pytest.skip(f"this system has no {request_}")
    recording, videos = tmp_path / "x.mcap", tmp_path / "videos"
    options = ("--record", str(recording), "--videos", str(videos), "--duration", "600", "--loop", "10")
    live = Live(command(demo_session, *options, "--set", "track.lag_s=0.2"))
    children = re.findall(r"in process (\d+)", live.wait_for(r"cameras .* in process .*")[0])
    assert len(children) >= 3
    live.wait_for("cam03: ok")
    until(lambda: recording.stat().st_size > 200_000)
    for pid in (*map(int, children), live.process.pid, live.process.pid) if by_all else (live.process.pid,):
        os.kill(pid, number)
    figures, err = live.ended(128 + number)
    assert f"stopped by {request_} before 600 s were over" in err
    assert figures["failed"] == [] and figures["restarts"] == 0
    assert all(video["finished"] and video["written"] > 10 for video in figures["videos"].values())
    said: list[str] = []
    assert list(read_poses(recording, warn=said.append)) and not said
    poses, equal = replay(recording, read_rig(demo_session / "rig.toml"))
    assert equal == poses > 50


def test_the_figures_state_the_latency_of_each_stage(killed: Killed) -> None:
    figures, _, _ = killed
    for camera, stages in figures["latency"]["cameras_ms"].items():
        parts = sum(stages[stage]["mean"] for stage in ("capture", "wait", "2D", "fuse", "output"))
        assert stages["total"]["n"] == figures["cameras"][camera]["used"] or stages["total"]["n"] > 0
        assert parts == pytest.approx(stages["total"]["mean"], abs=0.5)
    assert ("cam00", "dead") in [(event["camera"], event["state"]) for event in figures["events"]]


def test_faulty_cameras_are_named_while_the_others_carry_on(demo_session: Path) -> None:
    with listener() as osc, listener() as plain:
        faults, to = (
            ("cam01=freeze@0.5-2.5", "cam02=unplug@1-2", "cam03=flood@2-3"),
            ("--json-udp", address(plain), "--osc", address(osc)),
        )
        figures = Live(command(demo_session, "--duration", "3.5", *to, faults=faults)).figures()
        assert osc.recv(65536).startswith(b"#bundle")
        shown = [json.loads(plain.recv(65536)) for _ in range(20)]
        assert all(one["keypoints"] for one in shown)
        assert any("left_knee/flexion" in one["angles_rad"] for one in shown)
    said = {(event["camera"], event["state"]) for event in figures["events"]}
    assert {("cam01", "frozen"), ("cam02", "lost"), ("cam03", "flood")} <= said
    assert not any(camera == "cam00" and state != "ok" for camera, state in said)
    assert figures["cameras"]["cam01"]["refused"]["frozen"] > 0
    assert figures["cameras"]["cam02"]["state"] == "ok"
    assert figures["poses_with_people"] > 0.7 * figures["poses"]


def test_a_moved_camera_is_named_and_left_out_and_killing_the_watch_ends_nothing(demo_session: Path, tmp_path: Path) -> None:
    rig = read_rig(demo_session / "rig.toml")
    write_rig(tmp_path / "before.toml", turned(rig, rig.names.index("cam01"), np.deg2rad([0.3, 1.4, 0.3])))
    live = Live(command(demo_session, "--loop", "10", rig=tmp_path / "before.toml"))
    watch = int(live.wait_for(r"rig watched in process (\d+)")[1])
    live.wait_for(r"cam01: moved: cam01 is off by \d+ mm")
    time.sleep(0.5)
    os.kill(watch, signal.SIGKILL)
    live.wait_for(f"rig watch: process {watch} ended by signal SIGKILL; started again")
    live.process.send_signal(signal.SIGINT)
    figures = live.figures()
    assert figures["cameras"]["cam01"]["refused"]["moved"] > 0
    assert f"process {watch} ended" in figures["rig_watch_trouble"]
    assert not {event["camera"] for event in figures["events"] if event["state"] == "moved"} - {"cam01"}


def listener() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.settimeout(1.0)
    return made


def address(bound: socket.socket) -> str:
    return f"127.0.0.1:{bound.getsockname()[1]}"


@pytest.mark.parametrize(
    ("source", "words"), [("cam00=video:nowhere.mp4", "no such video"), ("cam00=usb:/dev/video99", "No such file")]
)
def test_a_camera_that_cannot_be_opened_is_one_line(demo_session: Path, source: str, words: str) -> None:
    """What is wrong with the other options is found before, see `test_values`."""
    good = ("--source", f"cam01=video:{demo_session / 'videos' / 'cam01.mp4'}")
    done = subprocess.run(command(demo_session, *good, source=source), capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert source.partition(":")[2] in done.stderr and words in done.stderr


# --- outputs of a whole live session that fail: reported at once, the recording continues, and the session ends with 1


def test_killed_outputs_are_reported_and_the_session_ends_with_1(demo_session: Path, tmp_path: Path) -> None:
    """That all is in the recording is tested of outputs alone."""
    recording = tmp_path / "a.mcap"
    live = Live(command(demo_session, "--loop", "10", "--record", str(recording)))
    outputs = int(live.wait_for(r"outputs record in process (\d+)")[1])
    live.wait_for("cam03: ok")
    until(lambda: recording.stat().st_size > 100_000)
    os.kill(outputs, signal.SIGKILL)
    live.wait_for(f"outputs: failed: process {outputs} ended by signal SIGKILL; starting again")
    live.wait_for(f"output record: ok: continues in {tmp_path / 'a.2.mcap'}")
    until(lambda: (tmp_path / "a.2.mcap").stat().st_size > 100_000)
    live.process.send_signal(signal.SIGINT)
    figures, _ = live.ended(1)
    assert figures["failed"] == ["record"] and figures["outputs_lost"] > 0
    assert [(event["output"], event["state"]) for event in figures["output_events"]] == [("process", "failed"), ("record", "ok")]
    diagnostics = [entry.msg for entry in read_mcap(tmp_path / "a.2.mcap", {topics.DIAGNOSTICS.name})]
    [line] = [status for status in diagnostics[-1].status if status.name.endswith("output record")]
    assert "continues after 1 failures" in line.message and "SIGKILL" in line.message
    # a replay takes what was cut off, too
    said: list[str] = []
    poses, equal = replay(recording, read_rig(demo_session / "rig.toml"), said.append)
    assert equal == poses > 0
    assert len(said) == 1 and "was cut off" in said[0]


def test_a_full_disk_ends_the_videos_is_reported_at_once_and_the_session_ends_with_1(demo_session: Path, small_disk) -> None:
    disk = small_disk(4)
    live = Live(command(demo_session, "--loop", "10", "--videos", str(disk / "videos")))
    live.wait_for("cam03: ok")
    fill(disk / "filler")
    live.wait_for(r"video cam0\d: failed: .*cam0\d\.mp4: cannot be written \(No space left on device\)")
    (disk / "filler").unlink()
    live.process.send_signal(signal.SIGINT)
    figures, _ = live.ended(1)
    faults = [video["fault"] for video in figures["videos"].values()]
    assert any("No space left on device" in fault for fault in faults)
    assert (disk / "videos" / "rig.toml").is_file()
