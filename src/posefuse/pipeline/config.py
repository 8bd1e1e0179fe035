"""What a user may set for a recording; each default exists once, here or in the room it belongs to."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, field
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeVar

from annotated_types import Ge, Gt, Le, Lt

from posefuse.association.settings import AssociateSettings, PeopleNames
from posefuse.core import ConfigError
from posefuse.detection.build import DetectorChoice
from posefuse.foundation.settings import read_mapping, settings, settings_from_mapping
from posefuse.fusion.settings import FuseSettings
from posefuse.kinematics.settings import BodySettings
from posefuse.tracking.settings import SmoothSettings

T = TypeVar("T")
CONFIG_FILE = "posefuse.toml"
# times and offsets are int64 nanoseconds: a hundred years leave room for sums
FARTHEST_S = 3.2e9
# a clock 10 % off is no camera's
MOST_DRIFT_PPM = 100_000.0
# people move too much in between for linear interpolation
MOST_GAP_S = 1.0
# a frame per quarter of an hour, and ten times the fastest camera of a laboratory
LEAST_HZ, MOST_HZ = 0.001, 10_000.0
DEFAULT_OUTPUTS = ("trc", "c3d", "csv", "overlay", "overview")


def options_by_name(outputs: Any) -> Any:
    """Names of outputs as a table with no options of theirs; anything else as it is."""
    named = isinstance(outputs, list | tuple) and all(isinstance(name, str) for name in outputs)
    return {name: {} for name in outputs} if named else outputs


class _ByName:
    """For pydantic, which takes long to import and is not needed to show the help."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        from pydantic_core import core_schema

        def by_name(outputs: Any) -> Any:
            if isinstance(outputs, str):
                raise ValueError('expected names, such as ["trc", "csv"], or a table of them')
            return options_by_name(outputs)

        return core_schema.no_info_before_validator_function(by_name, handler(source))


Outputs = Annotated[dict[str, dict[str, Any]], _ByName()]


@settings
class CameraInput:
    """What is known of one camera's data beyond its calibration. Paths are relative to the session.

    Attributes:
        video, images, pose2d: the file or folder (one of the three); found by name when left out.
        offset_s: added to its times; positive when it started later than the others.
        drift_ppm: added per million of its times; positive when its clock runs slow.
        crop: (left, top) px: the video is a crop of the calibrated image that starts there.
        scale: the video is the calibrated image, resampled to another size.
        skip: do not use this camera.
        depth: folder of its depth images (see docs/depth.md); ``depth/<camera>`` where that exists.
    """

    video: str | None = None
    images: str | None = None
    pose2d: str | None = None
    offset_s: Annotated[float, Ge(-FARTHEST_S), Le(FARTHEST_S)] = 0.0
    drift_ppm: Annotated[float, Gt(-MOST_DRIFT_PPM), Lt(MOST_DRIFT_PPM)] = 0.0
    crop: tuple[float, float] | None = None
    scale: bool = False
    skip: bool = False
    depth: str | None = None


@settings
class TrackConfig:
    """All settings of `posefuse track`.

    Attributes:
        rig: calibration file, relative to the session; found by name when left out.
        input: which data of the session to use: ``videos``, ``images``, ``pose2d`` (files of other tools, see
            docs/networks.md), or ``auto``: the first of these that exists.
        cameras: settings of single cameras by name, see `CameraInput`.
        start_s, end_s: begin and end of the part of the recording to work on, in session seconds.
        rate_hz: output rate; the rate of the cameras when left out. Also the frame rate of image folders and 2D poses that do
            not state theirs.
        keypoints: order of the keypoints in files of 2D poses, e.g. ``body_25b``; recognised from all cameras when left out.
        detector: which detector finds keypoints in images.
        associate: how detections are assigned to people.
        fuse: how views are fused.
        smooth: how a recording is smoothed.
        names: names of the people in the order of their ids; for videos, reports and file names. The others are person 0, 1 and
            so on.
        joint_centres: move keypoints to anatomical joint centres, if the detector has a table for it.
        body: fit one skeleton of constant segment lengths per person to the rays of all views. ``auto`` does so for people of
            whom a limb was out of sight for a part of the recording, if a table of joint centres was fitted to the detector,
            the weights are ``robust`` and the result is smoothed; ``on`` for everybody.
        whole_body: how that skeleton may move.
        live_gap_s: second solve of a live session, in which not every frame was used: interpolate between two frames of a
            camera that are at most this far apart. docs/recordings.md has the errors of other values.
        raw: keep every time step as it was fused: no smoothing, no filled gaps.
        outputs: names of outputs, or a table of them, each with its options; see `posefuse plugins`.
    """

    rig: str | None = None
    input: Literal["auto", "videos", "images", "pose2d"] = "auto"
    cameras: dict[str, CameraInput] = field(default_factory=dict)
    start_s: Annotated[float, Ge(-FARTHEST_S), Le(FARTHEST_S)] | None = None
    end_s: Annotated[float, Ge(-FARTHEST_S), Le(FARTHEST_S)] | None = None
    rate_hz: Annotated[float, Ge(LEAST_HZ), Le(MOST_HZ)] | None = None
    keypoints: str = ""
    detector: DetectorChoice = field(default_factory=DetectorChoice)
    associate: AssociateSettings = field(default_factory=AssociateSettings)
    fuse: FuseSettings = field(default_factory=FuseSettings)
    smooth: SmoothSettings = field(default_factory=SmoothSettings)
    names: PeopleNames = ()
    joint_centres: bool = True
    body: Literal["auto", "on", "off"] = "auto"
    whole_body: BodySettings = field(default_factory=BodySettings)
    live_gap_s: Annotated[float, Ge(0), Le(MOST_GAP_S)] = 0.2
    raw: bool = False
    outputs: Outputs = field(default_factory=lambda: options_by_name(DEFAULT_OUTPUTS))


