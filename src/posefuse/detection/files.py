"""Files of networks: next to their card, or fetched once into the user's cache; always checked by their hash.

No network is part of this package. A machine without a network takes the archive, the file itself, or a folder that holds either,
by path. A reader never sees half a file, nor a wrong one.

Where its makers state no hash, the file that was fetched first is the one that is used from then on. These hashes are kept in the
cache. A session folder may carry the same list, so that a study uses the same networks in every laboratory.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from posefuse.core import ConfigError, ModelError, Progress, silent
from posefuse.foundation.output_file import atomic_file, earlier_kept
from posefuse.foundation.settings import read_mapping

from .card import NetworkCard
from .download import Source, UrlSource, member_of

LOCK_FILE = "networks.lock.toml"


@dataclass(frozen=True)
class Trust:
    """Which files are accepted.

    Attributes:
        terms: those of the cards were read and accepted.
        locked: only files whose hash is known.
        lock: hashes in place of the cache's; only read, and nothing else is accepted.
    """

    terms: bool = False
    locked: bool = False
    lock: Path | None = None

    @property
    def first_use(self) -> bool:
        """Whether a file is accepted, and from then on kept to, whose hash no source states."""
        return not self.locked and self.lock is None

    def known_sha256(self, card: NetworkCard, cache_dir: Path) -> str:
        """The hash that the card's file must have; "" where no source states it. Raises ConfigError for a damaged lock."""
        return card.sha256.lower() or _hashes(self.file(cache_dir)).get(card.file_name, "")

    def file(self, cache_dir: Path) -> Path:
        """Where hashes are looked up."""
        return self.lock or cache_dir / "models" / LOCK_FILE


# anything, which is then kept to
FIRST_USE = Trust()


def remember(card: NetworkCard, sha256: str, cache_dir: Path) -> None:
    """Keep to this file of a card from now on."""
    path = FIRST_USE.file(cache_dir)
    with atomic_file(path) as new:
        lines = [f'"{name}" = "{value}"\n' for name, value in {**_hashes(path), card.file_name: sha256}.items()]
        new.write_text("".join(lines), encoding="utf-8")


def _hashes(path: Path) -> dict[str, str]:
    found = read_mapping(path) if path.is_file() else {}
    if not all(isinstance(value, str) for value in found.values()):
        raise ConfigError(f"{path}: expected lines of a file name and a sha256")
    return {name: value.lower() for name, value in found.items()}


STAGE = "downloading networks"
_ARCHIVES = (".whl", ".tgz", ".zip")


def model_path(card: NetworkCard, cache_dir: Path) -> Path:
    """Where the card's file is, or will be once it is fetched."""
    return card.folder / card.file if card.file else cache_dir / "models" / card.file_name


def status(card: NetworkCard, cache_dir: Path, trust: Trust = FIRST_USE) -> Literal["ready", "missing", "damaged"]:
    """Whether the card's file is there with the right hash."""
    path = model_path(card, cache_dir)
    if not path.is_file():
        return "missing"
    return "ready" if _file_sha256(path) == trust.known_sha256(card, cache_dir) else "damaged"


def fetch(card: NetworkCard, cache_dir: Path, source: Path | None = None, progress: Progress = silent) -> Path:
    """The card's model file; see `fetch_all`."""
    return fetch_all([card], cache_dir, source, progress)[0]


def fetch_all(
    cards: Sequence[NetworkCard],
    cache_dir: Path,
    source: Path | None = None,
    progress: Progress = silent,
    trust: Trust = FIRST_USE,
) -> list[Path]:
    """Files of several networks, those with a source fetched where they are missing; one download serves all of an archive.

    Args:
        cards: what is needed.
        cache_dir: the user's cache folder; made when missing.
        source: an archive, a model file, or a folder with either, instead of a download. Never written to.
        progress: gets the number of archives, and a text for each step, before a download starts.
        trust: which files are accepted.

    Raises:
        ModelError: no internet, a source without the file, a file whose hash is not the known one (names both), or one that is
            not trusted.
    """
    missing = [card for card in cards if status(card, cache_dir, trust) != "ready"]
    for card in missing:
        _check_fetched(card, cache_dir, trust)
    # some cards name the same file
    missing = list({card.file_name: card for card in missing}.values())
    if missing and source is not None:
        for card in missing:
            _keep(card, _read_from(source, card), cache_dir, str(source), trust)
    elif missing:
        requirements = list(dict.fromkeys(_source(card).requirement for card in missing))
        for i, requirement in enumerate(requirements):
            cards_of_it = [card for card in missing if _source(card).requirement == requirement]
            say = partial(progress, STAGE, i, len(requirements))
            names = ", ".join(card.file_name for card in cards_of_it)
            say(f"downloading {names} ({requirement}) into {cache_dir}; this happens once")
            _download(cards_of_it, cache_dir, say, trust)
        progress(STAGE, len(requirements), len(requirements))
    return [model_path(card, cache_dir) for card in cards]


