"""Checks that every plug-in passes, ours and others'. Call them from the plug-in's own tests.

Each raises `ContractError` naming the rule that is broken; passing returns None.
"""

from __future__ import annotations

import dataclasses
import itertools
import pickle
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from posefuse.core import (
    SE3,
    Camera,
    CameraHealth,
    Detections2D,
    Detector,
    Frame,
    JointCentres,
    Kind,
    LiveDetections,
    LiveHealth,
    LiveJointCentres,
    LiveMessage,
    LiveNames,
    LiveOutput,
    LiveOutputConfig,
    LivePose,
    LivePreview,
    LiveStart,
    OutputHealth,
    Pose3D,
    PosefuseError,
    Recording,
    Region,
    Rig,
    Sink,
    Source,
)
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.detection.build import broken_rule
from posefuse.kinematics import JointTracker
from posefuse.outputs.drawing import jpeg_of

_ENOUGH_FRAMES = 20


class ContractError(PosefuseError):
    """A plug-in that does not do what `core.protocols` asks."""


def check_source(source: Source, most_frames: int = _ENOUGH_FRAMES) -> None:
    """A source: named frames of one size, seq and times strictly increasing, starts again from the beginning, closes twice."""
    _require(isinstance(source, Source), f"{type(source).__name__} lacks a member of core.Source")
    first = list(itertools.islice(source.frames(), most_frames))
    _require(len(first) > 0, "frames() gives at least one frame")
    for frame in first:
        _require(frame.camera == source.camera, f"a frame's camera is the source's ({frame.camera!r}, {source.camera!r})")
        _require(frame.size_wh == source.size_wh, f"every frame has the stated size ({frame.size_wh}, {source.size_wh})")
    for earlier, later in itertools.pairwise(first):
        _require(later.seq > earlier.seq, f"seq increases ({earlier.seq}, {later.seq})")
        _require(later.t_ns > earlier.t_ns, f"t_ns increases ({earlier.t_ns}, {later.t_ns})")
    again = next(iter(source.frames()), None)
    _require(again is not None, "frames() may be called again")
    source.close()
    source.close()


def check_detector(detector: Detector, frames: Sequence[Frame]) -> None:
    """A detector: one answer per frame in order, its own skeleton, missing is NaN with score 0, sigma where a score is.

    Where it knows joint centres, it hands over a `core.JointCentres`.

    `frames` are a few images, with or without people, of any cameras.
    """
    _require(isinstance(detector, Detector), f"{type(detector).__name__} lacks a member of core.Detector")
    centres = detector.joint_centres
    _require(centres is None or isinstance(centres, JointCentres), "joint_centres is a core.JointCentres, or None")
    _require(detector.detect([], []) == [], "no frames give no answers")
    half = min(frames[0].size_wh) / 2
    region = Region(centre_img=np.array(frames[0].size_wh) / 2, side_px=2 * half)
    asked: tuple[list[Region] | None, ...] = (None, [region], [])
    for regions in ([one] * len(frames) for one in asked):
        broken = broken_rule(detector, frames, regions, detector.detect(frames, regions))
        _require(not broken, broken)


def check_output(sink: Sink, recording: Recording, folder: Path) -> None:
    """A sink: writes at least one new, non-empty file into the folder and names exactly what it wrote."""
    _require(isinstance(sink, Sink), f"{type(sink).__name__} lacks a member of core.Sink")
    _require(sink.name != "", "a sink has a name")
    before = set(folder.rglob("*"))
    written = sink.write(recording, folder)
    _require(len(written) > 0, "write() returns the files it made")
    for path in written:
        _require(path.is_file() and path.stat().st_size > 0, f"{path.name} exists and is not empty")
        _require(path.is_relative_to(folder), f"{path} lies in the folder given")
    unnamed = {path for path in set(folder.rglob("*")) - before if path.is_file()} - set(written)
    _require(not unnamed, f"write() names all files it made (not named: {sorted(path.name for path in unnamed)})")


def check_live_output(config: LiveOutputConfig, folder: Path) -> None:
    """A live output: its config can be sent to a process, it takes a whole session, closes twice, and continues in new files.

    `folder` is where `config` makes it write its files, if any; a first part is never changed by a later one.
    """
    _require(isinstance(config, LiveOutputConfig), f"{type(config).__name__} lacks a member of core.LiveOutputConfig")
    _require(_is_frozen(config), "a config is a frozen dataclass")
    _require(_sent(config) == config, "a config comes out of pickle as it went in")
    known = LiveMessage.__args__
    _require(len(config.takes) > 0 and set(config.takes) <= {*known} - {LiveStart}, "takes names classes of core.live_messages")
    _take_part(config, 1)
    before = _contents(folder)
    _take_part(config, 2)
    changed = sorted(path.name for path, content in before.items() if _contents(folder).get(path) != content)
    _require(not changed, f"a later part leaves the files of the first as they are (not: {changed})")


def _sent(config: LiveOutputConfig) -> LiveOutputConfig | None:
    try:
        return pickle.loads(pickle.dumps(config))  # type: ignore[no-any-return]
    except (pickle.PicklingError, AttributeError, TypeError):
        return None


def _take_part(config: LiveOutputConfig, part: int) -> None:
    config.build().close()
    output = config.build()
    _require(isinstance(output, LiveOutput), f"{type(output).__name__} lacks a member of core.LiveOutput")
    _require(output.name != "" and isinstance(output.where, str), "an output has a name, and where is text")
    for message in _of_session(config, part):
        with _bears(f"take() bears every {type(message).__name__} of a session"):
            output.take(message)
    with _bears("close() may be called twice"):
        output.close()
        output.close()


@contextmanager
def _bears(rule: str) -> Iterator[None]:
    try:
        yield
    except PosefuseError:
        raise
    except Exception as error:
        raise ContractError(f"contract broken: {rule} ({type(error).__name__}: {error})") from error


def _of_session(config: LiveOutputConfig, part: int) -> Iterator[LiveMessage]:
    yield made_up_start(part)
    yield from (message for message in made_up_messages() if isinstance(message, config.takes))


def _contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def _is_frozen(config: object) -> bool:
    return dataclasses.is_dataclass(config) and bool(getattr(config, "__dataclass_params__").frozen)  # noqa: B009


def _require(holds: bool, rule: str) -> None:
    if not holds:
        raise ContractError(f"contract broken: {rule}")


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
