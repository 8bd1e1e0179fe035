"""Hashes of networks whose makers state none: the file that was fetched first is the one that is used from then on.

They are kept in the cache. A session folder may carry the same file, so that a study uses the same networks in every laboratory.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from posefuse.core import ConfigError
from posefuse.foundation.output_file import atomic_file
from posefuse.foundation.settings import read_mapping

from .card import NetworkCard

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