def read_config(
    path: Path | None, changes: Mapping[str, Any] = MappingProxyType({}), base: Mapping[str, Any] = MappingProxyType({})
) -> TrackConfig:
    """The settings of `posefuse track`, see `read_changed`."""
    return read_changed(path, changes, TrackConfig, {"outputs": DEFAULT_OUTPUTS, **base})


def read_changed(
    path: Path | None, changes: Mapping[str, Any], cls: type[T], base: Mapping[str, Any] = MappingProxyType({})
) -> T:
    """The config file (if any) as settings of class `cls`, with other values on top.

    Args:
        path: TOML or YAML. changes: values by dotted key, in the order in which they are applied: ``outputs`` names the outputs,
            ``outputs.NAME.KEY`` after it gives one of them an option.
        cls: the settings class all of it is validated as.
        base: plain values that everything else is put on top of; a group of the file replaces the group here.

    Raises:
        ConfigError: an unknown key or a wrong value; names the key and what is allowed.
    """
    content: dict[str, Any] = copy.deepcopy(dict(base)) | (_read_file(path) if path else {})
    return settings_from_mapping(_changed(content, changes), cls, where=str(path) if path else "settings")


def changed_config(config: T, changes: Mapping[str, Any]) -> T:
    """The settings with other values by dotted key, e.g. ``{"fuse.weights": "score"}``, validated like a settings file.

    Raises:
        ConfigError: an unknown key or a wrong value.
    """
    return settings_from_mapping(_changed(asdict(config), changes), type(config), where="settings")  # type: ignore[call-overload]


def changes_of(texts: Iterable[str]) -> dict[str, Any]:
    """``KEY=VALUE`` texts as values by dotted key; values are TOML, bare words are strings.

    Raises:
        ConfigError: a text without ``=``.
    """
    found: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise ConfigError(f"--set {text}: expected KEY=VALUE, e.g. --set fuse.weights=score")
        try:
            found[key] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            found[key] = value
    return found


def settings_by_key(path: Path | None) -> dict[str, Any]:
    """A settings file as plain values by dotted key, for `changed_config`; raises ConfigError for one that cannot be read."""
    return dict(_leaves(_read_file(path), "")) if path else {}


def _read_file(path: Path) -> dict[str, Any]:
    """A settings file; model cards that it names are relative to it."""
    content = read_mapping(path)
    detector = content.get("detector")
    options = detector.get("options") if isinstance(detector, Mapping) else None
    if isinstance(options, dict):
        cards = {key: value for key, value in options.items() if isinstance(value, str) and value.endswith(".toml")}
        options.update({key: str(path.parent.absolute() / card) for key, card in cards.items()})
    return content


def _leaves(content: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _changed(content: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    for dotted, value in changes.items():
        _put(content, dotted.split("."), value)
    return content


def _put(content: dict[str, Any], keys: Sequence[str], value: Any) -> None:
    for key in keys[:-1]:
        inner = content[key] = options_by_name(content.get(key, {}))
        if not isinstance(inner, dict):
            raise ConfigError(f"{'.'.join(keys)}: {key} is a value, not a group")
        content = inner
    before, named = content.get(keys[-1]), options_by_name(value)
    if isinstance(before, Mapping) and named is not value:
        # outputs by name keep the options that a file gives them
        value = {name: before.get(name, {}) for name in named}
    content[keys[-1]] = value
