"""Output ``mcap``: what a live session would have published in ROS 2, for Foxglove and `ros2 bag play`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from posefuse.core import Detections2D, Pose3D, Recording, Sink
from posefuse.foundation.output_file import atomic_file
from posefuse.foundation.settings import settings

from . import topics
from .bags import Recorder
from .messages import message_from_detections
from .ros_output import RosOutput
from .types import optional_module


@settings
class McapSink:
    """``pose.mcap``: cameras, 2D poses of each view, 3D poses, REP-155 bodies, tf and markers.

    Attributes:
        epoch_offset_ns: Unix time at time 0 of the recording, added to every stamp; None: the start time stated in
            the files; where there is none, 0, or what brings a recording that begins before time 0 there.
    """

    epoch_offset_ns: int | None = None
    name: ClassVar[str] = "mcap"

    def build(self) -> Sink:
        """This output, ready; raises DependencyError without the extra `ros`."""
        optional_module("mcap.writer")
        return self

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write ``pose.mcap``; returns the file made."""
        path, begin_ns, offset_ns = folder / "pose.mcap", int(recording.poses.t_ns[0]), self.epoch_offset_ns
        if offset_ns is None:
            offset_ns = max(recorded_ns(recording.provenance), -begin_ns)
        with atomic_file(path) as staged:
            staged.unlink(missing_ok=True)
            with Recorder(staged) as recorder:
                output = RosOutput(recorder, recording.rig, epoch_offset_ns=offset_ns)
                output.start(begin_ns)
                for i in range(len(recording.poses)):
                    for view in _views(recording, i, offset_ns):
                        recorder.publish(topics.DETECTIONS, message_from_detections(view, {}), view.t_ns)
                    output.step(_present(recording.poses.at(i)))
        return [path]


def recorded_ns(provenance: Mapping[str, Any]) -> int:
    """Unix time at time 0 of a recording: a live session's start, or the date that the camera wrote; 0 where neither is known."""
    if isinstance(start_ns := provenance.get("start_ns"), int):
        return start_ns
    with suppress(ValueError, TypeError):
        return round(datetime.fromisoformat(str(provenance["recorded"])).timestamp() * 1e9) if "recorded" in provenance else 0
    return 0


def _present(pose: Pose3D) -> Pose3D:
    """Only the people with any known keypoint at this time step."""
    here = np.isfinite(pose.xyz_world).all(axis=-1).any(axis=-1)
    return pose.people(np.asarray(here))


def _views(recording: Recording, i: int, epoch_offset_ns: int) -> Iterator[Detections2D]:
    """What each camera saw at time step i, people as fused."""
    for c, camera in enumerate(recording.rig):
        score = recording.views.score[i, :, c]
        here = (score > 0).any(axis=-1)
        xy, score, sigma = recording.views.xy_img[i, here, c], score[here], recording.views.sigma_px[i, here, c]
        seen = np.where((score > 0)[..., None], xy, np.nan)
        box = np.concatenate([np.nanmin(seen, axis=1), np.nanmax(seen, axis=1)], axis=-1) if len(xy) else np.zeros((0, 4))
        t_ns = int(recording.poses.t_ns[i]) + epoch_offset_ns
        yield Detections2D(
            camera=camera.name, t_ns=t_ns, skeleton=recording.poses.skeleton, xy_img=xy, score=score, sigma_px=sigma, box_img=box,
            depth_m=None if recording.views.depth_m is None else recording.views.depth_m[i, here, c],
        )  # fmt: skip
