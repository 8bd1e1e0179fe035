"""What the user wrote after --source, as sources."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from posefuse.core import ConfigError, Rig, SourceError
from posefuse.core.errors import choices
from posefuse.foundation.plugins import from_package, plugin_config, sources_of_others
from posefuse.sources.video import length_s

from .capture import LiveInput

KINDS = ("video", "usb", "rtsp", "http", "ros", "realsense", "sim")
# what all topics of a session share, see `posefuse_ros.dds_domain.NetworkSettings`
ROS_FIELDS = ("domain_id", "interface", "local_only", "peers", "sim_time")
_WITH_DEPTH = "+depth"
EXAMPLES = (
    "cam00=video:cam00.mp4, cam00=usb:/dev/video0 (macOS: usb:0, Windows: usb:NAME), cam00=rtsp://host/stream, "
    "cam00=http://host/stream.mjpg, "
    "cam00=ros:/camera/image_raw, cam00=realsense:SERIAL+depth, sim:SESSION"
)


def inputs_from_arguments(
    sources: Mapping[str, str] | Sequence[str], rig: Rig | None, ros: Mapping[str, Any] | None = None
) -> tuple[LiveInput, ...]:
    """One input per camera named, in the order of the rig; ``sim:PATH`` stands for every camera of the rig.

    Args:
        sources: ``KIND:WHERE`` by camera, or texts ``CAMERA=KIND:WHERE`` and ``sim:PATH``.
        rig: None takes any names, in their own order; ``sim:PATH`` then stands for every camera of the session.
        ros: settings that all ROS topics share: `ROS_FIELDS`.

    Raises:
        SourceError: an argument that cannot be read, a camera the rig does not have, or a camera or source named twice.
        ConfigError: no such field of `ros`, or no such network.
        DependencyError: a source of another package that cannot be used.
    """
    _check_ros(ros or {})
    found: dict[str, LiveInput] = {}
    for argument in [f"{name}={what}" for name, what in sources.items()] if isinstance(sources, Mapping) else sources:
        for entry in _entries(argument, rig, ros or {}):
            if entry.camera in found:
                raise SourceError(f"source {argument}: camera {entry.camera} has a source already")
            if same := [one.camera for one in found.values() if _is_same(one, entry)]:
                raise SourceError(f"source {argument}: camera {same[0]} has the same one; give each camera its own")
            found[entry.camera] = entry
    return tuple(found[name] for name in (found if rig is None else rig.names) if name in found)


def _is_same(one: LiveInput, other: LiveInput) -> bool:
    """Of a session there are all cameras, and a depth camera may be any that is free."""
    if one.kind != other.kind or one.kind in ("sim", "realsense"):
        return False
    return bool(replace(one.config, camera=other.camera) == other.config)


def shown_again(inputs: Sequence[LiveInput], loop_s: float | Literal["shortest"] | None) -> tuple[LiveInput, ...]:
    """The inputs, recorded ones shown again after so long; ``shortest``: as long as the shortest video, None: not.

    Raises:
        SourceError: a video that cannot be read, or a time and nothing that can be shown again.
    """
    if isinstance(loop_s, int | float) and not any(entry.from_zero for entry in inputs):
        raise SourceError(f"`loop_s={loop_s:g}`: no source is a video or a simulated session; leave it out, or add one")
    lengths_s = (length_s(entry.config.path) for entry in inputs if entry.kind == "video")
    turn_s = loop_s if not isinstance(loop_s, str) else min(lengths_s, default=0.0) or None
    return tuple(replace(entry, loop_s=turn_s) for entry in inputs)


def check_any(inputs: Sequence[LiveInput]) -> None:
    """Raise SourceError where no camera has a source."""
    if not inputs:
        raise SourceError("expected a source for at least 1 camera, got none; give `source=CAMERA=KIND:WHERE`")


def check_ros_is_used(ros: Mapping[str, Any], inputs: Sequence[LiveInput], outputs: Mapping[str, object]) -> None:
    """Raise ConfigError where `ros` has settings that no input and no output takes; a recording is in ROS for its time alone."""
    in_ros = [name for name, one in outputs.items() if hasattr(one, "domain_id") and (name != "record" or "sim_time" in ros)]
    if ros and not in_ros and all(entry.kind != "ros" for entry in inputs):
        name, value = next(iter(ros.items()))
        shown = value if isinstance(value, (bool, int, str)) else " ".join(value)
        raise ConfigError(f"`{name}={shown}`: no source and no output is in ROS 2; leave it out, or add one")


def compare_rig(rig: Rig, inputs: Sequence[LiveInput], say: Callable[[str], None]) -> None:
    """Let each kind of source that states intrinsics of its own compare them with the rig's, and report differences.

    A config class of such a source has ``compare_rig(rig, inputs, say)``.
    """
    for kind in dict.fromkeys(type(entry.config) for entry in inputs):
        if hasattr(kind, "compare_rig"):
            kind.compare_rig(rig, [entry for entry in inputs if type(entry.config) is kind], say)


def _check_ros(ros: Mapping[str, Any]) -> None:
    if unknown := sorted(set(ros) - set(ROS_FIELDS)):
        raise ConfigError(f"ros: expected {choices(ROS_FIELDS)}, got {choices(unknown)}")
    if isinstance(ros.get("peers"), str):
        raise ConfigError(f"ros: peers: expected a list of addresses, got {ros['peers']!r}")


def _entries(argument: str, rig: Rig | None, ros: Mapping[str, Any]) -> list[LiveInput]:
    named = re.fullmatch(r"([^=:/\\]+)=(.+)", argument)
    camera, what = (named[1], named[2]) if named else (None, argument)
    if rig is not None and camera is not None and camera not in rig.names:
        raise SourceError(f"source {argument}: no camera {camera!r} in the rig; there are: {choices(rig.names)}")
    kind, colon, rest = what.partition(":")
    if kind == "sim" and colon and rest:
        config, path = _simulated_config(), Path(rest)
        names = [camera] if camera else config.cameras(path) if rig is None else rig.names
        return [LiveInput(name, kind, config(path, name), reopen=False) for name in names]
    if camera is None:
        raise SourceError(f"source {argument}: expected CAMERA=KIND:WHERE; e.g. {EXAMPLES}")
    if kind == "realsense" and rest:
        return [_depth_camera(argument, camera, rig, rest)]
    if kind.lower() == "ros" and rest:
        return [_ros_topic(camera, rest, rig, ros)]
    return [_camera_input(argument, camera, kind.lower(), what, rest)]


def _simulated_config() -> type[Any]:
    """The plug-in of the simulator; raises DependencyError without the extra `sim`."""
    found: type[Any] = from_package("sources", "simulated", extra="sim")
    return found


def _depth_camera(argument: str, camera: str, rig: Rig | None, rest: str) -> LiveInput:
    """``SERIAL[@WIDTHxHEIGHT[@RATE]][+depth]``; the calibrated size where none is given."""
    from posefuse.sources.live import RealSenseConfig

    serial, _, size = rest.removesuffix(_WITH_DEPTH).partition("@")
    if not size and rig is None:
        raise SourceError(f"source {argument}: expected a size, e.g. {camera}=realsense:{serial}@1280x720@30")
    size = size or "{}x{}".format(*rig[camera].size_wh)  # type: ignore[index]
    config = RealSenseConfig(camera, serial, size, depth=rest.endswith(_WITH_DEPTH))
    return LiveInput(camera, "realsense", config, reopen=True)


def _ros_topic(camera: str, topic: str, rig: Rig | None, ros: Mapping[str, Any]) -> LiveInput:
    lens = rig[camera] if rig is not None else None
    config = from_package("sources", "ros", extra="ros")(topic=topic, camera=camera, lens=lens, **ros)
    return LiveInput(camera, "ros", config, reopen=True)


def _camera_input(argument: str, camera: str, kind: str, what: str, rest: str) -> LiveInput:
    from posefuse.sources.live import PacedVideoConfig, StreamConfig

    if what.startswith("/dev/"):
        kind, rest = "usb", what
    if kind == "video" and rest:
        return LiveInput(camera, kind, PacedVideoConfig(Path(rest), camera), reopen=False)
    if kind in ("rtsp", "rtsps", "http", "https"):
        return LiveInput(camera, kind, StreamConfig(where=what, camera=camera), reopen=True)
    if kind == "usb" and rest:
        device, _, size = rest.partition("@")
        return LiveInput(camera, kind, StreamConfig(where=device, camera=camera, size=size), reopen=True)
    others, name = sources_of_others(), what.partition(":")[0]
    if name in others and rest:
        return LiveInput(camera, name, plugin_config("sources", name, {"camera": camera, "where": rest}), reopen=True)
    if kind in (*KINDS, *others):
        raise SourceError(f"source {argument}: expected where it is after {kind}:; e.g. {EXAMPLES}")
    raise SourceError(f"source {argument}: kind {kind!r} is not known; there are: {choices((*KINDS, *others))}; e.g. {EXAMPLES}")
