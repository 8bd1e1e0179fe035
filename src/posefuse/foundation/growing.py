"""A folder that commands add files to over days: only unchanged files that posefuse wrote are replaced."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path

from posefuse.core import InputError

from .manifest import MANIFEST_FILE, Manifest, contents, manifest_of_files, read_manifest, write_manifest
from .places import real_path


@dataclasses.dataclass(frozen=True)
class GrowingFolder:
    """A folder of results that stays where it is; see `growing_folder`."""

    folder: Path
    command: str

    def check(self, names: Iterable[str]) -> None:
        """Raise InputError where a file of one of these names is there that posefuse did not write or that was changed."""
        wanted = [name for name in names if (self.folder / name).exists() or (self.folder / name).is_symlink()]
        if not wanted:
            return
        written = {path.as_posix() for path in contents(self.folder).written}
        foreign = [name for name in wanted if name not in written]
        if foreign:
            raise InputError(
                f"{self.folder}: holds {', '.join(foreign)}, which posefuse did not write or which was changed since; "
                "move it away or choose another folder"
            )

    def add(self, paths: Iterable[Path]) -> None:
        """Note files of this folder as written by posefuse; call it after each is complete.

        Raises:
            InputError: the list cannot be written; the files are there, and the earlier list as it was.
        """
        try:
            self._add(paths)
        except OSError as error:
            raise InputError(
                f"{self.folder}: the list of files cannot be written ({error.strerror}); what is complete is kept, and the same "
                "command continues from there"
            ) from None

    def _add(self, paths: Iterable[Path]) -> None:
        manifest = read_manifest(self.folder) or Manifest(command=self.command, target=".")
        new = {path.relative_to(self.folder).as_posix() for path in paths}
        earlier = [one for one in manifest.files if one.path not in new and (self.folder / one.path).is_file()]
        found = manifest_of_files(self.folder, manifest, [self.folder / name for name in new])
        files = sorted((*earlier, *found.files), key=lambda one: one.path)
        write_manifest(self.folder, dataclasses.replace(found, files=tuple(files)))


def growing_folder(path: Path, *, command: str, names: Iterable[str]) -> GrowingFolder:
    """Open or make a folder to add files of these names to; see `GrowingFolder.check`.

    Raises:
        InputError: it cannot be made or written to, holds the results of another command, or a foreign file of a name of ours.
    """
    target = real_path(path)
    if target.exists() and not target.is_dir():
        raise InputError(f"{path}: expected a folder to write results to, got a file")
    manifest = read_manifest(target)
    if manifest is not None and manifest.command != command:
        raise InputError(f"{path}: holds results of `posefuse {manifest.command}`; choose another folder")
    if manifest is None and (target / MANIFEST_FILE).exists():
        raise InputError(f"{path}: holds a {MANIFEST_FILE} that posefuse did not write; choose another folder")
    folder = GrowingFolder(target, command)
    try:
        target.mkdir(parents=True, exist_ok=True)
        folder.check(names)
        folder.add(())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
    return folder
