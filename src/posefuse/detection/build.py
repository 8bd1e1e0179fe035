"""The detector that the settings name: its networks downloaded before the work begins, built for this machine and rig."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posefuse.core import ConfigError, Progress, silent
from posefuse.foundation.parsing import parse_toml, read_text
from posefuse.foundation.settings import settings

if TYPE_CHECKING:
    from posefuse.core import Detector, Rig

# kinds of cards that the default detector reads; all others are networks of the user
_BLAZEPOSE_KINDS = ("heatmap_landmarks", "landmark_ensemble")


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
    from posefuse.foundation.plugins import build_plugin

    from . import up_angle_rad

    known = {"up_rad": {camera.name: up_angle_rad(camera) for camera in rig}}
    detector: Detector = build_plugin("detectors", choice.name, choice.options, known)
    return detector


def network_plugin(network: str) -> tuple[str, dict[str, Any]]:
    """The detector plug-in of a network, and its options that choose it.

    Args:
        network: name of a bundled network, or a TOML file: a card of the user's own, or of BlazePose's layout.

    Raises:
        ConfigError: a card that cannot be read.
    """
    if not network.endswith(".toml"):
        return "blazepose", {"landmarks": network}
    path = Path(network).absolute()
    kind = parse_toml(network, read_text(path, ConfigError), ConfigError).get("kind")
    return ("blazepose", {"landmarks": str(path)}) if kind in _BLAZEPOSE_KINDS else ("onnx", {"card": str(path)})


def network_settings(network: str) -> dict[str, str]:
    """The same as settings by dotted key; a network of the default detector leaves it to the user which detector that is."""
    plugin, options = network_plugin(network)
    chosen = {} if plugin == DetectorChoice().name else {"detector.name": plugin}
    return chosen | {f"detector.options.{key}": value for key, value in options.items()}


STAGE = "downloading networks"


def fetch_networks(choice: DetectorChoice, progress: Progress = silent) -> None:
    """Download the networks that the detector needs and does not have.

    Raises:
        ModelError: a network cannot be downloaded.
    """
    from posefuse.foundation.plugins import plugin_config

    config = plugin_config("detectors", choice.name, choice.options)
    if hasattr(config, "fetch"):
        config.fetch(lambda text: progress(STAGE, 0, None, text), lambda done, total: progress(STAGE, done, total))
