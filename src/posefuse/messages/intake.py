"""Bytes from strangers to values: what does not fit is refused and counted, never a crash."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from posefuse.core import MessageError, PosefuseError

from .types import ros2_types

T = TypeVar("T")


def decode(raw: bytes, type_name: str, max_bytes: int) -> Any:
    """The message in CDR bytes; raises MessageError when malformed or longer than `max_bytes`."""
    from rosbags.serde import SerdeError

    if len(raw) > max_bytes:
        raise MessageError(f"{type_name}: expected at most {max_bytes} bytes, got {len(raw)}")
    try:
        return ros2_types().deserialize_cdr(raw, type_name)
    except (SerdeError, IndexError, ValueError, OverflowError, MemoryError, struct.error) as error:
        raise MessageError(f"{type_name}: malformed message ({error})") from None


@dataclass
class Counts:
    """What came in over one topic.

    Attributes:
        accepted: values handed on. refused: messages that did not fit.
        last_refusal: why, of the newest one refused; empty when none was.
    """

    accepted: int = 0
    refused: int = 0
    last_refusal: str = ""


@dataclass
class Intake(Generic[T]):
    """Turns the bytes of one topic into values and keeps count.

    Attributes:
        type_name: ROS type expected.
        value_from_message: e.g. `messages.detections_from_message`; may raise any PosefuseError.
        max_bytes: longer messages are refused unread.
    """

    type_name: str
    value_from_message: Callable[[Any], T]
    max_bytes: int = 2**20
    counts: Counts = field(default_factory=Counts)

    def take(self, raw: bytes) -> T | None:
        """The value, or None when it was refused."""
        try:
            value = self.value_from_message(decode(raw, self.type_name, self.max_bytes))
        except PosefuseError as error:
            self.counts.refused += 1
            self.counts.last_refusal = str(error)
            return None
        self.counts.accepted += 1
        return value
