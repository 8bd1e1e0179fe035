"""Live in 15 lines: skeletons while they happen.

Here the cameras are video files played at their own speed; with real cameras write ``"usb:0"`` or ``"rtsp://..."`` instead.
"""

from pathlib import Path

import posefuse as pf


def main(session: Path, seconds: float) -> int:
    rig = pf.read_rig(session / "rig.toml")
    sources = {name: f"video:{session / 'videos' / name}.mp4" for name in rig.names}
    wrist, poses = 15, 0
    with pf.live(rig, sources, duration_s=seconds) as live:
        for pose in live:
            poses += 1
            for person, xyz in zip(pose.person_id, pose.xyz_world, strict=True):
                if poses % 50 == 0:
                    print(f"person {person}: left wrist at {xyz[wrist].round(2)} m, {len(live.cameras)} cameras")
    return poses


if __name__ == "__main__":
    print(main(Path("examples/demo"), 6.0), "poses")
