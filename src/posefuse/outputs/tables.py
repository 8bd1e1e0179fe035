"""Output ``csv``: one row per time step, person and keypoint."""

from __future__ import annotations

import json
from pathlib import Path
from typing import ClassVar

import numpy as np

from posefuse.core import Kind, Recording, Sink
from posefuse.core.poses import point_sigma_m
from posefuse.formats.csv_table import rounded, write_columns
from posefuse.foundation.output_file import write_text
from posefuse.foundation.settings import settings

from .facts import provenance

# micrometres, microseconds, thousandths of a pixel
_DIGITS, _PX_DIGITS = 6, 3


@settings
class CsvSink:
    """``pose.csv``: a header, then rows; missing values are empty.

    Columns t_s, person, keypoint, x_m, y_m, z_m, sigma_m, n_views, reproj_px, kind. World axes, Z up; sigma_m is the standard
    deviation along one axis; kind is ``fused``, ``smoothed``... The provenance is in ``pose.csv-metadata.json`` next to it (the
    name of W3C's CSV on the Web), so that spreadsheets and pandas read the table as it is.
    """

    name: ClassVar[str] = "csv"

    def build(self) -> Sink:
        """This output, ready."""
        return self

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write ``pose.csv`` and ``pose.csv-metadata.json``; returns the files made."""
        path, about = folder / "pose.csv", folder / "pose.csv-metadata.json"
        poses = recording.poses
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
        metadata = {"@context": "http://www.w3.org/ns/csvw", "url": path.name, "posefuse": provenance(recording)}
        write_text(about, json.dumps(metadata, indent=2, default=str) + "\n")
        return [path, about]
