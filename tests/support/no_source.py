"""A source that is never read: for cameras whose frames a test puts there itself."""

from __future__ import annotations

from dataclasses import dataclass


class NoSource:
    """Of 64 x 48 px, without frames."""

    camera, size_wh = "cam00", (64, 48)

    def frames(self):
        return iter(())

    def close(self) -> None:
        """Nothing is open."""


@dataclass(frozen=True)
class NoSourceConfig:
    def build(self) -> NoSource:
        return NoSource()
