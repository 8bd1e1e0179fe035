"""A live source of frames from memory."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from posefuse.core import Frame


@dataclass(frozen=True)
class Clip:
    """One image at times in ns that count from the session's zero; none: a test puts frames there itself.

    `plays`: gives the frames of the clip in place of those.
    """

    camera: str = "cam00"
    image: Any = None
    stamps_ns: tuple[int, ...] = ()
    zero_ns: int | None = None
    size_wh: tuple[int, int] = (64, 48)
    plays: Callable[["Clip"], Iterator[Frame]] | None = None

    def build(self) -> "Clip":
        return self

    def close(self) -> None: ...

    def frames(self) -> Iterator[Frame]:
        return self.plays(self) if self.plays else self.stamped()

    def stamped(self) -> Iterator[Frame]:
        """The image at its times."""
        for i, t_ns in enumerate(self.stamps_ns):
            yield Frame(camera=self.camera, seq=i, t_ns=t_ns, received_ns=t_ns, image=self.image)
