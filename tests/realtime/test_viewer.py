"""What the live viewer is given, read back by Rerun's own tool."""

from dataclasses import replace

import built
import cv2
import numpy as np
import pytest
from running import python

from posefuse.core import CameraHealth, LiveDetections, LiveHealth, LiveNames, LivePose, LivePreview, LiveStart
from posefuse.realtime.messages import SessionClock

pytest.importorskip("rerun", reason="the extra `viewer` is not installed")

from posefuse.outputs.live.viewer import RerunLiveConfig

S = 1_000_000_000


def test_people_pictures_and_faulty_cameras_are_logged(tmp_path, ring_rig) -> None:
    rig, clock = ring_rig(3), SessionClock.begin()
    now_ns = clock.now_ns()
    sink = RerunLiveConfig(file=tmp_path / "live.rrd").build()
    names = tuple(f"Person {letter}" for letter in "abcdefgh")
    sink.take(LiveStart(t_ns=now_ns, rig=rig, rate_hz=100.0, clock_offset_ns=clock.offset_ns, names=names))
    xyz = built.standing()[None]
    pose, no_person = built.pose(xyz, [7], now_ns, cov=np.eye(3)), built.pose(xyz[:0], [], now_ns + S)
    jpeg = cv2.imencode(".jpg", np.full((30, 40, 3), 90, np.uint8))[1].tobytes()
    sink.take(LivePose(pose=pose))
    sink.take(LiveDetections(detections=built.detections("cam01", rig["cam01"].project(xyz), now_ns)))
    sink.take(LivePreview(camera="cam02", t_ns=now_ns, jpeg=jpeg, size_wh=(40, 30)))
    states = {"cam00": ("ok", ""), "cam01": ("frozen", "the same image"), "cam02": ("ok", "")}
    cameras = {name: CameraHealth(state=state, text=text) for name, (state, text) in states.items()}
    sink.take(LiveHealth(t_ns=now_ns, cameras=cameras))
    sink.take(LiveNames(t_ns=now_ns, names={7: "Grace"}))
    sink.take(LivePose(pose=replace(pose, t_ns=now_ns + S // 2)))
    sink.take(LivePose(pose=no_person))
    sink.close()
    listing = python("-m", "rerun", "rrd", "print", "-vvv", str(tmp_path / "live.rrd")).stdout
    logged = [f"/world/{name}" for name in ("people/7/bones", "cameras/cam01/detections", "cameras/cam02/image")]
    logged += ["Person h", "Grace", "Clear", "cam01: frozen the same image"]
    assert [one for one in logged if one not in listing] == []
