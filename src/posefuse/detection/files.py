"""Files of networks in the user's cache, fetched once and checked by their hash.

No model is part of this package. A machine without a network takes the archive, the file itself, or a folder that holds either,
by path. A reader never sees half a file, nor a wrong one.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from posefuse.core import ModelError
from posefuse.foundation.output_file import keep_copy

from .archives import member_of
from .card import ModelCard

Progress = Callable[[str], None]
Advance = Callable[[int, int], None]
_ARCHIVES = (".whl", ".tgz")


def model_path(card: ModelCard, cache_dir: Path) -> Path:
    """Where the card's file is kept."""
    return cache_dir / "models" / card.file_name


def status(card: ModelCard, cache_dir: Path) -> Literal["ready", "missing", "damaged"]:
    """Whether the card's file is in the cache with the right hash."""
    path = model_path(card, cache_dir)
    if not path.is_file():
        return "missing"
    return "ready" if _sha256(path.read_bytes()) == card.sha256 else "damaged"


def fetch(card: ModelCard, cache_dir: Path, source: Path | None = None, progress: Progress | None = None) -> Path:
    """The card's model file; see `fetch_all`."""
    return fetch_all([card], cache_dir, source, progress)[0]


def fetch_all(
    cards: Sequence[ModelCard],
    cache_dir: Path,
    source: Path | None = None,
    progress: Progress | None = None,
    advance: Advance | None = None,
) -> list[Path]:
    """Model files of several cards, from the cache or fetched into it; one download serves all cards of an archive.

    Args:
        cards: what is needed.
        cache_dir: the user's cache folder; made when missing.
        source: an archive, a model file, or a folder with either, instead of a download. Never written to.
        progress: gets a text for each step, before a download starts. advance: archives (done, total).

    Raises:
        ModelError: no network, a source without the file, or a file whose hash is not the card's.
    """
    say = progress or (lambda _: None)
    missing = [card for card in cards if status(card, cache_dir) != "ready"]
    if missing and source is not None:
        for card in missing:
            _keep(card, _read_from(source, card), cache_dir, str(source))
    elif missing:
        requirements = list(dict.fromkeys(card.source.requirement for card in missing))
        for i, requirement in enumerate(requirements):
            cards_of_it = [card for card in missing if card.source.requirement == requirement]
            _announce(cards_of_it, cache_dir, say)
            if advance:
                advance(i, len(requirements))
            _download(cards_of_it, cache_dir, say)
        if advance:
            advance(len(requirements), len(requirements))
    return [model_path(card, cache_dir) for card in cards]


def holds(origin: Path, card: ModelCard) -> bool:
    """Whether an archive, folder or file has something to offer for this card; its hash is not looked at."""
    if origin.is_file() and origin.suffix not in _ARCHIVES:
        return origin.name == card.file_name
    try:
        return bool(_read_from(origin, card))
    except ModelError:
        return False


def _announce(cards: Sequence[ModelCard], cache_dir: Path, say: Progress) -> None:
    names = ", ".join(card.file_name for card in cards)
    say(f"downloading {names} ({cards[0].source.requirement}) into {cache_dir}; this happens once")


def _download(cards: Sequence[ModelCard], cache_dir: Path, say: Progress) -> None:
    source = cards[0].source
    with tempfile.TemporaryDirectory(prefix="posefuse-") as folder:
        archive = source.download(Path(folder))
        for card in cards:
            _keep(card, _read_from(archive, card), cache_dir, source.requirement)
            say(f"{card.file_name}: verified")


def _read_from(origin: Path, card: ModelCard) -> bytes:
    """The card's file out of an archive, a folder, or the file itself."""
    if origin.is_dir():
        found = sorted(origin.rglob(card.file_name)) or sorted(origin.glob(card.source.file_pattern))
        if not found:
            wanted = f"{card.file_name} or the archive of {card.source.requirement}"
            raise ModelError(f"{origin}: expected {wanted} in this folder, got neither")
        return _read_from(found[0], card)
    if not origin.is_file():
        raise ModelError(f"{origin}: no such archive, model file or folder (needed for {card.file_name})")
    if origin.suffix in _ARCHIVES:
        return member_of(origin, card.source, card.size_bytes)
    try:
        with origin.open("rb") as file:
            return file.read(card.size_bytes + 1)
    except OSError as error:
        raise ModelError(f"{origin}: cannot be read ({error.strerror})") from None


def _keep(card: ModelCard, content: bytes, cache_dir: Path, origin: str) -> None:
    """Check and write a new file, then rename; a file of that name with another content stays as NAME.replaced-TIME."""
    got = _sha256(content)
    if got != card.sha256:
        raise ModelError(f"{origin}: {card.file_name}: expected sha256 {card.sha256}, got {got}; not used")
    target = model_path(card, cache_dir)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        # of another content: a download that was damaged, or a network of the user's own
        keep_copy(target)
        with tempfile.NamedTemporaryFile(dir=target.parent, prefix=f".{card.file_name}.", delete=False) as beside:
            beside.write(content)
        Path(beside.name).replace(target)
    except OSError as error:
        raise ModelError(f"{target}: cannot be written ({error}); set POSEFUSE_CACHE to a folder that can") from None


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
