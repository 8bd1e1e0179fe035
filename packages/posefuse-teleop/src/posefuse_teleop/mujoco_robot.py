"""A robot in MuJoCo: joints driven by the model's own actuators, physics at the model's time step; and our own one as MJCF.

Ours is a planar base with one or two arms of seven joints, of primitives only. At zero the arm points straight up; joints turn
about z, y, z, y, z, y, z from the shoulder to the hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from posefuse.core import SE3, ConfigError
from posefuse.core.arrays import Array
from posefuse.core.extras import package_of_extra
from posefuse.foundation.parsing import one_line

from .follower import Follower
from .joints import Joints
from .kinematics import Chain
from .settings import LimitSettings
from .values import RobotState

ARM_HOME_RAD = (0.0, 0.4, 0.0, 1.6, 0.0, 1.1416, 0.0)
# of the position servos of the arm's joints, N m/rad
_ARM_GAINS = (8000, 8000, 5000, 5000, 1500, 1500, 600)


class MujocoRobot:
    """A simulated robot (`follower.Robot`).

    Attributes:
        model, data: of MuJoCo, with the physics. joints: as commanded.

    Raises:
        DependencyError: MuJoCo or DAQP is not there. ConfigError: a model that cannot be driven.
    """

    def __init__(self, model: Any, sites: Sequence[str], limits: LimitSettings, world_from_model: SE3 | None = None) -> None:
        self._mj, self.model = package_of_extra("mujoco", "teleop"), model
        chain = Chain(model, sites, limits.collision_m)
        self.joints = Joints(chain, limits, world_from_model or SE3.identity())
        self._sites = [model.site(s).id for s in sites]
        self._drives = [_drive(model, joint, name) for joint, name in zip(chain.joints, chain.names, strict=True)]
        self._cups = [a for a in range(model.nu) if int(model.actuator_trntype[a]) == int(self._mj.mjtTrn.mjTRN_BODY)]
        self.data = self._mj.MjData(model)
        if model.nkey:
            self._mj.mj_resetDataKeyframe(model, self.data, 0)
        self.data.qpos[chain.qpos] = self.joints.q
        self._command(self.joints.q, np.zeros(len(self.joints.q)))
        self._mj.mj_forward(model, self.data)
        self._viewer: Any = None

    def state(self) -> RobotState:
        """See `Robot`."""
        fault = "" if np.isfinite(self.data.qpos).all() else "the simulation diverged"
        return self.joints.state(self.data.qpos[self.joints.chain.qpos], fault)

    def move(self, wanted: Follower, dt_s: float, left_out: int = 0) -> None:
        """See `Robot`; physics for `dt_s`."""
        before, q = self.joints.q, self.joints.follow(wanted, dt_s, left_out)
        for a in self._cups:
            self.data.ctrl[a] = float(wanted.grip.any())
        steps = max(1, round(dt_s / self.model.opt.timestep))
        velocity = (q - before) / dt_s
        for i in range(1, steps + 1):
            self._command(before + (q - before) * (i / steps), velocity)
            self._mj.mj_step(self.model, self.data)
        if self._viewer is not None:
            self._viewer.sync()

    def open_viewer(self) -> None:
        """MuJoCo's own window in addition to the physics."""
        import mujoco.viewer

        self._viewer = mujoco.viewer.launch_passive(self.model, self.data, show_left_ui=False, show_right_ui=False)

    def close(self) -> None:
        """See `Robot`."""
        if self._viewer is not None:
            self._viewer.close()

    def _command(self, q: Array, velocity: Array) -> None:
        """Position servos get the velocity ahead, so that their damping does not make them lag."""
        for (actuator, lead_s), position, rate in zip(self._drives, q, velocity, strict=True):
            self.data.ctrl[actuator] = position + lead_s * rate


def _drive(model: Any, joint: int, name: str) -> tuple[int, float]:
    """The position actuator of a joint, and the lead of its set point; raises ConfigError without one."""
    import mujoco

    for a in range(model.nu):
        if int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_JOINT) and model.actuator_trnid[a, 0] == joint:
            gain, bias = model.actuator_gainprm[a, 0], model.actuator_biasprm[a]
            if gain > 0 and np.isclose(bias[1], -gain):
                return a, float(-bias[2] / gain)
            raise ConfigError(f"robot: actuator of joint {name!r}: expected <position>, got another kind")
    raise ConfigError(f"robot: joint {name!r} has no actuator; expected <position joint={name!r} .../>")


def mujoco_model(file: Path | None, hands: Sequence[str], text: str | None = None) -> Any:
    """The MuJoCo model of an MJCF file or text; of our own robot without one. Raises ConfigError for what is none."""
    mujoco = package_of_extra("mujoco", "teleop")
    if file is not None and not file.is_file():
        raise ConfigError(f"--robot {file}: there is no such file")
    try:
        if file is not None:
            return mujoco.MjSpec.from_file(str(file)).compile()
        return mujoco.MjSpec.from_string(text or mobile_manipulator(hands)).compile()
    except (ValueError, OSError) as error:
        raise ConfigError(f"{file or 'robot'}: not a usable MJCF model ({one_line(error)})") from None


def placed(position_xy_m: tuple[float, float], heading_deg: float) -> SE3:
    """world_from_model of a robot that stands on the floor."""
    return SE3.from_rotvec([0.0, 0.0, np.deg2rad(heading_deg)], [*position_xy_m, 0.0])


def mobile_manipulator(hands: Sequence[str] = ("right",)) -> str:
    """MJCF text. Each hand is a site ``right_hand`` or ``left_hand`` at the tip of its suction gripper."""
    mounts_m = {1: (0.0,), 2: (-0.2, 0.2)}[len(hands)]
    ordered = sorted(hands, key=lambda side: side != "right")
    arms = [_filled("arm.xml", side=side, y=y) for side, y in zip(ordered, mounts_m, strict=True)]
    motors = [
        f'<position name="{side}_j{i}" joint="{side}_j{i}" kp="{gain}" dampratio="1"/>'
        for side in ordered
        for i, gain in enumerate(_ARM_GAINS, 1)
    ]
    motors += [f'<adhesion name="{side}_grip" body="{side}_cup" ctrlrange="0 1" gain="40"/>' for side in ordered]
    home = " ".join(map(str, ARM_HOME_RAD * len(ordered)))
    return _filled("mobile_manipulator.xml", arms="\n".join(arms), motors="\n".join(motors), home=home)


def _filled(name: str, **values: object) -> str:
    """A file of this package with values in the places that it names."""
    return Template(files(__package__).joinpath(name).read_text(encoding="utf-8")).substitute(values)
