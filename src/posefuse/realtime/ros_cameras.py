"""Cameras whose images come from ROS: their drivers' `CameraInfo` is compared with the rig, or taken for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from posefuse.core import Camera, MessageError, Rig, SourceError

from .capture import LiveInput
from .config import CameraInfoUse

_WITHIN_S = 2.0
# a lens that was calibrated twice agrees with itself to about this, anywhere in the image
AGREE_PX = 3.0


def rig_with_camera_infos(rig: Rig, inputs: Sequence[LiveInput], use: CameraInfoUse, say: Callable[[str], None]) -> Rig:
    """The rig to work with: with intrinsics of `CameraInfo` where `use` is ``use``, else unchanged, and differences are reported.

    Cameras without a ROS topic stay as they are.

    Raises:
        SourceError: images of another size than the rig's, or ``use`` where no calibration comes.
    """
    from posefuse.sources.ros import RosConfig
    from posefuse.sources.ros_camera_info import camera_of_info, info_topic, read_camera_infos

    configs = {entry.camera: entry.config for entry in inputs if isinstance(entry.config, RosConfig)}
    if not configs or use == "ignore":
        return rig
    first = next(iter(configs.values()))
    infos = read_camera_infos([config.topic for config in configs.values()], first.network, _WITHIN_S)
    found: dict[str, Camera] = {}
    for name, config in configs.items():
        topic, msg = info_topic(config.topic), infos.get(config.topic)
        try:
            camera = camera_of_info(rig[name], msg) if msg is not None else None
        except MessageError as error:
            raise SourceError(f"{topic}: {error}; `camera_info=ignore` continues without it") from None
        problem = _problem(rig[name], camera, silent=msg is None)
        if use == "use" and camera is None:
            raise SourceError(f"camera {name}: its intrinsics are wanted from {topic}, but {problem}")
        if use == "check" and problem:
            say(f"camera {name}: {topic}: {problem}")
        if camera is not None:
            found[name] = camera
    if use == "check":
        return rig
    say(f"intrinsics of {', '.join(found)} are those of their CameraInfo")
    return replace(rig, cameras=tuple(found.get(camera.name, camera) for camera in rig))


def _problem(ours: Camera, theirs: Camera | None, *, silent: bool) -> str:
    """What keeps a `CameraInfo` from confirming the rig's intrinsics; empty when it does."""
    from posefuse.sources.ros_camera_info import apart_px

    if silent:
        return f"nothing came within {_WITHIN_S:g} s; the rig's intrinsics are not checked"
    if theirs is None:
        return "it holds no calibration (K is 0); the rig's intrinsics are not checked"
    apart = apart_px(ours, theirs)
    if apart <= AGREE_PX:
        return ""
    return (
        f"it differs from the rig by up to {apart:.1f} px (focal length {theirs.K[0, 0]:.1f} px, rig {ours.K[0, 0]:.1f} px); "
        "the rig's is used, `camera_info=use` takes this one"
    )
