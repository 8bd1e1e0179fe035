"""Edits next to the result that they are about: kept until they are changed, used by the next solve."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

from posefuse.core import InputError
from posefuse.foundation.output_file import write_text
from posefuse.foundation.parsing import parse_json, plain, read_text
from posefuse.foundation.settings import settings_from_mapping

from .edits import NO_EDITS, Edits
from .reading import is_live

EDITS_FILE = "edits.json"
_FORMAT = "posefuse edits"


def edits_path(result: Path) -> Path:
    """Where the edits of a result folder, or of the .mcap of a live session, are kept."""
    return result.with_name(f"{result.stem}.{EDITS_FILE}") if is_live(result) else result / EDITS_FILE


def read_edits(result: Path) -> Edits:
    """The edits kept for a result; empty where there are none.

    Raises:
        InputError: a file of this name that posefuse did not write. ConfigError: a wrong value in it.
    """
    path = edits_path(result)
    return _content(path) if path.is_file() else NO_EDITS


def write_edits(result: Path, edits: Edits) -> Path:
    """Keep the edits of a result in place of the earlier ones; returns the file.

    Raises:
        InputError: it cannot be written, or a file of this name is not one of posefuse.
    """
    path = edits_path(result)
    if path.exists():
        _content(path)  # never written over unless it is ours
    text = json.dumps({"format": _FORMAT, **plain(dataclasses.asdict(edits))}, indent=2, ensure_ascii=False)
    write_text(path, text + "\n")
    return path


def _content(path: Path) -> Edits:
    content = parse_json(str(path), read_text(path))
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise InputError(f"{path}: not edits of posefuse; move it away")
    return settings_from_mapping({key: value for key, value in content.items() if key != "format"}, Edits, where=str(path))
