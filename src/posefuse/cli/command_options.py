"""Options of single commands, apart from the commands, because what does the work of a command takes them, too."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import ArgumentCollection, Group, Parameter

from .options import (
    EXPERT,
    MOST_S,
    OUTPUTS,
    TIMING,
    NamedSettings,
    NetworkOptions,
    OptionalFile,
    Seconds,
    SettingsOptions,
    Sources,
    comma_numbers,
    count,
    positive,
)

EXCLUDED = re.compile(r"(?:(?P<camera>.+):)?(?P<start>-?\d+(?:\.\d*)?)-(?P<end>-?\d+(?:\.\d*)?)")


def _one_of_two(arguments: ArgumentCollection) -> None:
    given = [argument.name for argument in arguments if argument.has_tokens]
    if len(given) > 1:
        raise ValueError(f"expected one of {', '.join(given)}, got both")


def _check_excluded(_: object, texts: tuple[str, ...]) -> None:
    for text in texts:
        if not EXCLUDED.fullmatch(text):
            raise ValueError(f"expected CAMERA:START-END or START-END in seconds, e.g. cam02:1.5-2.5, got {text!r}")


def _check_id(_: object, value: int | None) -> None:
    if value is not None and value < 0:
        raise ValueError(f"expected a person's id, from 0 on, got {value}")


_SOLVE_AGAIN = Group("When SESSION is a result or the .mcap of a live session", sort_key=-2)
_AGAIN = Group("Earlier work in DIR", validator=_one_of_two, sort_key=-1)
_MAKES = Group("Result", sort_key=-3)


@dataclass(frozen=True, kw_only=True)
class TrackOptions(SettingsOptions):
    """What `posefuse track` reads and makes.

    Attributes:
        out: Folder for the result; must not exist, unless with --force or --resume.
        view: Open the result in the Rerun viewer (extra: viewer).
        exclude: Leave out a camera, or without a name all of them, from second A to B. May be given several times.
        keep_person: Keep only this person.
        no_edits: Ignore earlier marks: leave out nothing, keep all people.
        force: Replace the results in DIR, and start interrupted work from the beginning.
        resume: Continue where the same command was interrupted.
    """

    out: Annotated[Path, Parameter(metavar="DIR", group=_MAKES)]
    view: Annotated[bool, Parameter(group=_MAKES)] = False
    exclude: Annotated[tuple[str, ...], Parameter(metavar="[CAMERA:]A-B", group=_SOLVE_AGAIN, validator=_check_excluded)] = ()
    keep_person: Annotated[int | None, Parameter(metavar="ID", group=_SOLVE_AGAIN, validator=_check_id)] = None
    no_edits: Annotated[bool, Parameter(group=_SOLVE_AGAIN)] = False
    force: Annotated[bool, Parameter(group=_AGAIN)] = False
    resume: Annotated[bool, Parameter(group=_AGAIN)] = False


@dataclass(frozen=True, kw_only=True)
class BatchOptions(SettingsOptions):
    """What `posefuse batch` makes, and where it runs.

    Attributes:
        out: Folder for the results; run the same command again to continue.
        no_report: Do not write joint angles, gait and the report of each trial.
        jobs: Trials at once (default: as many as the cores and the free memory allow).
        scheduler: Run the trials on this Dask cluster, e.g. tcp://host:8786 (extra: cluster). It must see the same folders.
        force: Run trials again that were completed with other settings or from other files.
    """

    out: Annotated[Path, Parameter(metavar="DIR", group=_MAKES)]
    no_report: Annotated[bool, Parameter(group=_MAKES)] = False
    jobs: Annotated[int | None, Parameter(metavar="N", group=_MAKES), count(1024)] = None
    scheduler: Annotated[str | None, Parameter(metavar="ADDRESS", group=_MAKES)] = None
    force: Annotated[bool, Parameter(group=_MAKES)] = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """Where the images come from."""

    source: Sources = ()


@Parameter(name="*", group=TIMING)
@dataclass(frozen=True, kw_only=True)
class TimingOptions:
    """When a session begins and ends.

    Attributes:
        duration: Stop after so many seconds.
        loop: Show the first S seconds of videos and simulated sessions again and again.
    """

    duration: Annotated[float | None, Parameter(metavar="S")] = None
    loop: Annotated[float | None, Parameter(metavar="S"), EXPERT] = None


@Parameter(name="*", group=OUTPUTS)
@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Where the poses go.

    Attributes:
        record: Record views and poses.
        record_images: Record small images of the cameras, too.
        ros: Publish in ROS 2.
        ros1: Publish in ROS 1, at the master of ROS_MASTER_URI.
        osc: Send poses as OSC. May be given several times.
        json_udp: Send poses as JSON datagrams. May be given several times.
        output: Any other live output, e.g. lsl (`posefuse plugins` lists them); options: --set outputs.NAME.KEY=VALUE.
        axes: Axes of OSC and JSON (default z_up).
        view: Open the Rerun viewer (extra: viewer).
        view_file: Write what the viewer would show to a file.
        report: Write the latency of every camera and stage.
    """

    record: Annotated[Path | None, Parameter(metavar="FILE.mcap")] = None
    record_images: Annotated[bool, EXPERT] = False
    ros: bool = False
    ros1: Annotated[bool, EXPERT] = False
    osc: Annotated[tuple[str, ...], Parameter(metavar="HOST:PORT")] = ()
    json_udp: Annotated[tuple[str, ...], Parameter(metavar="HOST:PORT")] = ()
    output: Annotated[tuple[str, ...], Parameter(metavar="NAME")] = ()
    axes: Annotated[Literal["z_up", "y_up", "y_up_left_handed"] | None, Parameter(name_transform=str)] = None
    view: bool = False
    view_file: Annotated[Path | None, Parameter(metavar="FILE.rrd"), EXPERT] = None
    report: Annotated[Path | None, Parameter(metavar="DIR")] = None


