"""A ROS 2 image topic as a source: `sensor_msgs/Image` or `CompressedImage`, without a ROS installation."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

from posefuse.core import Camera, Frame, PosefuseError, SourceError
from posefuse.core.errors import choices
from posefuse.core.ideal_image import has_lens
from posefuse.foundation.parsing import ros_name

from .camera_info import RigLens, compare_camera_infos
from .camera_messages import COMPRESSED_TYPE, IMAGE_TYPE, frame_from_message
from .dds import RosNode
from .dds_domain import NetworkSettings
from .sim_time import ClockReader
from .topics import CLOCK, Topic
from .types import decode

_MAX_BYTES = 2**28
_DEPTH = 4
_POLL_S = 0.1
# an image that is older by more was not overtaken on the way
_SET_BACK_NS = 1_000_000_000


@dataclass(frozen=True, kw_only=True)
class RosConfig(NetworkSettings):
    """A topic with one camera's images; their stamps are taken as mid-exposure.

    Attributes:
        topic: e.g. ``/camera1/image_raw``; one that ends in ``/compressed`` holds `CompressedImage`.
        camera: name of the camera in the rig.
        wait_s: how long the first image may take.
        sim_time: stamps are simulated time; `/clock` relates them to this machine's clock (ROS: `use_sim_time`).
        lens: the rig's camera; images of an ideal camera, as simulators draw them, get its lens (`camera_info`).
    """

    topic: str
    camera: str
    wait_s: float = 10.0
    sim_time: bool = False
    lens: Camera | None = None

    compare_rig = staticmethod(compare_camera_infos)

    def build(self) -> RosSource:
        """Subscribe and wait for the first image; raises SourceError that lists what is there when none arrives."""
        return RosSource(self)


class RosSource:
    """Frames of an image topic, live: the newest few are kept while no one takes them.

    Attributes:
        refused_frames: messages that could not be read, changed size or went back in time, not given on.
        last_refusal: why, of the newest one.
    """

    def __init__(self, config: RosConfig) -> None:
        self._config = config
        self.camera = config.camera
        self.refused_frames, self.last_refusal = 0, ""
        self._seq, self._newest_ns = -1, -(2**63)
        self._lens = RigLens(config.lens) if config.lens is not None and has_lens(config.lens) else None
        self._closed = False
        # the session's clock does not jump when this machine's is set
        self._session_from_monotonic_ns = time.time_ns() - time.monotonic_ns()
        self._node = RosNode(f"posefuse/source_{ros_name(config.camera)}", config.network)
        self._sim_time = ClockReader(self._node) if config.sim_time else None
        type_name = COMPRESSED_TYPE if config.topic.endswith("/compressed") else IMAGE_TYPE
        self._topic = Topic(config.topic, type_name, depth=_DEPTH)
        self._reader = self._node.reader(self._topic)
        self._first = self._wait_for_first()
        self.size_wh = self._first.size_wh

    def frames(self) -> Iterator[Frame]:
        """Frames as they come, until `close`; the first call begins with the image `build` waited for."""
        if self._first.seq == self._seq == 0:
            yield self._first
        try:
            while not self._closed:
                yield from self._take()
                self._node.wait(_POLL_S)
        except SourceError:
            # a reader may be closed while it is read
            if not self._closed:
                raise

    def close(self) -> None:
        """Leave the network; a running `frames` ends soon. Safe to call twice."""
        self._closed = True
        self._node.close()

    def _wait_for_first(self) -> Frame:
        end = time.monotonic() + self._config.wait_s
        while time.monotonic() < end:
            self._node.wait(_POLL_S)
            for frame in self._take():
                return frame
        problem = self._nothing_came()
        self.close()
        raise SourceError(problem)

    def _take(self) -> Iterator[Frame]:
        if self._sim_time is not None:
            self._sim_time.update()
        for sample in self._reader.take():
            received_ns = time.monotonic_ns() + self._session_from_monotonic_ns
            try:
                msg = decode(sample.raw, self._topic.type_name, _MAX_BYTES)
                frame = frame_from_message(msg, self.camera, self._seq + 1, received_ns)
                image = frame.image if self._lens is None else self._lens(frame.image)
                frame = replace(frame, t_ns=self._session_ns(frame.t_ns), image=image)
                self._check(frame)
            except PosefuseError as error:
                self.refused_frames += 1
                self.last_refusal = str(error)
                continue
            self._seq, self._newest_ns = frame.seq, frame.t_ns
            yield frame

    def _check(self, frame: Frame) -> None:
        # a clock that was set back gives older times from then on
        if 0 <= self._newest_ns - frame.t_ns < _SET_BACK_NS:
            raise SourceError(f"topic {self._topic.name}: an image is not newer than the one before it")
        if frame.seq > 0 and frame.size_wh != self.size_wh:
            raise SourceError(f"topic {self._topic.name}: images were {self.size_wh} px, now {frame.size_wh}")

    def _session_ns(self, stamp_ns: int) -> int:
        if self._sim_time is None:
            return stamp_ns
        if not self._sim_time.clock.known:
            raise SourceError(f"topic {self._topic.name}: simulated time is wanted, but nothing came on {CLOCK.name} yet")
        return self._sim_time.clock.real_from_sim(stamp_ns)

    def _nothing_came(self) -> str:
        where, found = (
            f"topic {self._topic.name} of {self.camera}: no image within {self._config.wait_s:g} s",
            self._node.topics(),
        )
        if self.last_refusal:
            return f"{where}; {self.refused_frames} were refused, the last because: {self.last_refusal}"
        other = found.get(self._topic.name, set()) - {self._topic.type_name}
        if other:
            return f"{where}; it carries {choices(sorted(other))}, expected {self._topic.type_name}"
        images = sorted(name for name, types in found.items() if types & {IMAGE_TYPE, COMPRESSED_TYPE})
        return f"{where}; image topics in domain {self._config.domain_id}: {choices(images)}"
