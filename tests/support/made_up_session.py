"""A made-up live session: every kind of message once, of no, one and two people."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from posefuse.core import (
    SE3,
    Camera,
    CameraHealth,
    Detections2D,
    Kind,
    LiveDetections,
    LiveHealth,
    LiveJointCentres,
    LiveMessage,
    LiveNames,
    LivePose,
    LivePreview,
    LiveStart,
    OutputHealth,
    Pose3D,
    Rig,
)
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.kinematics import JointTracker
from posefuse.outputs.drawing import jpeg_of

RATE_HZ = 100.0
_BEGIN_NS = 1_700_000_000_000_000_000
_PERIOD_NS = 10_000_000
_PEOPLE_PER_TICK = (0, 1, 2, 2, 1, 0, 0, 2)
_K = len(BLAZEPOSE33)
_FIGURES = ("captured", "used", "replaced", "latency_p95_ms", "innovation_sigmas", "age_ms", "noise_scale")


def made_up_rig() -> Rig:
    """Two cameras side by side that look along +y."""
    intrinsics = np.array([[600.0, 0, 319.5], [0, 600, 239.5], [0, 0, 1]])
    looks_along_y = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    poses = (SE3.from_matrix(looks_along_y, -looks_along_y @ np.array([x, -4.0, 1.0])) for x in (-1.0, 1.0))
    cameras = [Camera(name=f"cam{i:02d}", size_wh=(640, 480), K=intrinsics, cam_from_world=pose) for i, pose in enumerate(poses)]
    return Rig(tuple(cameras), world_set_by="made up")


def made_up_start(part: int) -> LiveStart:
    """The first message."""
    offset_ns = time.time_ns() - time.monotonic_ns()
    return LiveStart(t_ns=_BEGIN_NS, rig=made_up_rig(), rate_hz=RATE_HZ, clock_offset_ns=offset_ns, notes={"a": "b"}, part=part)


def made_up_messages() -> Iterator[LiveMessage]:
    """Every kind of message after the first, in an order a session may have."""
    rig, angles = made_up_rig(), JointTracker(BLAZEPOSE33)
    yield LiveJointCentres(t_ns=_BEGIN_NS, cameras=rig.names, table=None)
    yield LiveNames(t_ns=_BEGIN_NS, names={7: "Ada"})
    for tick, people in enumerate(_PEOPLE_PER_TICK):
        pose = _pose(_BEGIN_NS + tick * _PERIOD_NS, people)
        for camera in rig:
            yield LiveDetections(detections=_detections(camera, pose), stages_ns={"received": pose.t_ns})
        joints = angles.step(pose) if tick % 2 else None
        yield LivePose(pose=pose, joints=joints, stages_ns={"output": pose.t_ns})
        yield LivePreview(camera=rig.names[0], t_ns=pose.t_ns, jpeg=jpeg_of(np.full((6, 8, 3), 90, np.uint8)), size_wh=(8, 6))
        yield _health(rig, pose.t_ns, faulty=tick == 2)


def _pose(t_ns: int, people: int) -> Pose3D:
    xyz = np.random.default_rng(0).normal(size=(people, _K, 3)) * 0.3 + [0, 0, 1.0]
    kind = np.full((people, _K), Kind.FUSED)
    xyz[:, 3], kind[:, 3] = np.nan, Kind.MISSING
    cov = np.tile(np.eye(3) * 1e-4, (people, _K, 1, 1))
    cov[:, 3] = np.nan
    ones = np.where(kind == Kind.MISSING, np.nan, 1.0)
    return Pose3D(
        t_ns=t_ns,
        skeleton=BLAZEPOSE33,
        person_id=np.arange(people) + 7,
        xyz_world=xyz,
        cov_world=cov,
        reproj_px=ones,
        n_views=2 * (kind != Kind.MISSING),
        kind=kind,
    )


def _detections(camera: Camera, pose: Pose3D) -> Detections2D:
    xy = camera.project(pose.xyz_world)
    score = np.where(np.isfinite(xy).all(axis=-1), 1.0, 0.0)
    return Detections2D.of(camera.name, pose.t_ns, BLAZEPOSE33, xy, score, np.where(score > 0, 2.0, np.nan))


def _health(rig: Rig, t_ns: int, faulty: bool) -> LiveHealth:
    figures = dict.fromkeys(_FIGURES, 1.0)
    cameras = {name: CameraHealth(state="ok", figures=figures) for name in rig.names}
    output = OutputHealth(where="somewhere", taken=3)
    if faulty:
        cameras[rig.names[0]] = CameraHealth(state="frozen", text="the same image", figures=figures)
        output = replace(output, state="failed", text="the disk is full", failures=1, fault="the disk is full")
    return LiveHealth(t_ns=t_ns, cameras=cameras, outputs={"other": output})