@dataclass(frozen=True, kw_only=True)
class LiveOptions(SettingsOptions):
    """How the session works.

    Attributes:
        networks: 2D network: auto (default: the largest that processes every frame on this machine, measured at the start),
            blazepose_lite, blazepose_full, blazepose_heavy, blazepose_best, or your own model card (see docs/networks.md).
    """

    networks: Annotated[str | None, Parameter(metavar="auto|NAME|CARD.toml")] = None

    @property
    def given(self) -> bool:
        """Whether anything was given that changes how views become poses."""
        return bool(self.config or set(self.changes) - {"names", "rate_hz", "groups", "camera_info"})


# ten times the fastest camera of a laboratory
_MOST_HZ, _MOST_HEIGHT_M, _MOST_MM = 10_000.0, 3.0, 10_000.0
ClockMode = Literal["auto", "together", "offset", "drift"]
InputKind = Literal["auto", "videos", "images", "pose2d"]
File = Annotated[Path, Parameter(metavar="FILE")]
Target = Annotated[Path, Parameter(metavar="FILE.toml", help="Target file that `calibrate print` wrote: what the cameras see.")]
RateHz = Annotated[float | None, Parameter(metavar="HZ"), positive(_MOST_HZ)]
Every = Annotated[int, Parameter(metavar="N", help="Look at every Nth frame."), count(1_000_000), EXPERT]
Clocks = Annotated[
    ClockMode,
    Parameter(
        help="Estimate the clock offsets of the cameras: never (together), always (offset; with drift), or when needed (auto)."
    ),
]
MostSeconds = Annotated[
    float,
    Parameter(metavar="S", help="Largest clock offset between two cameras to search for, in seconds."),
    positive(MOST_S),
    EXPERT,
]
UpsideDown = Annotated[
    tuple[str, ...], Parameter(metavar="CAMERA", help="Camera that is mounted upside down. May be given several times.")
]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FileOptions:
    """What a step writes.

    Attributes:
        force: Replace files; the old ones are kept as NAME.replaced-TIME.
    """

    force: bool = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ReportOptions(FileOptions):
    """What a step writes.

    Attributes:
        report: HTML report; also written when the calibration is refused.
    """

    report: OptionalFile = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RigOptions(ReportOptions):
    """What a step writes.

    Attributes:
        out: Rig file to write.
    """

    out: File


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class IntrinsicsOptions(RigOptions):
    """From what the intrinsics are found."""

    target: Target
    every: Every = 1


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ExtrinsicsOptions(IntrinsicsOptions):
    """How the camera poses are found.

    Attributes:
        intrinsics: Rig file with the intrinsics; without it, they are found from the same recording, if it determines them.
        floor_marker: Marker that lies on the floor in the same recordings; without it, up is estimated from the cameras.
        floor_side_mm: Edge of that marker, where it differs from the target's.
        floor_points: Or: pixels per camera of three points of the floor: origin, one along x, one towards y.
        refine_lenses: Refine the intrinsics too; how well their focal lengths are known, in percent, e.g. 0.5.
        any_size: Accept a rig far smaller or larger than a room.
        keep_refused: Write a refused result too, marked as refused; `posefuse track` then warns each time.
    """

    intrinsics: OptionalFile = None
    floor_marker: Annotated[int | None, Parameter(metavar="ID")] = None
    floor_side_mm: Annotated[float | None, Parameter(metavar="MM"), positive(_MOST_MM)] = None
    floor_points: Annotated[Path | None, Parameter(metavar="FILE.toml")] = None
    clocks: Clocks = "auto"
    refine_lenses: Annotated[float | None, Parameter(metavar="PERCENT"), positive(100), EXPERT] = None
    any_size: Annotated[bool, EXPERT] = False
    keep_refused: Annotated[bool, EXPERT] = False
    upside_down: UpsideDown = ()


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PersonOptions(RigOptions, NetworkOptions):
    """How the camera poses are found from a person.

    Attributes:
        intrinsics: Rig file with the intrinsics.
        height_m: Height of the person in metres, which sets the scale within a few per cent.
        apart: Or: the measured distance of two cameras.
        rate: Frame rate of 2D poses.
    """

    intrinsics: File
    height_m: Annotated[float | None, Parameter(metavar="M"), positive(_MOST_HEIGHT_M)] = None
    apart: Annotated[tuple[str, str, float] | None, Parameter(metavar="CAMERA CAMERA METRES")] = None
    rate: Annotated[RateHz, EXPERT] = None
    clocks: Clocks = "auto"
    most_s: MostSeconds = 10.0
    upside_down: UpsideDown = ()


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ClockOptions(ReportOptions, NetworkOptions):
    """How the clock offsets are found.

    Attributes:
        rig: Calibration file, when it is not in SESSION.
        input: Which data of the session to use.
        clocks: Whether to estimate a drift (a different clock rate) as well.
        rate: Frame rate of 2D poses and images that state none.
        seconds: Use so many seconds from the middle of the recording.
    """

    rig: OptionalFile = None
    input: Annotated[InputKind | None, EXPERT] = None
    clocks: Literal["offset", "drift"] = "offset"
    rate: Annotated[RateHz, EXPERT] = None
    seconds: Annotated[float, Parameter(metavar="S"), positive(MOST_S), EXPERT] = 60.0
    most_s: MostSeconds = 10.0


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class VerifyOptions(ReportOptions):
    """What is verified.

    Attributes:
        rig: Rig file to verify.
        offset_ms: Clock offset in milliseconds, in place of those in posefuse.toml next to the rig file. May be given several
            times.
    """

    rig: File
    target: Target
    every: Every = 1
    offset_ms: Annotated[tuple[str, ...], Parameter(metavar="CAMERA=MS")] = ()


