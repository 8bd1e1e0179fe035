"""Output ``c3d``: keypoint trajectories for biomechanics tools, one file per person."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np

from posefuse.core import InputError, Recording, Sink
from posefuse.core.poses import point_sigma_m
from posefuse.formats.c3d import C3dData, write_c3d
from posefuse.foundation.settings import settings

from .facts import person_file, provenance, provenance_text, rate_hz

# C3D has a rate and no times: time steps this far off it (in periods) would be moved silently
_UNEVEN_PERIODS = 0.05


@settings
class C3dSink:
    """C3D files in millimetres, with standard deviations as residuals and the provenance in the group POSEFUSE."""

    name: ClassVar[str] = "c3d"

    def build(self) -> Sink:
        """This output, ready."""
        return self

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write one file per person; returns the files made. Raises InputError for time steps that are not evenly spaced."""
        poses, made = recording.poses, []
        rate = rate_hz(poses)
        late = (poses.t_ns - poses.t_ns[0]) * 1e-9 * rate - np.arange(len(poses))
        if np.abs(late).max() > max(_UNEVEN_PERIODS, 1e-6 * len(poses)):
            raise InputError(
                f"C3D holds evenly spaced time steps only; these are up to {np.abs(late).max():.2g} periods off {rate:.6g} Hz: "
                "set rate_hz (of a live session: `posefuse solve FILE.mcap` makes even ones), or leave c3d out of the outputs"
            )
        about = {
            "VERSION": str(provenance(recording)["version"]),
            "RIG_ID": recording.rig.id,
            "START_NS": str(poses.t_ns[0]),
            "PROVENANCE": provenance_text(recording),
        }
        for n in range(len(poses.person_id)):
            path = folder / person_file(recording, n, ".c3d")
            write_c3d(
                path,
                C3dData(
                    names=poses.skeleton.keypoints,
                    xyz_world=poses.xyz_world[:, n],
                    sigma_m=point_sigma_m(poses.cov_world[:, n]),
                    rate_hz=rate,
                    about=about,
                    subject=recording.person_names[n],
                ),
            )
            made.append(path)
        return made
