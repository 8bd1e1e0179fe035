"""The list of files that posefuse wrote into a folder, so that it never removes any other.

``posefuse-files.json`` in every output folder: per file its path, size and SHA-256, which command wrote them and where to, and
whether the folder is complete. A file counts as written by posefuse only while its content is the one in the list.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from posefuse import __version__

MANIFEST_FILE = "posefuse-files.json"
_FORMAT = "posefuse files"
_FORMAT_VERSION = 1
_BLOCK_BYTES = 1 << 20
# what Finder and Explorer leave in every folder they show: neither a result nor a file of a person
DESKTOP_FILES = (".DS_Store", "Thumbs.db", "desktop.ini")
_UNFINISHED, _COMPLETE = "unfinished", "complete"


@dataclass(frozen=True, kw_only=True)
class WrittenFile:
    """One file: path relative to the folder with forward slashes, size in bytes, SHA-256 as hexadecimal text."""

    path: str
    size: int
    sha256: str


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """What posefuse wrote into a folder.

    Attributes:
        command: the command that wrote it, such as ``track``. target: absolute path an unfinished folder is made for.
        of_parent: made from the result in the folder it lies in, and replaced together with that.
        complete: False while the command works. files: every file but the manifest.
        folders: every folder below, relative with forward slashes.
    """

    command: str
    target: str
    of_parent: bool = False
    complete: bool = False
    files: tuple[WrittenFile, ...] = ()
    folders: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Contents:
    """What a folder holds, as paths relative to it.

    Attributes:
        written: files of posefuse, manifests included, with the content they were written with. folders: folders of posefuse.
        desktop: files that the desktop of a system put there, see `DESKTOP_FILES`.
        foreign: everything else: files not in a manifest, changed since, or links; folders not in a manifest.
    """

    written: tuple[Path, ...]
    folders: tuple[Path, ...]
    desktop: tuple[Path, ...]
    foreign: tuple[Path, ...]


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write the manifest into `folder`, replacing the one that is there; raises OSError where that cannot be written."""
    about = {"format": _FORMAT, "format_version": _FORMAT_VERSION, "posefuse": __version__, **dataclasses.asdict(manifest)}
    about["status"] = _COMPLETE if about.pop("complete") else _UNFINISHED
    new = folder / f"{MANIFEST_FILE}.new"
    try:
        new.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
        new.replace(folder / MANIFEST_FILE)
    finally:
        new.unlink(missing_ok=True)


def read_manifest(folder: Path) -> Manifest | None:
    """The manifest of a folder; None where there is none, or where the file of that name is not one of posefuse."""
    try:
        about = json.loads((folder / MANIFEST_FILE).read_text(encoding="utf-8"))
        return _manifest(about)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _manifest(about: Any) -> Manifest | None:
    if not isinstance(about, dict) or (about.get("format"), about.get("format_version")) != (_FORMAT, _FORMAT_VERSION):
        return None
    files = tuple(WrittenFile(path=str(f["path"]), size=int(f["size"]), sha256=str(f["sha256"])) for f in about["files"])
    return Manifest(
        command=str(about["command"]),
        target=str(about["target"]),
        of_parent=about["of_parent"] is True,
        complete=about["status"] == _COMPLETE,
        files=files,
        folders=tuple(str(name) for name in about["folders"]),
    )


def completed(folder: Path, manifest: Manifest) -> Manifest:
    """The manifest with everything but desktop files that is in `folder` now; raises OSError where a file cannot be read."""
    entries = [entry for entry in _entries(folder) if entry.name not in DESKTOP_FILES]
    folders = [entry.relative_to(folder).as_posix() for entry in entries if entry.is_dir()]
    found = manifest_of_files(folder, manifest, [entry for entry in entries if not entry.is_dir()])
    return dataclasses.replace(found, folders=tuple(folders))


def manifest_of_files(folder: Path, manifest: Manifest, paths: Iterable[Path]) -> Manifest:
    """The manifest, complete, with these files below `folder` and the folders they are in.

    The target is the folder itself then, so that it can be moved and the same work gives the same bytes everywhere.

    Raises:
        OSError: a file cannot be read.
    """
    files = [written_file(folder, path) for path in sorted(paths) if path != folder / MANIFEST_FILE]
    parents = {parent.as_posix() for one in files for parent in Path(one.path).parents if parent.parts}
    return dataclasses.replace(manifest, target=".", complete=True, files=tuple(files), folders=tuple(sorted(parents)))


