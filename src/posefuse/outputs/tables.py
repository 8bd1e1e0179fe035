"""Outputs ``csv`` and ``parquet``: one row per time step, person and keypoint."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from posefuse.core import Kind, Recording, Sink
from posefuse.core.arrays import Array
from posefuse.core.poses import point_sigma_m
from posefuse.foundation.atomic import atomic_file, write_text
from posefuse.foundation.settings import settings

from .facts import provenance, provenance_text

if TYPE_CHECKING:
    import pyarrow as pa


@settings
class CsvSink:
    """``pose.csv``: a header, then rows; missing values are empty.

    The provenance is in ``pose.csv-metadata.json`` next to it (the name of W3C's CSV on the Web), so that spreadsheets and
    pandas read the table as it is.
    """

    name: ClassVar[str] = "csv"

    def build(self) -> Sink:
        """This output, ready."""
        return self

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write ``pose.csv`` and ``pose.csv-metadata.json``; returns the files made."""
        import pyarrow.csv

        path, about = folder / "pose.csv", folder / "pose.csv-metadata.json"
        options = pyarrow.csv.WriteOptions(quoting_style="none", quoting_header="none")
        with atomic_file(path) as staged, staged.open("wb") as file:
            pyarrow.csv.write_csv(table_from_recording(recording), file, options)
        metadata = {"@context": "http://www.w3.org/ns/csvw", "url": path.name, "posefuse": provenance(recording)}
        write_text(about, json.dumps(metadata, indent=2, default=str) + "\n")
        return [path, about]


@settings
class ParquetSink:
    """``pose.parquet``. The provenance is the schema's metadata, key ``posefuse``."""

    name: ClassVar[str] = "parquet"

    def build(self) -> Sink:
        """This output, ready."""
        return self

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write ``pose.parquet``; returns the file made."""
        import pyarrow.parquet

        path = folder / "pose.parquet"
        table = table_from_recording(recording)
        with atomic_file(path) as staged:
            pyarrow.parquet.write_table(table.replace_schema_metadata({"posefuse": provenance_text(recording)}), staged)
        return [path]


def table_from_recording(recording: Recording) -> pa.Table:
    """Columns t_s, person, keypoint, x_m, y_m, z_m, sigma_m, n_views, reproj_px, kind; null where missing.

    World axes, Z up; sigma_m is the standard deviation along one axis; kind is ``fused``, ``smoothed``...
    """
    import pyarrow as pa

    poses = recording.poses
    times, people, keypoints = poses.kind.shape
    columns = {
        "t_s": _numbers(np.repeat(poses.t_ns / 1e9, people * keypoints)),
        "person": _numbers(np.tile(np.repeat(poses.person_id, keypoints), times)),
        "keypoint": _words(poses.skeleton.keypoints, np.tile(np.arange(keypoints), times * people)),
        "x_m": _numbers(poses.xyz_world[..., 0].ravel()),
        "y_m": _numbers(poses.xyz_world[..., 1].ravel()),
        "z_m": _numbers(poses.xyz_world[..., 2].ravel()),
        "sigma_m": _numbers(point_sigma_m(poses.cov_world).ravel()),
        "n_views": _numbers(poses.n_views.ravel()),
        "reproj_px": _numbers(poses.reproj_px.ravel()),
        "kind": _words([kind.name.lower() for kind in Kind], poses.kind.ravel()),
    }
    return pa.Table.from_arrays(list(columns.values()), names=list(columns))


# Columns are made from their buffers (https://arrow.apache.org/docs/format/Columnar.html): `pyarrow.array` and `pyarrow.table`
# import pandas where it is installed, which takes longer than all outputs of a short recording.


def _numbers(values: Array) -> pa.Array:
    """A column of numbers (R,); NaN is null."""
    import pyarrow as pa

    missing = np.isnan(values)
    known = pa.py_buffer(np.packbits(~missing, bitorder="little")) if missing.any() else None
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [known, pa.py_buffer(values)])


def _words(words: Sequence[str], which: Array) -> pa.Array:
    """A column of words (R,), each given by its place in `words`."""
    import pyarrow as pa

    encoded = [word.encode() for word in words]
    ends = np.cumsum(np.array([len(word) for word in encoded])[which])
    begins = pa.py_buffer(np.concatenate([[0], ends]).astype(np.int32))
    text = pa.py_buffer(b"".join([encoded[k] for k in which.tolist()]))
    return pa.Array.from_buffers(pa.string(), len(which), [None, begins, text])
