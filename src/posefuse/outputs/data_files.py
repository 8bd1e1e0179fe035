"""Outputs ``trc`` (OpenSim), ``c3d`` (biomechanics tools), both one file per person, and ``csv``, one row per time step,
person and keypoint; and joint angles as a table.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np

from posefuse.core import JointAngles, Kind, Recording
from posefuse.core.arrays import Array
from posefuse.core.poses import evenly_spaced, point_sigma_m
from posefuse.formats.c3d import C3dData, write_c3d
from posefuse.formats.trc import TrcData, write_trc
from posefuse.foundation.output_file import atomic_file
from posefuse.foundation.settings import settings

from .frames import OwnConfig
from .provenance import person_file, rate_hz


@settings
class TrcSink(OwnConfig):
    """TRC files in metres."""

    name: ClassVar[str] = "trc"

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write one file per person; returns the files made."""
        poses, made = recording.poses, []
        for n in range(len(poses.person_id)):
            path = folder / person_file(recording, n, ".trc")
            data = TrcData(
                names=poses.skeleton.keypoints, t_s=poses.t_ns / 1e9, xyz_world=poses.xyz_world[:, n], rate_hz=rate_hz(poses)
            )
            write_trc(path, data)
            made.append(path)
        return made


@settings
class C3dSink(OwnConfig):
    """C3D files in millimetres, with standard deviations as residuals."""

    name: ClassVar[str] = "c3d"

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write one file per person; returns the files made. Raises InputError for time steps that are not evenly spaced."""
        poses, made = evenly_spaced(recording.poses), []
        for n in range(len(poses.person_id)):
            path = folder / person_file(recording, n, ".c3d")
            write_c3d(
                path,
                C3dData(
                    names=poses.skeleton.keypoints,
                    xyz_world=poses.xyz_world[:, n],
                    sigma_m=point_sigma_m(poses.cov_world[:, n]),
                    rate_hz=rate_hz(poses),
                    begin_s=poses.t_ns[0] / 1e9,
                    subject=recording.person_names[n],
                ),
            )
            made.append(path)
        return made


_PART_ROWS = 1000


def write_columns(path: Path, columns: Mapping[str, Iterable[object]]) -> None:
    """Write columns of one length by name; raises InputError when the file cannot be written."""
    with atomic_file(path) as staged, staged.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(columns)
        rows.writerows(zip(*columns.values(), strict=True))


def rounded(values: Array, digits: int, converted: Callable[[Array], Array] = np.asarray) -> Iterator[float | None]:
    """The numbers of an array of any shape, in its order; None where one is NaN. They are made as they are written."""
    for start in range(0, len(values), _PART_ROWS):
        part = converted(values[start : start + _PART_ROWS])
        # zero has no sign
        yield from (None if number != number else number for number in (np.round(part, digits) + 0.0).ravel().tolist())


# Joint angles as one table: a row per time step and person, degrees at this door.

# microseconds; ten thousandths of a degree
_TIME_DIGITS, _CSV_DIGITS = 6, 4


def write_angles(path: Path, joints: JointAngles) -> None:
    """Write CSV: t_s, person, then ``joint.angle_deg`` and ``joint.angle_sigma_deg`` per angle; the unknown is an empty cell."""
    times, people = joints.angle_rad.shape[:2]
    columns: dict[str, Iterable[float | None]] = {
        "t_s": rounded(np.repeat(joints.t_ns / 1e9, people), _TIME_DIGITS),
        "person": itertools.chain.from_iterable(itertools.repeat(joints.person_id.tolist(), times)),
    }
    for q, (joint, names) in enumerate(zip(joints.joints, joints.angle_names, strict=True)):
        for a, angle in enumerate(names):
            columns[f"{joint}.{angle}_deg"] = rounded(joints.angle_rad[:, :, q, a], _CSV_DIGITS, np.degrees)
            columns[f"{joint}.{angle}_sigma_deg"] = rounded(joints.sigma_rad[:, :, q, a], _CSV_DIGITS, np.degrees)
    write_columns(path, columns)


# micrometres, microseconds, thousandths of a pixel
_DIGITS, _PX_DIGITS = 6, 3


@settings
class CsvSink(OwnConfig):
    """``pose.csv``: a header, then rows; missing values are empty.

    Columns t_s, person, keypoint, x_m, y_m, z_m, sigma_m, n_views, reproj_px, kind. World axes, Z up; sigma_m is the standard
    deviation along one axis; kind is ``fused``, ``smoothed``...
    """

    name: ClassVar[str] = "csv"

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write ``pose.csv``; returns the files made."""
        path, poses = folder / "pose.csv", recording.poses
        times, people, keypoints = poses.kind.shape
        columns = {
            "t_s": rounded(np.repeat(poses.t_ns / 1e9, people * keypoints), _DIGITS),
            "person": np.tile(np.repeat(poses.person_id, keypoints), times).tolist(),
            "keypoint": poses.skeleton.keypoints * (times * people),
            **{f"{axis}_m": rounded(poses.xyz_world[..., i], _DIGITS) for i, axis in enumerate("xyz")},
            "sigma_m": rounded(point_sigma_m(poses.cov_world), _DIGITS),
            "n_views": poses.n_views.ravel().tolist(),
            "reproj_px": rounded(poses.reproj_px, _PX_DIGITS),
            "kind": [Kind(kind).name.lower() for kind in poses.kind.ravel().tolist()],
        }
        write_columns(path, columns)
        return [path]
