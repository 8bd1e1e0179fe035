"""Files of networks: next to their card, or fetched once into the user's cache; checked by the hash that is stated.

No network is part of this package. A machine without a network takes the archive, the file itself, or a folder that holds either,
by path. A reader never sees half a file, nor one of another hash than its card or its archive states.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Literal

from posefuse.core import ModelError, Progress, silent
from posefuse.foundation.output_file import earlier_kept

from .card import NetworkCard
from .download import Source, UrlSource, member_of

STAGE = "downloading networks"
_ARCHIVES = (".whl", ".tgz", ".zip")


def model_path(card: NetworkCard, cache_dir: Path) -> Path:
    """Where the card's file is, or will be once it is fetched."""
    return card.folder / card.file if card.file else cache_dir / "models" / card.file_name


def status(card: NetworkCard, cache_dir: Path) -> Literal["ready", "missing", "damaged"]:
    """Whether the card's file is there, with the hash that the card states, if any."""
    path = model_path(card, cache_dir)
    if not path.is_file():
        return "missing"
    return "ready" if not card.sha256 or file_sha256(path) == card.sha256.lower() else "damaged"


def fetch(card: NetworkCard, cache_dir: Path, source: Path | None = None, progress: Progress = silent) -> Path:
    """The card's model file; see `fetch_all`."""
    return fetch_all([card], cache_dir, source, progress)[0]


def fetch_all(
    cards: Sequence[NetworkCard],
    cache_dir: Path,
    source: Path | None = None,
    progress: Progress = silent,
    *,
    terms: bool = False,
) -> list[Path]:
    """Files of several networks, those with a source fetched where they are missing; one download serves all of an archive.

    Args:
        cards: what is needed.
        cache_dir: the user's cache folder; made when missing.
        source: an archive, a model file, or a folder with either, instead of a download. Never written to.
        progress: gets the number of archives, and a text for each step, before a download starts.
        terms: those of the cards were read and accepted.

    Raises:
        ModelError: no internet, a source without the file, a file whose hash is not the stated one (names both), or one whose
            terms are to be accepted first.
    """
    missing = [card for card in cards if status(card, cache_dir) != "ready"]
    for card in missing:
        _check_fetched(card, cache_dir, terms)
    # some cards name the same file
    missing = list({card.file_name: card for card in missing}.values())
    if missing and source is not None:
        for card in missing:
            _keep(card, _read_from(source, card), cache_dir, str(source))
    elif missing:
        requirements = list(dict.fromkeys(_source(card).requirement for card in missing))
        for i, requirement in enumerate(requirements):
            cards_of_it = [card for card in missing if _source(card).requirement == requirement]
            say = partial(progress, STAGE, i, len(requirements))
            names = ", ".join(card.file_name for card in cards_of_it)
            say(f"downloading {names} ({requirement}) into {cache_dir}; this happens once")
            _download(cards_of_it, cache_dir, say)
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


def _check_fetched(card: NetworkCard, cache_dir: Path, terms: bool) -> None:
    """Raise ModelError for a card whose file is not there and is not to be fetched."""
    if card.source is None:
        path, published = model_path(card, cache_dir), f" (published at {card.published})" if card.published else ""
        if not path.is_file():
            raise ModelError(f"model card {card.name}: no file {path}; put the network there{published}")
        raise ModelError(f"model card {card.name}: {path}: expected sha256 {card.sha256}, got {file_sha256(path)}{published}")
    if card.terms and not terms:
        raise ModelError(
            f"{card.name}: {card.licence}, as its makers state ({card.terms.stated_by}); trained on {card.terms.data}. "
            f"To accept these terms and fetch it: posefuse models --accept-licence {card.name}"
        )


def _download(cards: Sequence[NetworkCard], cache_dir: Path, say: Callable[[str], None]) -> None:
    source = _source(cards[0])
    if isinstance(source, UrlSource):
        # what was received stays there until it is whole
        archive = source.download(_folder(cache_dir / "downloads"), cards[0].sha256.lower(), cards[0].size_bytes)
        _keep_all(cards, archive, cache_dir, say)
        archive.unlink(missing_ok=True)
        return
    with tempfile.TemporaryDirectory(prefix="posefuse-") as temporary:
        _keep_all(cards, source.download(Path(temporary)), cache_dir, say)


def _keep_all(cards: Sequence[NetworkCard], archive: Path, cache_dir: Path, say: Callable[[str], None]) -> None:
    for card in cards:
        _keep(card, _read_from(archive, card), cache_dir, _source(card).requirement)
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
        if stated and (got := file_sha256(origin)) != stated:
            raise ModelError(f"{origin}: expected sha256 {stated}, got {got}; not used")
        return member_of(origin, _source(card), card.size_bytes)
    try:
        with origin.open("rb") as file:
            return file.read(card.size_bytes + 1)
    except OSError as error:
        raise ModelError(f"{origin}: cannot be read ({error.strerror})") from None


def _keep(card: NetworkCard, content: bytes, cache_dir: Path, origin: str) -> None:
    """Check and write a new file, then rename; a file of that name with another content stays as NAME.replaced-TIME."""
    got, known = hashlib.sha256(content).hexdigest(), card.sha256.lower()
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


def file_sha256(path: Path) -> str:
    """Of a file's content, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
