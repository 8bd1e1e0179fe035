"""Arrays in .npz files: the same arrays give the same bytes, and any damage is one clear error."""

from __future__ import annotations

import lzma
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array, give_away
from posefuse.foundation.output_file import atomic_file
from posefuse.foundation.parsing import one_line

# what zipfile, its decompressors and NumPy's header parser raise on damaged bytes (encrypted: RuntimeError;
# an unknown compression: NotImplementedError; a header that claims more than there is memory: MemoryError)
DAMAGED = (
    OSError, ValueError, EOFError, KeyError, TypeError, SyntaxError, OverflowError, MemoryError, RuntimeError,
    NotImplementedError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error,
    tokenize.TokenError,
)  # fmt: skip
# a deflated zero costs 1 part in 1032; arrays of a recording never come near this
_MOST_EXPANSION = 500
_EXPANSION_MATTERS_BYTES = 1 << 30


def read_arrays(path: Path) -> dict[str, Array]:
    """All arrays of an .npz file, by name.

    Raises:
        InputError: not such a file, damaged, or a small file that claims to hold gigabytes.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file")
    try:
        if not zipfile.is_zipfile(path):
            path.open("rb").close()  # one that may not be read is named as such
            raise InputError(f"{path}: not an .npz file, or its end is missing")
        _check_expansion(path)
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
            give_away(*arrays.values())
            return arrays
    except DAMAGED as error:
        raise InputError(f"{path}: not an .npz file that can be read ({one_line(error)})") from None


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write named arrays as .npz whose bytes depend on nothing but them; raises InputError when that fails."""
    with atomic_file(path) as staged:
        np.savez_compressed(staged, **arrays)


def _check_expansion(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        claimed = sum(entry.file_size for entry in archive.infolist())
    if claimed > max(_EXPANSION_MATTERS_BYTES, _MOST_EXPANSION * path.stat().st_size):
        raise InputError(f"{path}: claims to hold {claimed} bytes in a file of {path.stat().st_size}; it is damaged")
