"""The mark that posefuse puts into every folder it makes, so that it never takes any other folder for its own.

``posefuse-folder.json`` states the command that made the folder and, until it is complete, the name that it is made for.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

from posefuse import __version__

MARK_FILE = "posefuse-folder.json"
_FORMAT = "posefuse folder"


@dataclasses.dataclass(frozen=True, kw_only=True)
class FolderMark:
    """What made a folder.

    Attributes:
        command: such as ``track``. unfinished: the name that it takes once it is complete; empty: it is complete.
    """

    command: str
    unfinished: str = ""


def write_mark(folder: Path, mark: FolderMark) -> None:
    """Write the mark of `folder`, replacing the one that is there; raises OSError where it cannot be written."""
    about = {"format": _FORMAT, "posefuse": __version__, **dataclasses.asdict(mark)}
    new = folder / f"{MARK_FILE}.new"
    try:
        new.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
        new.replace(folder / MARK_FILE)
    finally:
        new.unlink(missing_ok=True)


def read_mark(folder: Path) -> FolderMark | None:
    """The mark of a folder; None where there is none, or where the file of that name is not one of posefuse."""
    try:
        about = json.loads((folder / MARK_FILE).read_text(encoding="utf-8"))
        return FolderMark(command=about["command"], unfinished=about["unfinished"]) if about["format"] == _FORMAT else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
