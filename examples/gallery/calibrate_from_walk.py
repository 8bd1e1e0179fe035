"""Calibrate from a walk: no board, no marker object, only a person of known height who walks where all cameras see them.

The intrinsics are known (from a board, or from the camera's maker); the walk gives where the cameras are. Here the true rig of
the bundled clip supplies the intrinsics, and shows afterwards how far off the poses are.
"""

from itertools import combinations
from pathlib import Path

import numpy as np
from matplotlib import pyplot

import posefuse as pf

HEIGHT_M = 1.78


def main(session: Path, out: Path) -> float:
    true_rig = pf.read_rig(session / "rig.toml")
    videos = {name: session / "videos" / f"{name}.mp4" for name in true_rig.names}
    found = pf.calibrate_person(videos, intrinsics=true_rig, height_m=HEIGHT_M)
    found.save(out / "rig.toml", report=out / "calibration.html")

    errors = []
    for one, other in combinations(range(len(true_rig)), 2):
        distance_m, true_m = (
            np.linalg.norm(rig.centres_world()[one] - rig.centres_world()[other]) for rig in (found.rig, true_rig)
        )
        errors.append(abs(distance_m / true_m - 1))
        print(f"{true_rig.names[one]} to {true_rig.names[other]}: {distance_m:.3f} m, true {true_m:.3f} m")

    figure, axes = pyplot.subplots(figsize=(4.5, 4.5), layout="constrained")
    for camera in found.rig:
        x, y, _ = camera.centre_world
        ahead = camera.cam_from_world.matrix()[2, :2]
        axes.annotate("", (x + ahead[0], y + ahead[1]), (x, y), arrowprops={"arrowstyle": "->"})
        axes.plot(x, y, "o")
        axes.text(x, y, f"  {camera.name}")
    axes.set(title="cameras from above, found from a walk", xlabel="x (m)", ylabel="y (m)", aspect="equal")
    figure.savefig(out / "calibrate_from_walk.png")
    return 100 * float(np.mean(errors))


if __name__ == "__main__":
    folder = Path("out/gallery")
    folder.mkdir(parents=True, exist_ok=True)
    print(f"distances between the cameras: {main(Path('examples/demo'), folder):.1f} % off on average")
