"""Poses while they happen: `posefuse.live`."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from posefuse import core
from posefuse.core import (
    CameraHealth,
    Closing,
    Detections2D,
    InputError,
    JointAngles,
    LiveDetections,
    LiveHealth,
    LivePose,
    LivePreview,
    LiveStart,
    OutputHealth,
    Pose3D,
    Progress,
    SourceError,
)
from posefuse.foundation.worker import Worker
from posefuse.realtime.messages import AddOutput, KeepVideos, NamePerson, RemoveOutput, Request, ShowImages, Stop

from .arguments import shown

if TYPE_CHECKING:
    from posefuse.realtime.messages import LivePlan

_START_S = 180.0
# its files are finished as long as they make progress
_END_S = 120.0
_SEND_S, _LOOK_S = 1.0, 0.2


@dataclass(frozen=True, eq=False, kw_only=True)
class Newest:
    """The newest pose with its times on the clock of `time.monotonic_ns`.

    Attributes:
        message: pose and joint angles. t_ns: what time the pose is for. measured_ns: mid-exposure of the newest image in it.
        cameras, cameras_ns: state of every camera, and when it was reported.
    """

    message: LivePose
    t_ns: int
    measured_ns: int
    cameras: Mapping[str, CameraHealth]
    cameras_ns: int


class LiveSession(Closing):
    """A running live session; made by `live`. Use as a context manager and iterate over it: the newest pose wins.

    A slow program skips poses and gets the newest one next; it never delays the session.

    Attributes:
        ros: where ROS 2 is, see `live`. ros_used_elsewhere: by more than sources and outputs, as `teleoperate` does.
        angles: joint angles of the newest pose (T = 1); None before the first.
        cameras: state of every camera by name. outputs: of every output. news: lines that the session has reported, oldest first.
        on_image: takes each image that `show_images` asks for, and the detections in it (None: no person was seen); is called in
            a thread of the session and must return quickly. What it raises ends the session, and is raised where poses are
            waited for.
    """

    def __init__(self, plan: LivePlan, progress: Progress | bool | None = None, ros: Mapping[str, Any] | None = None) -> None:
        self._plan, self._progress, self.ros = plan, progress, dict(ros or {})
        self.ros_used_elsewhere = False
        self.angles: JointAngles | None = None
        self.cameras: Mapping[str, CameraHealth] = {}
        self.outputs: Mapping[str, OutputHealth] = {}
        self.on_image: Callable[[LivePreview, Detections2D | None], None] | None = None
        self._views: dict[str, Detections2D] = {}
        self.news: list[str] = []
        self._changed = threading.Condition()
        self._newest: LivePose | None = None
        self._offset_ns: int | None = None
        self._measured_ns = self._cameras_ns = 0
        self._given_ns: int | None = None
        self._ended = False
        self._error: Exception | None = None
        self._worker: Worker | None = None

    def __enter__(self) -> Self:
        """Start the session and wait for its first output tick.

        Raises:
            PosefuseError: what keeps it from beginning, e.g. a camera that cannot be opened, or that it has run already.
        """
        from posefuse.realtime.inputs import check_ros_is_used
        from posefuse.realtime.networks import fetch_networks
        from posefuse.realtime.session import serve

        if self._ended or self._worker is not None:
            raise SourceError("live: a session runs once; make another one with `posefuse.live`")
        if not self.ros_used_elsewhere:
            check_ros_is_used(self.ros, self._plan.inputs, self._plan.outputs)
        # once and here: every camera process would download what is missing for itself
        with shown(self._progress) as report:
            fetch_networks(self._plan.config.detector, report)
        self._worker = Worker(serve)
        self._worker.start(self._plan, self.on_image is not None)
        threading.Thread(target=self._hear, args=(self._worker,), daemon=True).start()
        try:
            self._wait(_START_S)
        except BaseException:
            self.close()
            raise
        return self

    def __iter__(self) -> Iterator[Pose3D]:
        """The newest pose, whenever there is one that was not given yet; ends with the session.

        Raises:
            PosefuseError: the session has not begun, or ended for a reason other than its time or its sources.
        """
        if self._worker is None:
            raise _not_begun()
        while (message := self._wait(None)) is not None:
            self.angles, self._given_ns = message.joints, message.pose.t_ns
            yield message.pose

    def wait_newer(self, t_ns: int, timeout_s: float) -> None:
        """Wait until there is a pose for another time than `t_ns`, the session has ended, or so long."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._ended or (self._newest is not None and self._newest.pose.t_ns != t_ns), timeout_s
            )

    def newest(self) -> Newest | None:
        """The newest pose at once, given or not; None before the first."""
        with self._changed:
            if self._newest is None or self._offset_ns is None:
                return None
            return Newest(
                message=self._newest,
                t_ns=self._newest.pose.t_ns - self._offset_ns,
                measured_ns=self._measured_ns - self._offset_ns,
                cameras=self.cameras,
                cameras_ns=self._cameras_ns - self._offset_ns,
            )

    @property
    def ended(self) -> bool:
        """Whether no more poses will come."""
        return self._ended or (self._worker is not None and not self._worker.running)

    def check(self) -> None:
        """Raise PosefuseError where the session ended for a reason other than its time or its sources; else what `on_image` or
        the function of ``progress`` raised."""
        if self._error is not None:
            raise self._error
        if self._worker is not None and self._worker.trouble and not self._ended:
            raise SourceError(f"live: the session's {self._worker.trouble}")

    @property
    def pid(self) -> int | None:
        """Of the session's process; None before it begins."""
        return self._worker.pid if self._worker is not None else None

    def show_images(self, rate_hz: float) -> None:
        """Give `on_image`, which was set before the session began, so many images per second and camera; 0: none."""
        self._ask(ShowImages(rate_hz))

    def keep_videos(self, folder: str | Path | None) -> None:
        """Keep the videos of all cameras in an existing folder from now on; None: finish them."""
        self._ask(KeepVideos(None if folder is None else Path(folder).absolute()))

    def switch_on(self, output: str, options: Mapping[str, Any] | None = None) -> None:
        """Open another output, see `live`; how it fares is in `outputs`. Where ROS is, it knows from there.

        Raises:
            ConfigError: no such output, or options it does not take.
            InputError: a file to record that exists already.
        """
        from posefuse.foundation.output_file import check_first_part
        from posefuse.foundation.plugins import plugin_config

        chosen = dict(options or {})
        if output == "record" and "path" in chosen:
            check_first_part(Path(chosen["path"]), option="record")
            chosen["path"] = Path(chosen["path"]).absolute()
        self._ask(AddOutput(output, plugin_config("live_outputs", output, chosen, known=self.ros)))

    def switch_off(self, output: str) -> None:
        """Finish and close an output; it is in `outputs` until that is done."""
        self._ask(RemoveOutput(output))

    def name_person(self, person_id: int, name: str) -> None:
        """Call a person so: outputs and recordings of this session, those that are open now included, have the name; empty: none.

        Raises:
            InputError: an id below 0, or a name of more than 64 characters.
        """
        from posefuse.association.settings import MOST_NAME

        if person_id < 0 or len(name.strip()) > MOST_NAME:
            raise InputError(f"person {person_id}: expected an id from 0 on and a name of at most {MOST_NAME} characters")
        self._ask(NamePerson(person_id, name.strip()))

    def _ask(self, request: Request) -> None:
        if self._worker is None:
            raise _not_begun()
        self._worker.send(request, _SEND_S)

    def close(self) -> None:
        """End the session; safe to call twice."""
        if self._worker is not None:
            self._worker.send(Stop(), _SEND_S)
            self._worker.end(_END_S)
        self._ended = True

    def _wait(self, timeout_s: float | None) -> LivePose | None:
        """The newest pose that was not given yet; None when the session is over."""
        with self._changed:
            # a wait without end could not be interrupted by Ctrl-C on every system
            waited_s = 0.0
            while not self._ended and not self._is_new():
                self._changed.wait(0.2)
                waited_s += 0.2
                self.check()
                if timeout_s is not None and waited_s > timeout_s:
                    raise SourceError(f"live: the session did not begin within {timeout_s:g} s")
            self.check()
            return self._newest if self._is_new() else None

    def _is_new(self) -> bool:
        return self._newest is not None and self._newest.pose.t_ns != self._given_ns

    def _hear(self, worker: Worker) -> None:
        """What the session sends, until it is over."""
        try:
            with shown(self._progress) as report:
                while worker.running and not self._ended:
                    worker.wait(_LOOK_S)
                    while (message := worker.receive()) is not None:
                        self._take(message, report)
        except Exception as error:  # noqa: BLE001 - of the program's own functions; raised where it waits for poses
            self._ended, self._error = True, error

    def _take(self, message: Any, report: Progress) -> None:
        from posefuse.realtime.session import Ended

        if isinstance(message, str):
            self.news.append(message)
            # a terminal that was closed
            with suppress(OSError, ValueError):
                report("live", 0, None, message)
        elif isinstance(message, LiveDetections):
            self._views[message.detections.camera] = message.detections
        elif isinstance(message, LivePreview):
            self._show(message)
        with self._changed:
            if isinstance(message, LivePose):
                self._newest = message
                self._measured_ns = message.stages_ns.get("exposed", self._measured_ns)
            elif isinstance(message, LiveHealth):
                self.cameras, self._cameras_ns = message.cameras, message.t_ns
                self.outputs = message.outputs
            elif isinstance(message, LiveStart):
                self._offset_ns = message.clock_offset_ns
            elif isinstance(message, Ended):
                self._ended, self._error = True, message.error
            self._changed.notify_all()

    def _show(self, image: LivePreview) -> None:
        view = self._views.get(image.camera)
        if self.on_image is not None:
            self.on_image(image, view if view is not None and view.t_ns == image.t_ns else None)


