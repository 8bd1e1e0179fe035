"""Dead-man's switches by their names on the command line."""

from __future__ import annotations

from posefuse.core import ConfigError
from posefuse.teleoperation.robots.reports import RosPlan

from .protocol import DeadMan

KINDS = "key, joystick:/dev/input/js0, ros:/joy, web, web:PORT, gesture"


def open_deadman(text: str, *, gesture_allowed: bool = True, ros: RosPlan | None = None) -> DeadMan:
    """The switch of ``--deadman``. ros: where its topic is; None: domain 0 of ROS 2.

    Raises:
        ConfigError: no such switch, or a gesture where it alone is not enough. SourceError: it cannot be opened.
    """
    kind, _, where = text.partition(":")
    if kind == "key" and not where:
        from .key import KeySwitch

        return KeySwitch()
    if kind == "joystick" and where:
        from .joystick import JoystickSwitch

        return JoystickSwitch(where)
    if kind == "ros" and where.startswith("/"):
        from .ros_joy import RosJoySwitch

        return RosJoySwitch(where, ros or RosPlan())
    if kind == "web" and (not where or where.isdecimal()):
        from .web import WebSwitch

        return WebSwitch(int(where or 0))
    if text == "gesture":
        from .gesture import GestureSwitch

        if not gesture_allowed:
            raise ConfigError(
                "--deadman gesture: a gesture alone does not stop a real robot when the cameras fail; "
                "use another switch, or --i-have-an-emergency-stop where one is within reach"
            )
        return GestureSwitch()
    raise ConfigError(f"--deadman {text}: expected one of {KINDS}")