@dataclass(frozen=True, kw_only=True)
class PrintOptions(FileOptions, NamedSettings):
    """What is printed.

    Attributes:
        out: PDF to write; its description, which the other steps take as --target, goes next to it.
        cube: Six markers for a cube.
        page: Paper: a4, a3, a2, a1, a0 or letter.
    """

    out: File
    cube: bool = False
    page: Annotated[str, Parameter(metavar="SIZE")] = "a4"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class GuideOptions:
    """The cameras, and where their videos go.

    Attributes:
        intrinsics: Rig file that gives the cameras' names and their order.
        record: Keep the videos in this new folder, as `posefuse record` does: the target need not be moved a second time.
        duration: Stop after so many seconds at the latest.
    """

    target: Target
    source: Annotated[Sources, Parameter(required=True)]
    intrinsics: OptionalFile = None
    record: Annotated[Path | None, Parameter(metavar="SESSION")] = None
    duration: Seconds = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RecordOptions:
    """The cameras, and where their videos go.

    Attributes:
        out: New folder: videos/CAMERA.mp4, and CAMERA.json with what was lost.
        rig: Rig file to put into the session; frames must have its sizes.
        duration: Stop so many seconds after the first frame of the last camera; else at Ctrl-C, or when the sources end.
        resume: Complete the recording of SESSION that was interrupted; no cameras are opened.
    """

    source: Sources = ()
    out: Annotated[Path, Parameter(metavar="SESSION")]
    rig: OptionalFile = None
    duration: Seconds = None
    resume: bool = False


