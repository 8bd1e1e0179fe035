"""Button 0 of a joystick of Linux.

A button that is held sends no events. So a joystick out of reach looks like one that is held: it counts as held until the kernel
removes the device, at once when a cable is pulled out, but only after seconds, or never, when a radio link is lost.
"""

from __future__ import annotations

import os
import struct

from posefuse.core import SourceError
from posefuse.teleoperation.heartbeats import Beat
from posefuse.teleoperation.values import OperatorView

from .protocol import Pressed

# struct js_event: time ms, value, type, number
_EVENT = struct.Struct("IhBB")
_BUTTON, _INITIAL = 0x01, 0x80
_HOLD, _GRIP, _STOP, _RESET = 0, 1, 2, 3


class JoystickSwitch:
    """Button 0 held: follow. 1: gripper. 2: emergency stop. 3: reset (`DeadMan`)."""

    hint = "hold button 0 to move; button 1: gripper, 2: emergency stop, 3: reset, Ctrl-C: end"

    def __init__(self, device: str) -> None:
        try:
            self._fd = os.open(device, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise SourceError(f"--deadman joystick:{device}: cannot be opened ({error.strerror})") from None
        self._held = self._grip = False
        self._seq, self._rest = 0, b""

    def poll(self, now_ns: int, view: OperatorView | None) -> Pressed:
        """See `DeadMan`; an unplugged device counts as released."""
        went_down: set[int] = set()
        while self._fd >= 0:
            try:
                more = os.read(self._fd, 64 * _EVENT.size)
            except BlockingIOError:
                break
            except OSError:
                more = b""
            if not more:
                self.close()
                break
            self._rest += more
            whole = len(self._rest) // _EVENT.size * _EVENT.size
            for _, value, kind, number in _EVENT.iter_unpack(self._rest[:whole]):
                if kind & ~_INITIAL != _BUTTON:
                    continue
                if number == _HOLD:
                    self._held = bool(value)
                if value and not kind & _INITIAL:
                    went_down.add(number)
            self._rest = self._rest[whole:]
        self._grip ^= _GRIP in went_down
        beats: tuple[Beat, ...] = ()
        if self._held and self._fd >= 0:
            self._seq += 1
            beats = (Beat(seq=self._seq, sent_ns=now_ns, grip=self._grip),)
        return Pressed(beats=beats, emergency=_STOP in went_down, reset=_RESET in went_down)

    def close(self) -> None:
        """See `DeadMan`."""
        if self._fd >= 0:
            os.close(self._fd)
        self._fd, self._held = -1, False
