"""Outputs of a whole live session that fail: reported at once, the recording continues, and the session ends with 1."""

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from live_session import Live, command, fill, until
from replaying import replay

from posefuse.formats.rig import read_rig
from posefuse_ros import topics
from posefuse_ros.bags import read_mcap, read_poses

pytestmark = pytest.mark.realtime

pytest.importorskip("rosbags")


def test_killed_outputs_are_reported_and_recording_continues_and_the_session_ends_with_1(
    demo_session: Path, tmp_path: Path
) -> None:
    recording, report = tmp_path / "a.mcap", tmp_path / "report"
    live = Live(command(demo_session, "--loop", "10", "--record", str(recording), "--report", str(report)))
    outputs = int(live.wait_for(r"outputs record in process (\d+)")[1])
    live.wait_for("cam03: ok")
    until(lambda: recording.stat().st_size > 100_000)
    os.kill(outputs, signal.SIGKILL)
    live.wait_for(f"outputs: failed: process {outputs} ended by signal SIGKILL; starting again")
    live.wait_for(f"output record: ok: continues in {tmp_path / 'a.2.mcap'}")
    until(lambda: (tmp_path / "a.2.mcap").stat().st_size > 100_000)
    live.process.send_signal(signal.SIGINT)
    figures, _ = live.ended(1)
    assert figures["failed"] == ["record"]
    assert figures["outputs_lost"] > 0
    assert [(event["output"], event["state"]) for event in figures["output_events"]] == [("process", "failed"), ("record", "ok")]
    assert json.loads((report / "latency.json").read_text())["output_events"] == figures["output_events"]
    diagnostics = [entry.msg for entry in read_mcap(tmp_path / "a.2.mcap", {topics.DIAGNOSTICS.name})]
    [line] = [status for status in diagnostics[-1].status if status.name.endswith("output record")]
    assert "continues after 1 failures" in line.message and "SIGKILL" in line.message
    said: list[str] = []
    first = list(read_poses(recording, warn=said.append))
    second = list(read_poses(tmp_path / "a.2.mcap", warn=said.append))
    assert first and second and len(said) == 1
    # a replay takes what was cut off, too
    assert replay(recording, read_rig(demo_session / "rig.toml"), said.append) == (len(first), len(first))
    assert len(said) == 2 and "was cut off" in said[-1]


def test_a_full_disk_ends_the_videos_which_is_reported_at_once_and_the_session_ends_with_1(
    demo_session: Path, small_disk: Callable[[int], Path]
) -> None:
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
