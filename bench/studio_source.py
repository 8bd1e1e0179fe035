"""A live session that costs no detector: the bundled clip with its exact truth, over the same host as a session with cameras.

    python bench/studio_source.py WORKSPACE CAMERAS

What a server and a page do with it is what they do with a real session; how the poses came about makes no difference to them.
"""

from __future__ import annotations

import atexit
import itertools
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posefuse.core.joint_angles import angle_labels
from posefuse.formats.truth import read_truth
from posefuse.pipeline.session import clip_folder
from posefuse.sources import VideoConfig
from posefuse_studio.jobs import JOBS_FOLDER, LIVE, Job
from posefuse_studio.scene_messages import image_message, page_message, poses_message, setup_message
from posefuse_studio.session import CameraStatus, Host, SessionStatus
from posefuse_studio.work import JobReporter
from posefuse_studio.workspace import StudioWorkspace, write_stored

IMAGES_HZ, POSES_HZ = 15.0, 40.0
_SHOWN_WH = (320, 240)
_SIGMA_M = 0.01


def images_of(video: Path, most: int) -> list[bytes]:
    """The first frames as the live session's small images."""
    found = []
    for frame in itertools.islice(VideoConfig(video, video.stem).build().frames(), most):
        small: Any = cv2.resize(frame.image, _SHOWN_WH, interpolation=cv2.INTER_AREA)
        _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 70])
        found.append(jpeg.tobytes())
    return found


def main() -> None:
    """Until it is ended."""
    workspace, cameras = StudioWorkspace(Path(sys.argv[1])), int(sys.argv[2])
    clip = clip_folder()
    truth = read_truth(clip / "truth" / "truth.npz")
    rig, poses = truth.rig, truth
    jpegs = [images_of(path, len(poses.t_ns)) for path in sorted((clip / "videos").glob("*.mp4"))]
    folder = workspace.folder(f"{JOBS_FOLDER}/{time.strftime('%Y%m%d-%H%M%S')}-live")
    write_stored(folder / "job.json", Job(work=LIVE, title="Bench", arguments={}, begun_s=time.time()))
    report, host = JobReporter(workspace, folder.name), Host()
    report.listens(host.address)
    names = [f"cam{number:02d}" for number in range(cameras)]
    lenses = [rig.cameras[number % len(rig)] for number in range(cameras)]
    joints = truth.joints
    assert joints is not None, "the clip of a checkout has joint angles; that of a wheel has no truth"
    plots = angle_labels(joints, " ")
    host.publish("setup", setup_message(rig, poses.skeleton), keep=True)
    cov = np.broadcast_to(np.diag([1.0, 1.0, 4.0]) * _SIGMA_M**2, (*poses.xyz_world.shape[1:3], 3, 3))
    shown = {
        name: CameraStatus(light="good", state="ok", figures="30/s", size_wh=lens.size_wh)
        for name, lens in zip(names, lenses, strict=True)
    }
    status = SessionStatus(cameras=shown, people=truth.person_id.tolist(), plots=plots)
    begun, sent = time.monotonic(), [0.0, 0.0, 0.0]
    atexit.register(report.end, state="cancelled")
    while not report.cancelled.is_set():
        t_s = time.monotonic() - begun
        frame = int(t_s * 30) % len(poses.t_ns)
        xyz = poses.xyz_world[frame]
        if host.watched and t_s - sent[0] >= 1 / POSES_HZ:
            sent[0] = t_s
            host.publish("poses", poses_message(t_s, poses.person_id, xyz, cov))
            degrees = np.degrees(joints.angle_rad[frame, 0]).ravel()
            values = np.stack([degrees, np.full(len(degrees), np.nan)], axis=-1)
            host.publish("values", page_message("values", {"values": values}, t_s=t_s))
        if host.watched and t_s - sent[1] >= 1 / IMAGES_HZ:
            sent[1] = t_s
            for number, lens in enumerate(lenses):
                scale = np.divide(_SHOWN_WH, lens.size_wh)
                fused = lens.project(xyz) * scale
                jpeg = jpegs[number % len(jpegs)][frame]
                image_now = image_message(
                    t_s, number, jpeg, _SHOWN_WH, detected_px=fused, projected_px=fused, rgba=[(38, 166, 154, 255)]
                )
                host.publish(f"image {number}", image_now)
        if t_s - sent[2] >= 0.25:
            sent[2] = t_s
            status = replace(status, seconds=t_s)
            host.status(status)
        time.sleep(0.004)


if __name__ == "__main__":
    # a request to end it comes as an interrupt, see `posefuse_studio.work`
    with suppress(KeyboardInterrupt):
        main()