def list_file(folder: Path, path: Path) -> None:
    """Add a file that posefuse wrote later, or wrote again, to the list of a complete folder; no list, nothing to do.

    Raises:
        OSError: the file cannot be read, or the list not be written.
    """
    manifest = read_manifest(folder)
    if manifest is None or not manifest.complete:
        return
    new = written_file(folder, path)
    others = (one for one in manifest.files if one.path != new.path)
    files = tuple(sorted((*others, new), key=lambda one: one.path))
    write_manifest(folder, dataclasses.replace(manifest, files=files))


def written_file(folder: Path, path: Path) -> WrittenFile:
    """Size and hash of the file `path` below `folder`."""
    return WrittenFile(path=path.relative_to(folder).as_posix(), size=path.stat().st_size, sha256=_sha256(path))


def contents(folder: Path) -> Contents:
    """Separate files that posefuse wrote into `folder` from others, subfolders with their own manifest included.

    Raises:
        OSError: a folder that cannot be listed.
    """
    entries = _entries(folder)
    known: dict[str, WrittenFile] = {}
    own_folders: set[str] = set()
    _add_listed(folder, Path(), known, own_folders)
    for entry in entries:
        if entry.is_dir() and not entry.is_symlink():
            _add_listed(entry, entry.relative_to(folder), known, own_folders)
    written: list[Path] = []
    folders: list[Path] = []
    desktop: list[Path] = []
    foreign: list[Path] = []
    for entry in entries:
        relative = entry.relative_to(folder)
        name = relative.as_posix()
        if entry.is_symlink():
            foreign.append(relative)
        elif entry.is_dir():
            (folders if name in own_folders else foreign).append(relative)
        elif name in known:
            (written if _is_unchanged(entry, known[name]) else foreign).append(relative)
        elif entry.name in DESKTOP_FILES:
            desktop.append(relative)
        else:
            is_list = entry.name == MANIFEST_FILE and relative.parent.as_posix() in own_folders
            (written if is_list else foreign).append(relative)
    return Contents(written=tuple(written), folders=tuple(folders), desktop=tuple(desktop), foreign=tuple(foreign))


def remove_written(folder: Path) -> bool:
    """Remove the files and folders of posefuse in `folder`, and `folder` when nothing else is in it; True when it is gone."""
    found = contents(folder)
    manifests = [path for path in found.written if path.name == MANIFEST_FILE]
    # the lists go last: an interruption before that leaves it known what is posefuse's
    for path in [*(path for path in found.written if path.name != MANIFEST_FILE), *manifests]:
        (folder / path).unlink()
    for path in sorted(found.folders, key=lambda path: len(path.parts), reverse=True):
        if not any((folder / path).iterdir()):
            (folder / path).rmdir()
    if any(folder.iterdir()):
        return False
    folder.rmdir()
    return True


def _entries(folder: Path) -> list[Path]:
    """Everything below `folder`; links are entries and are not followed."""
    entries: list[Path] = []
    for root, folders, files in os.walk(folder, onerror=_raise):
        entries += [Path(root, name) for name in (*folders, *files)]
    return sorted(entries)


def _raise(error: OSError) -> None:
    raise error


def _add_listed(folder: Path, relative: Path, known: dict[str, WrittenFile], folders: set[str]) -> None:
    """Add what the complete manifest of `folder` lists, by path relative to the outermost folder."""
    manifest = read_manifest(folder)
    if manifest is None or not manifest.complete or (relative.parts and not manifest.of_parent):
        return
    folders.update((relative / name).as_posix() for name in (".", *manifest.folders))
    known.update({(relative / one.path).as_posix(): one for one in manifest.files})


def _is_unchanged(path: Path, written: WrittenFile) -> bool:
    try:
        return path.is_file() and path.stat().st_size == written.size and _sha256(path) == written.sha256
    except OSError:
        return False


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()
