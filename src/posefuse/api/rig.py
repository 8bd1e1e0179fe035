"""Calibrated cameras that triangulate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from posefuse import core
from posefuse.fusion.settings import Weights

from .arguments import html_table

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

    def _repr_html_(self) -> str:
        rows = [
            (
                one.name,
                "{} x {}".format(*one.size_wh),
                f"{one.K[0, 0]:.0f}",
                ", ".join(f"{value:.2f}" for value in one.centre_world),
            )
            for one in self
        ]
        return html_table(repr(self), ("camera", "px", "focal length px", "place m"), rows)

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


def read_rig(path: str | Path) -> Rig:
    """Read a calibration file: posefuse, Anipose/Pose2Sim or caliscope TOML, Qualisys, OpenCV YAML/JSON, ROS camera_info.

    Raises:
        CalibrationError: no such file, an unknown format, or cameras that cannot be.

    Examples:
        >>> import posefuse as pf
        >>> pf.read_rig("examples/demo/rig.toml")
        Rig(4 cameras: cam00, cam01, cam02, cam03; id ece765de63ef; world set by simulated)
    """
    from posefuse.formats.rig import read_rig as read

    return rig_of(read(Path(path)))


def rig_of(value: core.Rig) -> Rig:
    """The same cameras as the rig of the public interface."""
    return (
        value
        if isinstance(value, Rig)
        else Rig(cameras=value.cameras, world_set_by=value.world_set_by, residual_px=value.residual_px, refused=value.refused)
    )
