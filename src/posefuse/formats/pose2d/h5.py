"""HDF5 files, where the extra for them is installed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from posefuse.core import DependencyError, InputError

H5_SUFFIXES = (".h5", ".hdf5")


def opened(path: Path) -> Any:
    """The file, to read from; raises DependencyError without the extra, InputError for what is no HDF5 file."""
    try:
        import h5py  # type: ignore[import-untyped]
    except ImportError:
        raise DependencyError(f"{path}: reading HDF5 needs the package h5py: pip install 'posefuse[h5]'") from None
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise InputError(f"{path}: not a readable HDF5 file ({str(error).splitlines()[0]})") from None
