"""Names that OpenSim uses for joint angles, as names of posefuse with a sign.

Coordinates of the full-body models of OpenSim (Rajagopal et al. 2016): axes X forward, Y up, Z to the right, so a positive
rotation of the pelvis about Z tilts it backward. Sides are ``_r`` and ``_l``; flexion, adduction and internal rotation are
positive on both.
"""

from __future__ import annotations

from types import MappingProxyType

_BOTH_SIDES = {
    "hip_flexion": ("hip", "flexion", 1),
    "hip_adduction": ("hip", "adduction", 1),
    "hip_rotation": ("hip", "internal_rotation", 1),
    "knee_angle": ("knee", "flexion", 1),
    "ankle_angle": ("ankle", "dorsiflexion", 1),
    "subtalar_angle": ("ankle", "inversion", 1),
    "arm_flex": ("arm", "flexion", 1),
    "arm_add": ("arm", "adduction", 1),
    "arm_rot": ("arm", "internal_rotation", 1),
    "elbow_flex": ("elbow", "flexion", 1),
    "pro_sup": ("wrist", "pronation", 1),
    "wrist_flex": ("wrist", "flexion", 1),
    "wrist_dev": ("wrist", "ulnar_deviation", 1),
}
_TRUNK = {
    "pelvis_tilt": ("pelvis", "tilt_forward", -1),
    "pelvis_list": ("pelvis", "obliquity_right_down", 1),
    "pelvis_rotation": ("pelvis", "rotation_left", 1),
    "lumbar_extension": ("trunk", "flexion", -1),
    "lumbar_bending": ("trunk", "bend_right", 1),
    "lumbar_rotation": ("trunk", "rotation_left", 1),
}
OPENSIM = MappingProxyType(
    _TRUNK
    | {
        f"{name}_{side[0]}": (f"{side}_{joint}", angle, sign)
        for side in ("left", "right")
        for name, (joint, angle, sign) in _BOTH_SIDES.items()
    }
)
"""OpenSim's name -> joint, angle and sign: ``angles["pelvis_tilt"]`` is minus ``angles["pelvis", "tilt_forward"]``."""
