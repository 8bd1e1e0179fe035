"""Make docs/images/ros_hands.png: the frames of head, wrists and hands of a person with the hands forward, palms down.

python docs/make_hand_picture.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from posefuse.core import SKELETONS, Pose3D
from posefuse_ros.bodies import PARTS, bodies_from_pose, parts_from_pose

DOCS = Path(__file__).parent
SKELETON = SKELETONS["blazepose33"]
RIGHT = {
    "shoulder": (0, -0.2, 1.4), "elbow": (0.18, -0.26, 1.2), "wrist": (0.42, -0.22, 1.3), "hip": (0, -0.1, 0.95),
    "knee": (0.02, -0.1, 0.52), "ankle": (0, -0.1, 0.1), "ear": (0, -0.08, 1.62), "index": (0.52, -0.19, 1.3),
    "pinky": (0.51, -0.26, 1.3), "eye": (0.08, -0.03, 1.65),
}  # fmt: skip


def person() -> Pose3D:
    """Who stands at the origin and looks along x."""
    at = {"nose": (0.11, 0, 1.6)}
    for part, (x, y, z) in RIGHT.items():
        at |= {f"right_{part}": (x, y, z), f"left_{part}": (x, -y, z)}
    xyz = np.array([[at.get(name, (np.nan,) * 3) for name in SKELETON.keypoints]], float)
    k, seen = len(SKELETON), np.isfinite(xyz[..., 0])
    return Pose3D(
        t_ns=0, skeleton=SKELETON, person_id=[1], xyz_world=xyz, cov_world=np.tile(np.eye(3) * 1e-4, (1, k, 1, 1)),
        reproj_px=np.ones((1, k)), n_views=np.where(seen, 3, 0), kind=seen.astype(int),
    )  # fmt: skip


def main() -> None:
    """One picture from the front left."""
    pose = person()
    parts = parts_from_pose(pose, bodies_from_pose(pose))
    figure = plt.figure(figsize=(9, 7.5), dpi=110)
    axes = figure.add_subplot(projection="3d", proj_type="ortho")
    for a, b in SKELETON.bone_indices:
        axes.plot(*pose.xyz_world[0, [a, b]].T, color="#8a93a0", linewidth=3, solid_capstyle="round")
    for p, name in enumerate(PARTS):
        origin, rotation = parts.xyz[0, p], parts[0, p].matrix()
        for axis, colour in zip(rotation.T, ("#d03a2b", "#2f9e44", "#1c6fd1"), strict=True):
            axes.plot(*np.stack([origin, origin + 0.13 * axis]).T, color=colour, linewidth=2.6)
        # below the frame of a wrist, above the others
        axes.text(*(origin + [0.03, 0, -0.12 if "wrist" in name else 0.17]), name, fontsize=10, ha="center")
    axes.set_xlim(-0.3, 0.7)
    axes.set_ylim(-0.5, 0.5)
    axes.set_zlim(0.85, 1.85)
    axes.set_box_aspect((1, 1, 1))
    axes.view_init(elev=24, azim=38)
    axes.set(xlabel="x, m (forward)", ylabel="y, m (left)", zlabel="z, m (up)")
    axes.set_title("Axes x red, y green, z blue: hands forward, palms down")
    figure.tight_layout()
    figure.savefig(DOCS / "images" / "ros_hands.png")


if __name__ == "__main__":
    main()