HAND, ROBOT, ROBOT_ROS = map(Group.create_ordered, ("Hand", "Robot", "Robot over ROS"))
Place, Box = comma_numbers("X,Y,DEG"), comma_numbers("X0,Y0,Z0,X1,Y1,Z1")


@dataclass(frozen=True, kw_only=True)
class RobotOptions(NamedSettings):
    """Which hand, which robot, its position and its limits.

    Attributes:
        hand: The hand that the robot follows; both move a robot with two arms (default right).
        deadman: key (space bar), joystick:/dev/input/js0, ros:/joy, web[:PORT] (a page with a button), gesture (the other hand
            raised).
        i_have_an_emergency_stop: An emergency stop of the robot is within reach: lets a gesture move a robot over ROS.
        robot: Our own mobile manipulator, or an MJCF model with position actuators.
        frame: Site (with --command pose or twist: tf frame) of the end effector, one per hand (default right_hand, left_hand).
        robot_at: Where the robot's base frame stands in the world of the rig, m and degrees (default 0,0,0).
        elsewhere: The robot is not in the operator's room: no separation is kept. Wrong for a robot that any person can reach.
        box: Corners of the workspace of the end effector, world axes, m (default -10,-10,0.05,10,10,2).
        speed: Speed limit of the end effector, m/s (default 0.5).
        limits: All settings of teleoperation, see docs/teleoperation.md; an option that is given overrides the file.
        view: Open MuJoCo's viewer.
        view_scene: Show operator, robot, workspace and keep-out in the Rerun viewer (extra: viewer).
        view_file: Write what that viewer would show to a file.
        record: Record views and poses; the robot's commands and states go to FILE.robot.mcap.
    """

    hand: Annotated[Literal["right", "left", "both"] | None, Parameter(group=HAND)] = None
    deadman: Annotated[str, Parameter(metavar="SWITCH", group=HAND)] = "key"
    i_have_an_emergency_stop: Annotated[bool, Parameter(group=HAND)] = False
    robot: Annotated[str, Parameter(metavar="sim|FILE.xml")] = "sim"
    frame: Annotated[tuple[str, ...], Parameter(metavar="SITE")] = ()
    robot_at: Annotated[tuple[float, float, float] | None, Place] = None
    elsewhere: bool = False
    box: Annotated[tuple[float, float, float, float, float, float] | None, Box] = None
    speed: Annotated[float | None, Parameter(metavar="M/S"), positive(2)] = None
    limits: Annotated[Path | None, Parameter(metavar="FILE.toml")] = None
    view: bool = False
    view_scene: Annotated[bool, EXPERT] = False
    view_file: Annotated[Path | None, Parameter(metavar="FILE.rrd"), EXPERT] = None
    record: Annotated[Path | None, Parameter(metavar="FILE.mcap", group=OUTPUTS)] = None

    @property
    def changes(self) -> dict[str, Any]:
        """Those of options that are several settings, too."""
        *place, heading_deg = self.robot_at or (None,)
        both = ("right", "left") if self.hand == "both" else (self.hand,)
        more = {
            "hands": both if self.hand else None,
            "robot.position_xy_m": place or None,
            "robot.heading_deg": heading_deg,
            "robot.shared": False if self.elsewhere else None,
            "limits.box_low_m": self.box and self.box[:3],
            "limits.box_high_m": self.box and self.box[3:],
            "limits.speed_mps": self.speed,
        }
        return {**super().changes, **{key: value for key, value in more.items() if value is not None}}