def holds(origin: Path, card: NetworkCard) -> bool:
    """Whether an archive, folder or file has something to offer for this card; its hash is not looked at."""
    if origin.is_file() and isinstance(card.source, UrlSource):
        # the network has the same name in all archives of a maker
        return origin.name in (card.file_name, card.source.file_pattern)
    if origin.is_file() and origin.suffix not in _ARCHIVES:
        return origin.name == card.file_name
    try:
        return bool(_read_from(origin, card))
    except ModelError:
        return False


def _sha256_of_archive(card: NetworkCard) -> str:
    """The hash of the archive that holds the network; "" where no source states it."""
    return card.source.archive_sha256 if isinstance(card.source, UrlSource) else ""


def _source(card: NetworkCard) -> Source:
    assert card.source is not None, "networks next to their card are not fetched"
    return card.source


def _check_fetched(card: NetworkCard, cache_dir: Path, trust: Trust) -> None:
    """Raise ModelError for a card whose file is not there and is not to be fetched."""
    if card.source is None:
        path, published = model_path(card, cache_dir), f" (published at {card.published})" if card.published else ""
        if not path.is_file():
            raise ModelError(f"model card {card.name}: no file {path}; put the network there{published}")
        raise ModelError(f"model card {card.name}: {path}: expected sha256 {card.sha256}, got {_file_sha256(path)}{published}")
    if card.terms and not trust.terms:
        raise ModelError(
            f"{card.name}: {card.licence}, as its makers state ({card.terms.stated_by}); trained on {card.terms.data}. "
            f"To accept these terms and fetch it: posefuse models --accept-licence {card.name}"
        )
    if not (trust.first_use or trust.known_sha256(card, cache_dir) or _sha256_of_archive(card)):
        raise ModelError(f"{card.name}: its sha256 stands neither in its card nor in {trust.file(cache_dir)}: refused as locked")


def _download(cards: Sequence[NetworkCard], cache_dir: Path, say: Callable[[str], None], trust: Trust) -> None:
    source = _source(cards[0])
    if isinstance(source, UrlSource):
        # what was received stays there until it is whole
        archive = source.download(_folder(cache_dir / "downloads"), trust.known_sha256(cards[0], cache_dir), cards[0].size_bytes)
        _keep_all(cards, archive, cache_dir, say, trust)
        archive.unlink(missing_ok=True)
        return
    with tempfile.TemporaryDirectory(prefix="posefuse-") as temporary:
        _keep_all(cards, source.download(Path(temporary)), cache_dir, say, trust)


def _keep_all(cards: Sequence[NetworkCard], archive: Path, cache_dir: Path, say: Callable[[str], None], trust: Trust) -> None:
    for card in cards:
        _keep(card, _read_from(archive, card), cache_dir, _source(card).requirement, trust)
        say(f"{card.file_name}: verified")


def _folder(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ModelError(f"{folder}: cannot be made ({error.strerror}); set POSEFUSE_CACHE to a folder that can") from None
    return folder


def _read_from(origin: Path, card: NetworkCard) -> bytes:
    """The card's file out of an archive, a folder, or the file itself."""
    if origin.is_dir():
        found = sorted(origin.rglob(card.file_name)) or sorted(origin.glob(_source(card).file_pattern))
        if not found:
            wanted = f"{card.file_name} or the archive of {_source(card).requirement}"
            raise ModelError(f"{origin}: expected {wanted} in this folder, got neither")
        return _read_from(found[0], card)
    if not origin.is_file():
        raise ModelError(f"{origin}: no such archive, model file or folder (needed for {card.file_name})")
    if origin.suffix in _ARCHIVES:
        stated = _sha256_of_archive(card)
        if stated and (got := _file_sha256(origin)) != stated:
            raise ModelError(f"{origin}: expected sha256 {stated}, got {got}; not used")
        return member_of(origin, _source(card), card.size_bytes)
    try:
        with origin.open("rb") as file:
            return file.read(card.size_bytes + 1)
    except OSError as error:
        raise ModelError(f"{origin}: cannot be read ({error.strerror})") from None


def _keep(card: NetworkCard, content: bytes, cache_dir: Path, origin: str, trust: Trust) -> None:
    """Check and write a new file, then rename; a file of that name with another content stays as NAME.replaced-TIME."""
    got, known = hashlib.sha256(content).hexdigest(), trust.known_sha256(card, cache_dir)
    if known and got != known:
        raise ModelError(f"{origin}: {card.file_name}: expected sha256 {known}, got {got}; not used")
    target = _folder(cache_dir / "models") / card.file_name
    try:
        # of another content: a download that was damaged, or a network of the user's own
        with earlier_kept(target):
            with tempfile.NamedTemporaryFile(dir=target.parent, prefix=f".{card.file_name}.", delete=False) as new:
                new.write(content)
            Path(new.name).replace(target)
    except OSError as error:
        raise ModelError(f"{target}: cannot be written ({error}); set POSEFUSE_CACHE to a folder that can") from None
    if not known:
        remember(card, got, cache_dir)


def _file_sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
