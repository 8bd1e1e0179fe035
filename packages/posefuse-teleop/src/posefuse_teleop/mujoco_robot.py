"""A robot in MuJoCo: joints driven by the model's own actuators, physics at the model's time step; and our own one as MJCF.

Ours is a planar base with one or two arms of seven joints, of primitives only. At zero the arm points straight up; joints turn
about z, y, z, y, z, y, z from the shoulder to the hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
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
_BASE_KP, _BASE_TURN_KP = 3e5, 3e4
# joint: axis, range rad, position gain N m/rad, body offset m, capsule end m and radius m, mass kg
_LINKS = (
    ("0 0 1", 2.8, 8000, 0.0, 0.28, 0.06, 3.5),
    ("0 1 0", 1.9, 8000, 0.28, 0.17, 0.055, 3.0),
    ("0 0 1", 2.8, 5000, 0.17, 0.18, 0.05, 2.5),
    ("0 1 0", 2.6, 5000, 0.18, 0.17, 0.05, 2.5),
    ("0 0 1", 2.8, 1500, 0.17, 0.18, 0.042, 1.5),
    ("0 1 0", 2.4, 1500, 0.18, 0.08, 0.042, 1.0),
    ("0 0 1", 2.9, 600, 0.08, 0.06, 0.035, 0.5),
)


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
    mounts = {1: (0.0,), 2: (-0.2, 0.2)}[len(hands)]
    ordered = sorted(hands, key=lambda side: side != "right")
    arms = "".join(_arm(side, y) for side, y in zip(ordered, mounts, strict=True))
    joints = [f"{side}_j{i}" for side in ordered for i in range(1, 8)]
    arm_motors = "".join(
        f'<position name="{name}" joint="{name}" kp="{_LINKS[int(name[-1]) - 1][2]}" dampratio="1"/>' for name in joints
    )
    cups = "".join(f'<adhesion name="{side}_grip" body="{side}_cup" ctrlrange="0 1" gain="40"/>' for side in ordered)
    wheels = "".join(_wheel(x, y) for x in (0.12, -0.3) for y in (0.25, -0.25))
    home = " ".join(map(str, (0, 0, 0, *(ARM_HOME_RAD * len(ordered)))))
    return f"""<mujoco model="posefuse mobile manipulator">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <visual><global offwidth="1920" offheight="1080"/><headlight ambient="0.45 0.45 0.45"/></visual>
  <asset>
    <texture type="skybox" builtin="gradient" rgb1="0.82 0.88 0.95" rgb2="0.97 0.98 1" width="64" height="384"/>
    <texture name="grid" type="2d" builtin="checker" rgb1="0.86 0.87 0.88" rgb2="0.8 0.81 0.83" width="256" height="256"/>
    <material name="grid" texture="grid" texrepeat="12 12"/>
    <material name="shell" rgba="0.93 0.94 0.95 1"/><material name="dark" rgba="0.25 0.28 0.32 1"/>
  </asset>
  <worldbody>
    <light pos="0 0 4" dir="0 0 -1" diffuse="0.5 0.5 0.5"/>
    <geom name="floor" type="plane" size="6 6 0.1" material="grid"/>
    <body name="base" pos="0 0 0" gravcomp="1">
      <joint name="base_x" type="slide" axis="1 0 0"/><joint name="base_y" type="slide" axis="0 1 0"/>
      <joint name="base_yaw" type="hinge" axis="0 0 1"/>
      <geom name="base" type="box" size="0.32 0.25 0.14" pos="-0.1 0 0.2" mass="70" material="dark"/>
      <geom name="column" type="cylinder" size="0.09 0.05" pos="0.05 0 0.38" mass="8" material="shell"/>
      {wheels}
      {arms}
    </body>
  </worldbody>
  <actuator>
    <position name="base_x" joint="base_x" kp="{_BASE_KP:g}" dampratio="1"/>
    <position name="base_y" joint="base_y" kp="{_BASE_KP:g}" dampratio="1"/>
    <position name="base_yaw" joint="base_yaw" kp="{_BASE_TURN_KP:g}" dampratio="1"/>
    {arm_motors}{cups}
  </actuator>
  <keyframe><key name="home" qpos="{home}"/></keyframe>
</mujoco>"""


def _wheel(x: float, y: float) -> str:
    look = 'euler="1.5708 0 0" mass="1" rgba="0.1 0.1 0.1 1" contype="0" conaffinity="0"'
    return f'<geom type="cylinder" size="0.06 0.02" pos="{x} {y} 0.06" {look}/>'


def _arm(side: str, y: float) -> str:
    text, closing = "", ""
    for i, (axis, most, _, offset, end, radius, mass) in enumerate(_LINKS, 1):
        place = f"0.05 {y} 0.43" if i == 1 else f"0 0 {offset}"
        material = "shell" if i % 2 else "dark"
        text += (
            f'<body name="{side}_link{i}" pos="{place}" gravcomp="1">'
            f'<joint name="{side}_j{i}" axis="{axis}" range="{-most} {most}" limited="true" armature="0.1"/>'
            f'<geom name="{side}_link{i}" type="capsule" size="{radius}" fromto="0 0 0 0 0 {end}" mass="{mass}" '
            f'material="{material}"/>'
        )
        closing += "</body>"
    cup = (
        f'<body name="{side}_cup" pos="0 0 0.1" gravcomp="1">'
        f'<geom name="{side}_cup" type="cylinder" size="0.03 0.02" mass="0.1" rgba="0.95 0.55 0.15 1" friction="1.5 0.1 0.01"/>'
        f'<site name="{side}_hand" pos="0 0 0.02" size="0.01" rgba="1 0.2 0.2 1"/></body>'
    )
    return text + cup + closing
