"""Make docs/images/rviz.png: RViz itself, showing two walking people and four cameras.

    sudo python docs/make_rviz_picture.py

Needs ROS 1 and X without a screen (Debian: ros-base python3-rospy python3-tf2-ros rviz xvfb imagemagick), root for a
network namespace with nothing but loopback, and posefuse with its extra `ros`.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import posefuse_ros
from posefuse.core import SE3, SKELETONS, Camera, Pose3D, Rig
from posefuse_sim.cameras import looking_at

DOCS = Path(__file__).parent
CONFIG = Path(posefuse_ros.__file__).parent / "rviz" / "posefuse_ros1.rviz"
SCREEN = ":97"


def main() -> None:
    """Run roscore, the node, RViz on a virtual screen; keep one picture."""
    if len(sys.argv) == 3 and sys.argv[1] == "--walk":
        walk(sys.argv[2])
        return
    missing = [tool for tool in ("ip", "roscore", "rviz", "Xvfb", "import") if shutil.which(tool) is None]
    if missing or os.geteuid() != 0:
        sys.exit(f"needs root and {', '.join(missing) or 'nothing else'}")
    python = Path(shutil.which("roscore")).resolve().read_text().splitlines()[0].removeprefix("#!").split()[-1]
    ask = "import os, rospy; print(os.path.dirname(os.path.dirname(rospy.__file__)))"
    modules = subprocess.run([python, "-c", ask], capture_output=True, text=True, check=True).stdout.strip()
    space = f"pfview{os.getpid()}"
    subprocess.run(["ip", "netns", "add", space], check=True)
    subprocess.run(["ip", "-n", space, "link", "set", "lo", "up"], check=True)
    running = []
    with tempfile.TemporaryDirectory() as home:
        ros = {"ROS_MASTER_URI": "http://127.0.0.1:11311", "ROS_IP": "127.0.0.1", "ROS_HOME": home, "HOME": home}
        env = os.environ | ros | {"DISPLAY": SCREEN, "LIBGL_ALWAYS_SOFTWARE": "1", "QT_X11_NO_MITSHM": "1"}
        commands = [
            (["Xvfb", SCREEN, "-screen", "0", "1280x800x24"], 2),
            (["roscore"], 4),
            ([sys.executable, __file__, "--walk", modules], 2),
            (["rviz", "-d", str(CONFIG)], 20),
        ]
        try:
            for command, wait_s in commands:
                running.append(subprocess.Popen(["ip", "netns", "exec", space, *command], env=env))
                time.sleep(wait_s)
            target = DOCS / "images" / "rviz.png"
            target.parent.mkdir(exist_ok=True)
            shot = ["import", "-window", "root", "-colors", "128", f"png8:{target}"]
            subprocess.run(["ip", "netns", "exec", space, *shot], env=env, check=True)
            print(target)
        finally:
            for process in reversed(running):
                process.terminate()
                process.wait(20)
            subprocess.run(["ip", "netns", "del", space], check=True)


def walk(modules: str) -> None:
    """Publish two people in stride until stopped."""
    sys.path.append(modules)
    from posefuse_ros.ros1 import Ros1Node
    from posefuse_ros.ros_output import RosOutput

    with Ros1Node("posefuse") as node:
        output = RosOutput(node, four_cameras())
        output.start(time.time_ns())
        while True:
            now = time.time()
            people = [stride(5.0 * now, (0.0, 0.6), 0.4), stride(4.4 * now + 1, (0.6, -0.9), 2.2)]
            output.step(pose(time.time_ns(), np.array(people)))
            time.sleep(0.02)


def stride(phase: float, place: tuple[float, float], heading_rad: float) -> np.ndarray:
    """(17, 3) COCO keypoints of a walking person."""
    at = {"nose": (0.11, 0, 1.62)}
    for side, y, swing in (("left", 1, np.sin(phase)), ("right", -1, -np.sin(phase))):
        thigh, knee = 0.45 * swing, 0.25 + 0.45 * max(0.0, np.cos(phase if y > 0 else phase + np.pi))
        arm, elbow = -0.4 * swing, 0.5
        at |= {f"{side}_eye": (0.09, 0.035 * y, 1.66), f"{side}_ear": (0.0, 0.08 * y, 1.63)}
        shoulder = np.array([0, 0.19 * y, 1.42])
        elbow_at = shoulder + 0.29 * np.array([np.sin(arm), 0.12 * y, -np.cos(arm)])
        at |= {f"{side}_shoulder": shoulder, f"{side}_elbow": elbow_at}
        at[f"{side}_wrist"] = elbow_at + 0.26 * np.array([np.sin(arm + elbow), 0, -np.cos(arm + elbow)])
        hip = np.array([0, 0.1 * y, 0.93])
        knee_at = hip + 0.43 * np.array([np.sin(thigh), 0, -np.cos(thigh)])
        at |= {f"{side}_hip": hip, f"{side}_knee": knee_at}
        at[f"{side}_ankle"] = knee_at + 0.42 * np.array([np.sin(thigh - knee), 0, -np.cos(thigh - knee)])
    xyz = np.array([at[name] for name in SKELETONS["coco17"].keypoints], float)
    return SE3.from_rotvec([0, 0, heading_rad], [*place, 0.0]) @ xyz


def pose(t_ns: int, xyz_world: np.ndarray) -> Pose3D:
    """The people as fused values with 1 cm of uncertainty."""
    shape = xyz_world.shape[:2]
    cov = np.tile(np.eye(3) * 1e-4, (*shape, 1, 1))
    return Pose3D(
        t_ns=t_ns,
        skeleton=SKELETONS["coco17"],
        person_id=np.arange(1, 1 + shape[0]),
        xyz_world=xyz_world,
        cov_world=cov,
        reproj_px=np.ones(shape),
        n_views=np.full(shape, 4),
        kind=np.ones(shape),
    )


def four_cameras() -> Rig:
    """Cameras in the corners of a room."""
    cameras = []
    for i in range(4):
        angle = np.pi / 4 + i * np.pi / 2
        centre = np.array([3 * np.cos(angle), 3 * np.sin(angle), 2.3])
        intrinsics = np.array([[600, 0, 319.5], [0, 600, 239.5], [0, 0, 1.0]])
        pose = looking_at(centre, np.array([0, 0, 1.0]))
        cameras.append(Camera(name=f"cam{i + 1}", size_wh=(640, 480), K=intrinsics, cam_from_world=pose))
    return Rig(tuple(cameras))


if __name__ == "__main__":
    main()
