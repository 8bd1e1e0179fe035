"""The detector that the settings name: its networks downloaded before the work begins, built for this machine and rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posefuse.core import ConfigError, ModelError, Progress, silent
from posefuse.foundation.parsing import parse_toml, read_text
from posefuse.foundation.settings import settings

if TYPE_CHECKING:
    from posefuse.core import Detections2D, Detector, Frame, Region, Rig


@settings
class DetectorChoice:
    """Which detector, and its options (see `posefuse plugins`).

    Attributes:
        name: a detector plug-in, e.g. ``blazepose`` or ``onnx``.
        options: settings of that plug-in.
    """

    name: str = "blazepose"
    options: dict[str, Any] = field(default_factory=dict)


def build_detector(choice: DetectorChoice, rig: Rig) -> Detector:
    """Build the detector plug-in; one with an `up_rad` parameter gets the direction of up in each camera's image."""
    from . import up_angle_rad

    check_device(choice)
    return checked_detector(choice, {"up_rad": {camera.name: up_angle_rad(camera) for camera in rig}})


def checked_detector(choice: DetectorChoice, known: dict[str, Any] | None = None) -> Detector:
    """The plug-in, built; where it is of another package, what it does wrong is one line that names it.

    Args:
        known: facts of the session by option name, for a plug-in that has such an option.
    """
    from posefuse.foundation.plugins import build_plugin, is_ours

    detector: Detector = build_plugin("detectors", choice.name, choice.options, known)
    return detector if is_ours(type(detector).__module__) else _Checked(choice.name, detector)


class _Checked:
    """A detector of another package, and how it is called: its faults are not those of posefuse."""

    def __init__(self, name: str, detector: Detector) -> None:
        self._name, self._detector = name, detector

    def __getattr__(self, name: str) -> Any:
        return getattr(self._detector, name)

    def detect(self, frames: Sequence[Frame], regions: Sequence[Sequence[Region] | None]) -> list[Detections2D]:
        """See `core.Detector`; raises ModelError for anything that it raises, and for a rule that its answers break."""
        try:
            found = self._detector.detect(frames, regions)
            rule = broken_rule(self._detector, frames, regions, found)
            broken = rule and f"broken rule: {rule}"
        except Exception as error:  # noqa: BLE001 - others' code may fail in any way
            broken = f"{type(error).__name__}: {error}"
        if broken:
            raise ModelError(f"detector {self._name}: {broken}; `posefuse.evaluation.contracts.check_detector` tests it")
        return found


def broken_rule(
    detector: Detector, frames: Sequence[Frame], regions: Sequence[Sequence[Region] | None], found: Sequence[Detections2D]
) -> str:
    """The first rule of `core.Detector` that answers break; empty where they keep all."""
    import numpy as np

    if len(found) != len(frames):
        return f"one answer per frame ({len(frames)} asked, {len(found)} given)"
    for frame, asked, answer in zip(frames, regions, found, strict=True):
        seen = answer.score > 0
        rules = {
            "answers carry their frame's camera and time": (answer.camera, answer.t_ns) == (frame.camera, frame.t_ns),
            "answers use the detector's skeleton": answer.skeleton == detector.skeleton,
            f"one person per region ({len(asked or ())} asked, {len(answer)} given)": asked is None or len(answer) == len(asked),
            "scores lie in [0, 1]": ((answer.score >= 0) & (answer.score <= 1)).all(),
            "a scored keypoint has coordinates": np.isfinite(answer.xy_img[seen]).all(),
            "a keypoint with score 0 is NaN": np.isnan(answer.xy_img[~seen]).all(),
            "a scored keypoint has sigma_px > 0": (answer.sigma_px[seen] > 0).all(),
        }
        if broken := [rule for rule, holds in rules.items() if not holds]:
            return broken[0]
    return ""


def check_device(choice: DetectorChoice) -> None:
    """Raise ConfigError where a device was chosen for a plug-in without an option `device`."""
    from posefuse.foundation.plugins import list_plugins, option_names

    if "device" not in choice.options:
        return
    for plugin in list_plugins("detectors"):
        if plugin.name == choice.name and plugin.config is not None and "device" not in option_names(plugin):
            raise ConfigError(f"detector {choice.name} ({plugin.package}) takes no device; leave it out")


def network_plugin(network: str) -> tuple[str, dict[str, Any]]:
    """The detector plug-in of a network, and its options that choose it.

    Args:
        network: name of a card, or the TOML file of one of the user's own.

    Raises:
        ConfigError: a file that cannot be read.
    """
    from .card import CARDS_FOLDER, LAYOUTS

    own = network.endswith(".toml")
    path = Path(network).absolute() if own else CARDS_FOLDER / f"{network}.toml"
    # a name that no card has is refused where the detector is built
    kind = parse_toml(network, read_text(path, ConfigError), ConfigError).get("kind") if own or path.is_file() else ""
    return "onnx" if kind in LAYOUTS else "blazepose", {"card" if kind in LAYOUTS else "landmarks": str(path) if own else network}


def with_network(choice: DetectorChoice, network: str) -> DetectorChoice:
    """The detector of a network, on the device and with the other options of `choice`; see `network_plugin`."""
    plugin, named = network_plugin(network)
    kept = {key: value for key, value in choice.options.items() if key not in ("landmarks", "card")}
    return DetectorChoice(name=plugin, options={**kept, **named})


def device_word(device: str | int) -> str:
    """The word of a device; a number is that of a card of NVIDIA."""
    return f"cuda:{device}" if isinstance(device, int) else device


def network_settings(network: str | Path | None, device: str | int | None = None) -> dict[str, str]:
    """A network and its device as settings by dotted key; None: not chosen.

    A network of the default detector leaves it to the user which detector that is.
    """
    plugin, options = network_plugin(str(network)) if network else (DetectorChoice().name, {})
    if device is not None:
        options["device"] = device_word(device)
    chosen = {} if plugin == DetectorChoice().name else {"detector.name": plugin}
    return chosen | {f"detector.options.{key}": value for key, value in options.items()}


def fetch_networks(choice: DetectorChoice, progress: Progress = silent) -> None:
    """Download the networks that the detector needs and does not have.

    Raises:
        ConfigError: options that the detector does not take. ModelError: a network cannot be downloaded.
    """
    from posefuse.foundation.plugins import plugin_config

    check_device(choice)
    config = plugin_config("detectors", choice.name, choice.options)
    if hasattr(config, "fetch"):
        config.fetch(progress)
