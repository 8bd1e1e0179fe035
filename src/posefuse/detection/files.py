"""Files of networks: next to their card, or fetched once into the user's cache; checked by the hash that is stated.

No network is part of this package. A machine without internet takes a copy of the cache of one that has it. A reader never sees
half a file, nor one of another hash than its card or its archive states.
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
from .download import Source, file_sha256, member_of

STAGE = "downloading networks"


def model_path(card: NetworkCard, cache_dir: Path) -> Path:
    """Where the card's file is, or will be once it is fetched."""
    return card.folder / card.file if card.file else cache_dir / "models" / card.file_name


def status(card: NetworkCard, cache_dir: Path) -> Literal["ready", "missing", "damaged"]:
    """Whether the card's file is there, with the hash that the card states, if any."""
    path = model_path(card, cache_dir)
    if not path.is_file():
        return "missing"
    return "ready" if not card.sha256 or file_sha256(path) == card.sha256.lower() else "damaged"


def fetch_all(cards: Sequence[NetworkCard], cache_dir: Path, progress: Progress = silent, *, terms: bool = False) -> list[Path]:
    """Files of several networks, those with a source fetched where they are missing; one download serves all of an archive.

    Args:
        cards: what is needed.
        cache_dir: the user's cache folder; made when missing.
        progress: gets the number of archives, and a text for each step, before a download starts.
        terms: those of the cards were read and accepted.

    Raises:
        ModelError: no internet, an archive without the file, a file whose hash is not the stated one (names both), or one whose
            terms are to be accepted first.
    """
    missing = [card for card in cards if status(card, cache_dir) != "ready"]
    for card in missing:
        _check_fetched(card, cache_dir, terms)
    # some cards name the same file
    missing = list({card.file_name: card for card in missing}.values())
    requirements = list(dict.fromkeys(_source(card).requirement for card in missing))
    for i, requirement in enumerate(requirements):
        cards_of_it = [card for card in missing if _source(card).requirement == requirement]
        say = partial(progress, STAGE, i, len(requirements))
        names = ", ".join(card.file_name for card in cards_of_it)
        say(f"downloading {names} ({requirement}) into {cache_dir}; this happens once")
        _download(cards_of_it, cache_dir, say)
    if requirements:
        progress(STAGE, len(requirements), len(requirements))
    return [model_path(card, cache_dir) for card in cards]


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
    with tempfile.TemporaryDirectory(prefix="posefuse-") as temporary:
        archive = _source(cards[0]).download(Path(temporary))
        for card in cards:
            content = member_of(archive, _source(card), card.size_bytes)
            _keep(card, content, cache_dir)
            say(f"{card.file_name}: verified")


def _keep(card: NetworkCard, content: bytes, cache_dir: Path) -> None:
    """Check and write a new file, then rename; a file of that name with another content stays as NAME.replaced-TIME."""
    got, known = hashlib.sha256(content).hexdigest(), card.sha256.lower()
    if known and got != known:
        raise ModelError(f"{_source(card).requirement}: {card.file_name}: expected sha256 {known}, got {got}; not used")
    target = model_path(card, cache_dir)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        # of another content: a download that was damaged, or a network of the user's own
        with earlier_kept(target):
            with tempfile.NamedTemporaryFile(dir=target.parent, prefix=f".{card.file_name}.", delete=False) as new:
                new.write(content)
            Path(new.name).replace(target)
    except OSError as error:
        raise ModelError(f"{target}: cannot be written ({error}); set POSEFUSE_CACHE to a folder that can") from None
