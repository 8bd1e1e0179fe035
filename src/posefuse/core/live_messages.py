"""What a live session gives to its outputs: one class per kind of message. Times are session time, ns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .joint_angles import JointAngles
from .joint_centres import JointCentres
from .poses import Pose3D
from .rig import Rig
from .values import Detections2D

OK, FAILED = "ok", "failed"


@dataclass(frozen=True, eq=False, kw_only=True)
class LiveStart:
    """The first message an output takes; files and streams are opened with it.

    Attributes:
        t_ns: when the session began. rig: its cameras. rate_hz: output rate, poses per second.
        clock_offset_ns: session time minus `time.monotonic_ns()` of this machine.
        notes: how the session was made, texts for a file. names: of the people, in the order of their ids.
        part: 1; one more each time an output continues after a failure.
    """

    t_ns: int
    rig: Rig
    rate_hz: float
    clock_offset_ns: int
    notes: Mapping[str, str] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    part: int = 1


@dataclass(frozen=True, kw_only=True)
class LiveJointCentres:
    """How joint centres lie relative to the keypoints in the detections of some cameras.

    Attributes:
        t_ns: when it became known. cameras: their names.
        table: the offsets; None: there are none, or they are not known.
    """

    t_ns: int
    cameras: tuple[str, ...]
    table: JointCentres | None


@dataclass(frozen=True, eq=False, kw_only=True)
class LiveNames:
    """Names that people were given while the session runs.

    Attributes:
        t_ns: when. names: all that are known now, by person id.
    """

    t_ns: int
    names: Mapping[int, str]


@dataclass(frozen=True, eq=False, kw_only=True)
class LiveDetections:
    """The people one camera saw in one frame.

    Attributes:
        detections: their t_ns is mid-exposure. stages_ns: when the frame passed each stage, by stage name.
    """

    detections: Detections2D
    stages_ns: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class LivePose:
    """One output tick.

    Attributes:
        pose: everybody, predicted to its t_ns. joints: angles of the same people, T = 1; None where they are not wanted.
        stages_ns: when it passed each stage, by stage name.
    """

    pose: Pose3D
    joints: JointAngles | None = None
    stages_ns: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class LiveExpected:
    """Where cameras of other machines are to look for people in their next frames.

    Attributes:
        pose: everyone who is tracked, also those who are not sure enough for `LivePose`; keypoints as the network marks them.
    """

    pose: Pose3D


@dataclass(frozen=True, eq=False, kw_only=True)
class LivePreview:
    """A small image of a camera, for viewers.

    Attributes:
        camera: its name. t_ns: mid-exposure. jpeg: the file's bytes. size_wh: of the small image, px.
    """

    camera: str
    t_ns: int
    jpeg: bytes
    size_wh: tuple[int, int]


@dataclass(frozen=True)
class CameraHealth:
    """State of one camera.

    Attributes:
        state: ``ok``, ``opening``, ``ended``, ``lost``, ``dead``, ``silent``, ``frozen``, ``late``, ``clock`` or ``flood``;
            ``overload`` (the machine is too slow for a diagnosis), or what the rig watch found: ``moved``, ``unsynchronised`` or
            ``swapped``. docs/live.md explains them.
        text: why. figures: by name.
    """

    state: str
    text: str = ""
    figures: Mapping[str, float] = field(default_factory=dict, kw_only=True)


@dataclass(frozen=True, kw_only=True)
class OutputHealth:
    """State of one output.

    Attributes:
        state: ``ok``, ``failed`` (it is opened again after a while) or ``hangs``. text: why.
        where: file or address it goes to now; may be empty.
        taken, dropped: messages. failures: how often it failed. fault: of the newest failure, empty when there was none.
    """

    state: str = OK
    text: str = ""
    where: str = ""
    taken: int = 0
    dropped: int = 0
    failures: int = 0
    fault: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class LiveHealth:
    """How every camera and every output fares, by name; a few times a second."""

    t_ns: int
    cameras: Mapping[str, CameraHealth]
    outputs: Mapping[str, OutputHealth] = field(default_factory=dict)


LiveMessage = LiveStart | LiveJointCentres | LiveNames | LiveDetections | LivePose | LiveExpected | LivePreview | LiveHealth