def _not_begun() -> SourceError:
    return SourceError("live: the session has not begun; use it as `with posefuse.live(...) as session:`")


def live(
    rig: core.Rig | str | Path,
    sources: Mapping[str, str] | Sequence[str],
    *,
    people: int | None = None,
    networks: str | Path | None = None,
    device: str | int | None = None,
    rate_hz: float | None = None,
    duration_s: float | None = None,
    record: str | Path | None = None,
    outputs: Mapping[str, Mapping[str, Any]] | None = None,
    settings: Mapping[str, Any] | None = None,
    config: str | Path | None = None,
    ros: Mapping[str, Any] | None = None,
    loop_s: float | Literal["shortest"] | None = None,
    progress: Progress | bool | None = None,
) -> LiveSession:
    """Track people in the images of calibrated cameras as they come.

    Args:
        rig: the cameras, or a rig file.
        sources: camera name -> ``usb:0``, ``rtsp://...``, ``video:FILE``, ``realsense:SERIAL`` ...; or a list as for ``posefuse
            live --source``, e.g. ``["sim:SESSION"]``.
        people: follow at most this many.
        networks: name of the 2D networks, or a model card (see docs/networks.md).
        device: processor, e.g. ``cpu`` or ``cuda:1``, or the number of a card of NVIDIA.
        rate_hz: poses per second.
        duration_s: None: until it is closed.
        record: .mcap file that keeps every detection and pose.
        outputs: options of more outputs by name, e.g. ``{"osc": {"to": ["localhost:9000"]}}``; see `posefuse plugins`.
        settings: any other setting by dotted key, as for ``posefuse live --set``. config: settings file.
        ros: where topics of ``ros:`` sources are: ``domain_id``, ``peers``, ``interface``, ``local_only``, ``sim_time``; see
            docs/ros.md. Outputs take the same, unless `outputs` has it, e.g. ``{"ros2": {"domain_id": 5}}``. A session without
            such a source or output is refused when it begins.
        loop_s: show the first seconds of videos and simulated sessions again and again; ``shortest``: as many as the shortest
            video has.
        progress: True shows the session's news on stderr.

    Raises:
        PosefuseError: settings, sources or outputs that cannot be.

    Examples:
        >>> import posefuse as pf
        >>> with pf.live("rig.toml", {"cam1": "usb:0", "cam2": "usb:1"}) as session:  # doctest: +SKIP
        ...     for pose in session:
        ...         print(pose.t_ns, pose.xyz_world)
    """
    from posefuse.detection.build import network_settings

    from .live_run import live_plan

    options = {"track.max_people": people, "rate_hz": rate_hz}
    changes = {key: value for key, value in options.items() if value is not None}
    changes |= network_settings(networks, device) | dict(settings or {})
    chosen: dict[str, Mapping[str, Any]] = dict(outputs or {})
    if record is not None:
        chosen["record"] = {**chosen.get("record", {}), "path": record}
    plan = live_plan(
        rig, sources, config=config, settings=changes, outputs=chosen, ros=ros, duration_s=duration_s, loop_s=loop_s
    )  # fmt: skip
    return LiveSession(plan, progress, ros)
