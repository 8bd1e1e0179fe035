"""Output ``trc``: keypoint trajectories for OpenSim, one file per person."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from posefuse.core import Recording, Sink
from posefuse.formats.trc import TrcData, write_trc
from posefuse.foundation.settings import settings

from .facts import person_file, rate_hz


@settings
class TrcSink:
    """TRC files. The format has no place for provenance: it is in ``recording.json`` of the same folder.

    Attributes:
        units: ``m`` or ``mm``.
    """

    units: Literal["m", "mm"] = "m"
    name: ClassVar[str] = "trc"

    def build(self) -> Sink:
        """This output, ready."""
        return self

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write one file per person; returns the files made."""
        poses, made = recording.poses, []
        for n in range(len(poses.person_id)):
            path = folder / person_file(recording, n, ".trc")
            data = TrcData(
                names=poses.skeleton.keypoints, t_s=poses.t_ns / 1e9, xyz_world=poses.xyz_world[:, n], rate_hz=rate_hz(poses)
            )
            write_trc(path, data, self.units)
            made.append(path)
        return made
