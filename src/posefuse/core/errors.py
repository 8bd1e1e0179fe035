"""The one tree of errors. A message names the problem, the place, expected and actual value, and the next step.

A `PosefuseError` is a known fault of the input or the machine: the command line prints its one line and exits 1.
Anything else that escapes is a bug: the command line prints a trace and exits 2.
"""

import sys
import warnings
from collections.abc import Iterable
from types import FrameType

_LONGEST_LINE = 2000


class PosefuseError(Exception):
    """Base of every error a user can cause or cure; its message is one line, whatever names a damaged file has."""

    def __init__(self, message: str = "") -> None:
        line = "".join(" " if c in "\n\r\t" else c if c.isprintable() else repr(c)[1:-1] for c in message)
        middle = _LONGEST_LINE // 2
        super().__init__(line if len(line) <= _LONGEST_LINE else f"{line[:middle]} ... {line[-middle:]}")


class InputError(PosefuseError):
    """A file, folder or argument that cannot be used as it is."""


class DiskFullError(InputError):
    """No room to write a file: the disk, or what the user may use of it, is full."""


class ConfigError(InputError):
    """A setting that is unknown, of the wrong type or out of range."""


class CalibrationError(InputError):
    """A camera or rig that cannot be right (mirrored matrix, NaN, wrong size, unknown name)."""


class SourceError(InputError):
    """A camera, video or image folder that cannot be opened or read."""


class MessageError(InputError):
    """A message from the network or a bag that is malformed, too large or of the wrong kind."""


class ModelError(PosefuseError):
    """A network model that is missing, wrong or cannot be fetched."""


class DependencyError(PosefuseError):
    """An optional package or system library is missing; the message names what to install."""


class ShapeError(PosefuseError, ValueError):
    """An array whose shape or type does not fit the value it was given to."""


def warn_caller(line: str) -> None:
    """A `UserWarning` about what does not stop the work, at the program's line that called posefuse.

    Each time: Python shows the same words from the same line once, but they may be about another recording.
    """
    caller = sys._getframe(1)
    frame: FrameType | None = caller
    while frame is not None:
        if str(frame.f_globals.get("__name__")).partition(".")[0].startswith("posefuse"):
            caller = frame.f_back or frame
        frame = frame.f_back
    warnings.warn_explicit(line, UserWarning, caller.f_code.co_filename, caller.f_lineno, module=caller.f_globals.get("__name__"))


def choices(names: Iterable[str]) -> str:
    """The names that do exist, for the end of a message: ``"a, b, c"``, or ``"none"``."""
    return ", ".join(names) or "none"
