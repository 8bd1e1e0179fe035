"""Frames as a camera delivers them: their images are converted to RGB only when they are used."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from posefuse.core import Frame, Source
from posefuse.core.depth import DepthImage
from posefuse.core.encoded import EncodedFrame
from posefuse.formats.pixels import Pixels, RgbPixels


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Arrived:
    """A frame whose image may not have been converted yet; all else as in `Frame`."""

    camera: str
    seq: int
    t_ns: int
    received_ns: int
    pixels: Pixels
    encoded: EncodedFrame | None = None
    depth: DepthImage | None = None

    @classmethod
    def of(cls, frame: Frame) -> Arrived:
        """A frame whose image is RGB already."""
        return cls(
            camera=frame.camera,
            seq=frame.seq,
            t_ns=frame.t_ns,
            received_ns=frame.received_ns,
            pixels=RgbPixels(frame.image),
            encoded=frame.encoded,
            depth=frame.depth,
        )

    def frame(self) -> Frame:
        """With its image."""
        return Frame(
            camera=self.camera,
            seq=self.seq,
            t_ns=self.t_ns,
            received_ns=self.received_ns,
            image=self.pixels.rgb(),
            encoded=self.encoded,
            depth=self.depth,
        )


@runtime_checkable
class UnconvertedSource(Source, Protocol):
    """A source that can leave the conversion to those who look at a frame."""

    def arriving(self) -> Iterator[Arrived]:
        """What `frames` gives, not converted yet."""
        ...


def arriving(source: Source) -> Iterator[Arrived]:
    """The frames of any source, converted late where it can do that."""
    return source.arriving() if isinstance(source, UnconvertedSource) else map(Arrived.of, source.frames())
