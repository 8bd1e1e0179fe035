"""Calibrated cameras that triangulate, and detectors that take images as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posefuse import core
from posefuse.core import Detections2D, Detector, Frame, Region, Skeleton
from posefuse.core.arrays import Array
from posefuse.fusion.settings import Weights

if TYPE_CHECKING:
    from posefuse.fusion import Triangulated


class Rig(core.Rig):
    """Several calibrated cameras in one world frame; all of `core.Rig`, and what one does with it.

    Examples:
        >>> import numpy as np, posefuse as pf
        >>> rig = pf.read_rig("examples/demo/rig.toml")
        >>> xy_img = rig.project(np.array([[0.1, -0.2, 1.0]]))
        >>> xyz, cov, reproj = rig.triangulate(xy_img)
        >>> xyz.round(3).tolist()
        [[0.1, -0.2, 1.0]]
    """

    def triangulate(
        self, xy_img: Any, score: Any = None, sigma_px: Any = None, *, weights: Weights | None = None, depth_m: Any = None
    ) -> Triangulated:
        """Triangulate raw pixels (..., C, K, 2) to points (..., K, 3) in metres, with covariance; see `posefuse.triangulate`."""
        from posefuse.fusion import triangulate

        return triangulate(self, xy_img, score, sigma_px, weights, depth_m=depth_m)

    def save(self, path: str | Path) -> Path:
        """Write the cameras as a rig file (TOML); returns its path. An existing file is not replaced.

        Raises:
            InputError: there is a file already, or it cannot be written.
        """
        from posefuse.formats.rig import write_rig
        from posefuse.foundation.output_file import check_output_file

        target = Path(path)
        check_output_file(target, option="path")
        write_rig(target, self)
        return target


def read_rig(path: str | Path, *, placed: bool = False) -> Rig:
    """Read a calibration file: posefuse, Anipose/Pose2Sim or caliscope TOML, Qualisys.

    Args:
        placed: the poses of the cameras are needed, too; False: intrinsics will do.

    Raises:
        CalibrationError: no such file, an unknown format, or cameras that cannot be.

    Examples:
        >>> import posefuse as pf
        >>> pf.read_rig("examples/demo/rig.toml")
        Rig(4 cameras: cam00, cam01, cam02, cam03; id ece765de63ef; world set by simulated)
    """
    from posefuse.formats import rig as files

    return rig_of(files.read_placed_rig(path) if placed else files.read_rig(path))


def rig_of(rig: core.Rig | str | Path, *, placed: bool = False) -> Rig:
    """The same cameras as the rig of the public interface; of a file as `read_rig` reads it."""
    if not isinstance(rig, core.Rig):
        return read_rig(rig, placed=placed)
    return rig if isinstance(rig, Rig) else Rig(**{field.name: getattr(rig, field.name) for field in fields(core.Rig)})


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
    name: str | Path = "blazepose_full", options: Mapping[str, Any] | None = None, device: str | int | None = None
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
    from posefuse.detection.build import DetectorChoice, checked_detector, device_word, fetch_networks, network_plugin
    from posefuse.foundation.plugins import list_plugins

    names = {plugin.name for plugin in list_plugins("detectors")}
    plugin, chosen = (str(name), {}) if name in names else network_plugin(str(name))
    chosen |= {} if device is None else {"device": device_word(device)}
    chosen |= options or {}
    choice = DetectorChoice(name=plugin, options=chosen)
    fetch_networks(choice)
    return ImageDetector(checked_detector(choice))