@Parameter(name="*", group=ROBOT_ROS)
@dataclass(frozen=True, kw_only=True)
class RosRobotOptions:
    """A real robot over ROS, and what is shown there.

    Attributes:
        ros: Publish state, target, box and keep-out in ROS 2; with --command, drive a robot.
        ros1: The same in ROS 1, at the master of ROS_MASTER_URI; the mobile base takes Twist.
        command: What the robot is sent: target poses, velocities, or joints by our own inverse kinematics (--robot FILE.xml).
        base_frame: tf frame that commands are given in.
        controller: Topic of joints: trajectory_msgs/JointTrajectory, or std_msgs/Float64MultiArray where it ends in /commands.
        cmd_vel: Topic of the mobile base.
        cmd_vel_twist: The mobile base takes Twist (ROS 2 Humble and older), not TwistStamped.
    """

    ros: bool = False
    ros1: Annotated[bool, EXPERT] = False
    command: Literal["pose", "twist", "joints"] | None = None
    base_frame: Annotated[str, Parameter(metavar="FRAME"), EXPERT] = "base_link"
    controller: Annotated[str, Parameter(metavar="TOPIC"), EXPERT] = "/joint_trajectory_controller/joint_trajectory"
    cmd_vel: Annotated[str, Parameter(metavar="TOPIC"), EXPERT] = ""
    cmd_vel_twist: Annotated[bool, EXPERT] = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """How two recordings are aligned, and where the comparison goes.

    Attributes:
        out: Write compare.html and compare.json there.
        person: Which person of files that hold several.
        scale: Estimate the scale of B, too.
        no_time: Do not align in time: both have the times of one clock.
        no_space: Do not align in space: both have the coordinates of one system.
        align_first: Align in space by the first S seconds only, so that drift shows.
    """

    out: Annotated[Path | None, Parameter(metavar="DIR")] = None
    person: Annotated[int | None, Parameter(metavar="ID")] = None
    scale: bool = False
    no_time: bool = False
    no_space: bool = False
    align_first: Annotated[float | None, Parameter(metavar="S"), positive(MOST_S)] = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """The scenes, and what runs the network.

    Attributes:
        scenes_in: Folder for the rendered scenes; later fits use them again.
        scenes: Scenes for the noise.
        moving: Scenes for the joint centres; at most 16.
        engine: What runs the network.
    """

    scenes_in: Annotated[Path, Parameter(metavar="DIR")]
    scenes: Annotated[int, Parameter(metavar="N"), count(100)] = 24
    moving: Annotated[int, Parameter(metavar="N"), count(100)] = 16
    engine: Literal["openvino", "onnxruntime"] = "openvino"
