"""The space bar of a terminal, by its key repeat: a terminal reports no release; a held key repeats 20 to 40 times a second."""

from __future__ import annotations

import contextlib
import os
import select
import sys
from typing import Any

from posefuse.core import SourceError
from posefuse.teleoperation.heartbeats import Beat
from posefuse.teleoperation.values import OperatorView

from .protocol import Pressed


class KeySwitch:
    """Space held: follow. ``g``: gripper. ``x``: emergency stop. ``r``: reset (`DeadMan`)."""

    hint = "hold the space bar to move (it begins when the key repeats); g: gripper, x: emergency stop, r: reset, Ctrl-C: end"

    def __init__(self, stream: Any = None) -> None:
        self._stream = sys.stdin if stream is None else stream
        self._seq, self._grip, self._before = 0, False, None
        try:
            import termios
            import tty

            self._fd = self._stream.fileno()
            self._before = termios.tcgetattr(self._fd)
            tty.setcbreak(self._fd)
        except (ImportError, OSError, ValueError, AttributeError) as error:
            raise SourceError(f"--deadman key: no terminal to read keys from ({error}); use web or joystick:DEVICE") from None
        except Exception as error:  # termios.error is no OSError
            if type(error).__module__ != "termios":
                raise
            raise SourceError(f"--deadman key: no terminal to read keys from ({error}); use web or joystick:DEVICE") from None

    def poll(self, now_ns: int, view: OperatorView | None) -> Pressed:
        """See `DeadMan`."""
        typed = b""
        while select.select([self._fd], [], [], 0)[0]:
            more = os.read(self._fd, 64)
            if not more:
                break
            typed += more
        self._grip ^= typed.count(b"g") % 2 == 1
        beats: tuple[Beat, ...] = ()
        if b" " in typed:
            self._seq += 1
            beats = (Beat(seq=self._seq, sent_ns=now_ns, grip=self._grip),)
        return Pressed(beats=beats, emergency=b"x" in typed, reset=b"r" in typed)

    def close(self) -> None:
        """See `DeadMan`."""
        if self._before is not None:
            import termios

            with contextlib.suppress(OSError, ValueError):
                termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)
            self._before = None
