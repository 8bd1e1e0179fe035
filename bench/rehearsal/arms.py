"""Robots of the fault bench besides our own: an arm of six joints that stands fixed."""

from __future__ import annotations

# axis, range rad, gain N m/rad, offset of the next joint m, radius m, mass kg: about a collaborative robot of 5 kg payload
_LINKS = (
    ("0 0 1", 6.28, 8000, "0 0 0.16", 0.06, 3.7),
    ("0 1 0", 3.1, 8000, "0 0 0.42", 0.055, 8.0),
    ("0 1 0", 2.9, 8000, "0 0 0.39", 0.05, 2.3),
    ("0 1 0", 3.1, 2000, "0 0.12 0", 0.042, 1.2),
    ("0 0 1", 6.28, 1500, "0 0 0.1", 0.04, 1.2),
    ("0 1 0", 6.28, 800, "0 0.1 0", 0.035, 0.3),
)
_HOME_RAD = (0.0, -0.5, 2.0, 0.1, 1.5708, 0.0)


def fixed_arm() -> str:
    """MJCF text of an arm of six joints on a pedestal; its hand is the site ``right_hand``."""
    body = '<site name="right_hand" pos="0 0.02 0" size="0.01"/>'
    for i, (axis, most, _, offset, radius, mass) in reversed(list(enumerate(_LINKS, 1))):
        place = "0 0 0.6" if i == 1 else _LINKS[i - 2][3]
        body = (
            f'<body name="link{i}" pos="{place}" gravcomp="1">'
            f'<joint name="j{i}" axis="{axis}" range="{-most} {most}" limited="true" armature="0.1"/>'
            f'<geom name="link{i}" type="capsule" size="{radius}" fromto="0 0 0 {offset}" mass="{mass}"/>'
            f"{body}</body>"
        )
    body = body.replace('pos="0 0.02 0"', f'pos="{_LINKS[-1][3]}"')
    drives = "".join(f'<position name="j{i}" joint="j{i}" kp="{link[2]}" dampratio="1"/>' for i, link in enumerate(_LINKS, 1))
    return f"""<mujoco model="fixed arm">
  <compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>
  <worldbody><geom name="floor" type="plane" size="6 6 0.1"/>
    <body name="pedestal"><geom name="pedestal" type="cylinder" size="0.1 0.28" pos="0 0 0.28"/>{body}</body></worldbody>
  <actuator>{drives}</actuator>
  <keyframe><key name="home" qpos="{" ".join(map(str, _HOME_RAD))}"/></keyframe>
</mujoco>"""
