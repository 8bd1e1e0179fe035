"""2D keypoints in images: `posefuse.detector`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from posefuse.core import Detections2D, Detector, Frame, Region, Skeleton
from posefuse.core.arrays import Array


class ImageDetector:
    """A detector that takes images as arrays; made by `detector`.

    Attributes:
        skeleton: names of the keypoints.
    """

    def __init__(self, detector: Detector) -> None:
        self._detector = detector
        self.skeleton: Skeleton = detector.skeleton

    def __repr__(self) -> str:
        return f"ImageDetector({type(self._detector).__name__}, {self.skeleton.name}, {len(self.skeleton)} keypoints)"

    def __call__(self, images: Sequence[Array], regions: Sequence[Sequence[Region] | None] | None = None) -> list[Detections2D]:
        """Find people in images (H, W, 3) uint8 RGB; one `Detections2D` per image, in order.

        Args:
            images: of any sizes. regions: per image where people are (one each), or None: search the whole image.

        Raises:
            ShapeError: an image that is not RGB uint8, or another number of regions than of images.
        """
        frames = [Frame(camera=f"image {i}", seq=i, t_ns=i, received_ns=i, image=image) for i, image in enumerate(images)]
        return self._detector.detect(frames, [None] * len(frames) if regions is None else regions)


def detector(
    name: str = "blazepose_full", options: Mapping[str, Any] | None = None, device: str | int | None = None
) -> ImageDetector:
    """The detector of a name: a network (see docs/networks.md) or a plug-in (`posefuse plugins`).

    Args:
        name: e.g. ``blazepose_full``, ``blazepose_lite``, a model card of your own (TOML), or a plug-in's name.
        options: of the plug-in, by name.
        device: processor, e.g. ``cpu`` or ``cuda:1``, or the number of a card of NVIDIA.

    Raises:
        ConfigError: no such plug-in or network, or options it does not take.
        ModelError: its files cannot be had.

    Examples:
        >>> import numpy as np, posefuse as pf
        >>> detect = pf.detector("blazepose_full")  # doctest: +SKIP
        >>> [found] = detect([np.zeros((480, 640, 3), np.uint8)])  # doctest: +SKIP
        >>> len(found)  # no person there  # doctest: +SKIP
        0
    """
    from posefuse.detection.build import DetectorChoice, device_word, fetch_networks, network_plugin
    from posefuse.foundation.plugins import build_plugin, list_plugins

    names = {plugin.name for plugin in list_plugins("detectors")}
    plugin, chosen = (name, {}) if name in names else network_plugin(name)
    chosen |= {} if device is None else {"device": device_word(device)}
    chosen |= options or {}
    fetch_networks(DetectorChoice(name=plugin, options=chosen))
    return ImageDetector(build_plugin("detectors", plugin, chosen))
