"""From a recording to the knee angle, with its uncertainty.

Track a session, ask for one joint angle, draw it. The session is the bundled clip: four cameras, one person who walks.
"""

from pathlib import Path

from matplotlib import pyplot

import posefuse as pf


def main(session: Path, out: Path) -> None:
    recording = pf.track(session, end_s=4.0)
    print(recording)

    angles = recording.joint_angles()
    knee = angles["left_knee", "flexion"]
    print(f"left knee: {knee.deg.min():.0f} to {knee.deg.max():.0f} degrees, standard deviation {knee.sigma_deg.mean():.1f}")

    figure, axes = pyplot.subplots(figsize=(8, 3.6), layout="constrained")
    for side in ("left", "right"):
        knee = angles[f"{side}_knee", "flexion"]
        axes.plot(knee.t_s, knee.deg, label=f"{side} knee")
        axes.fill_between(knee.t_s, knee.deg - 2 * knee.sigma_deg, knee.deg + 2 * knee.sigma_deg, alpha=0.2)
    axes.set(title="knee flexion, left and right", xlabel="time [s]", ylabel="angle [deg]")
    axes.legend()
    figure.savefig(out / "knee_angle.png")


if __name__ == "__main__":
    folder = Path("out/gallery")
    folder.mkdir(parents=True, exist_ok=True)
    main(Path("examples/demo"), folder)
