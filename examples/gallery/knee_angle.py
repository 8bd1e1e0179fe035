"""From a recording to the knee angle, with its uncertainty.

Track a session, ask for one joint angle, draw it. The session is the bundled clip: four cameras, one person who walks.
"""

from pathlib import Path

import posefuse as pf


def main(session: Path, out: Path) -> None:
    recording = pf.track(session, end_s=4.0)
    print(recording)

    knee = recording.joint_angles()["left_knee", "flexion"]
    print(f"left knee: {knee.deg.min():.0f} to {knee.deg.max():.0f} degrees, standard deviation {knee.sigma_deg.mean():.1f}")

    axes = recording.plot("left_knee", "flexion")
    recording.plot("right_knee", "flexion", axes=axes)
    axes.set_title("knee flexion, left and right")
    axes.legend()
    axes.figure.savefig(out / "knee_angle.png")


if __name__ == "__main__":
    folder = Path("out/gallery")
    folder.mkdir(parents=True, exist_ok=True)
    main(Path("examples/demo"), folder)
