"""A robot that follows the operator's hand: `posefuse.teleoperate`; for its limits see docs/teleoperation.md."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from posefuse.api.arguments import shown
from posefuse.api.live import LiveSession
from posefuse.core import ConfigError, Progress

if TYPE_CHECKING:
    from posefuse_teleop.session import Operator, Summary
    from posefuse_teleop.settings import RosPlan, TeleoperationSettings
    from posefuse_teleop.switches import DeadMan
    from posefuse_teleop.values import Order


def teleoperate(
    session: LiveSession,
    *,
    deadman: str | DeadMan = "web",
    settings: TeleoperationSettings | None = None,
    robot: str | Path = "sim",
    frames: Sequence[str] | None = None,
    command: str | None = None,
    ros: RosPlan | None = None,
    view: bool = False,
    record: str | Path | None = None,
    watch: Callable[[Operator, Order | None], None] | None = None,
    progress: Progress | bool | None = None,
) -> Summary:
    """Let a robot follow the operator's hand until the session ends, or Ctrl-C; no certified safety function.

    Args:
        session: from `posefuse.live`, not yet begun.
        deadman: ``web``, ``web:PORT``, ``ros:/TOPIC``, or a switch of your own.
        settings: hands, mapping, gate, limits, separation, robot.
        robot: ``sim``, our own in MuJoCo, or an MJCF file. frames: its sites, one per hand; default ``right_hand`` ...
        command: None drives the robot in MuJoCo; ``pose`` or ``joints`` drives one over `ros`. A dead-man's switch
            ``ros:/TOPIC`` is there, too; without `ros` where the session has ROS.
        view: open MuJoCo's viewer.
        record: .mcap of commands and states of the robot.
        watch: is shown the operator's side and the order after every step.

    Raises:
        PosefuseError: what keeps it from beginning.

    Examples:
        >>> import posefuse as pf
        >>> session = pf.live("rig.toml", {"cam1": "usb:0", "cam2": "usb:1"})  # doctest: +SKIP
        >>> pf.teleoperate(session, deadman="web", robot="sim").engagements  # doctest: +SKIP
    """
    from posefuse.foundation.output_file import check_output_file
    from posefuse.realtime.session import stop_requests
    from posefuse_teleop.process import RobotLink, RobotPlan
    from posefuse_teleop.session import run_control_loop
    from posefuse_teleop.settings import RosPlan, TeleoperationSettings
    from posefuse_teleop.switches import open_deadman

    settings = settings or TeleoperationSettings()
    sites = tuple(frames) if frames else tuple(f"{side}_hand" for side in settings.hands)
    _check(settings, command, sites)
    if record is not None:
        check_output_file(Path(record), option="record")
    plan = RobotPlan(
        settings=settings,
        model=None if str(robot) == "sim" else Path(robot),
        frames=sites,
        command=command,
        ros=ros,
        record=Path(record).absolute() if record is not None else None,
        view=view,
    )
    with ExitStack() as stack:
        switch = open_deadman(deadman, ros=lambda: ros or RosPlan.listening(session.ros))
        stack.callback(switch.close)
        session.ros_used_elsewhere = ros is not None or str(deadman).startswith("ros:")
        link = RobotLink(plan)
        stack.callback(link.close)
        link.wait_ready()
        stack.enter_context(session)
        with shown(progress) as report:
            report("teleoperation", 0, None, switch.hint)
        with stop_requests() as stopped:
            summary = run_control_loop(session, switch, link, settings, watch=watch, stopped=stopped)
            stack.close()
    outputs = [f"{name}: {output.fault}" for name, output in session.outputs.items() if output.failures]
    summary.fault = "; ".join(filter(None, [summary.fault or link.trouble, *outputs]))
    return summary


def _check(settings: TeleoperationSettings, command: str | None, sites: Sequence[str]) -> None:
    if not settings.hands or len(set(settings.hands)) != len(settings.hands):
        raise ConfigError(f"hands: expected left, right or both, each once, got {settings.hands}")
    if len(sites) != len(settings.hands):
        raise ConfigError(f"frames: expected one per hand ({', '.join(settings.hands)}), got {len(sites)}")
    if command not in (None, "pose", "joints"):
        raise ConfigError(f"command: expected pose or joints, got {command!r}")
    if any(low >= high for low, high in zip(settings.limits.box_low_m, settings.limits.box_high_m, strict=True)):
        raise ConfigError("limits.box_low_m: expected each coordinate below that of box_high_m")
    if settings.separation.stop_m >= settings.separation.slow_m:
        raise ConfigError("separation.stop_m: expected less than slow_m")
    if settings.gate.slow_sigma_m >= settings.gate.hold_sigma_m:
        raise ConfigError("gate.slow_sigma_m: expected less than hold_sigma_m")
