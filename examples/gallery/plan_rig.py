"""Plan a rig before a camera is bought: how exact will it be, and where?

Put cameras on a ring, project points of the room into them, and read the covariance of the triangulated points. Two rigs are
compared: four cameras all around, and four along one wall.
"""

from pathlib import Path

import numpy as np
from matplotlib import pyplot

import posefuse as pf
from posefuse.core import SE3

# edit these for your own rig: positions in metres, and what a network is off by in px, standard deviation per axis
AROUND = [(4.0 * np.cos(a), 4.0 * np.sin(a), 2.3) for a in np.deg2rad([45, 135, 225, 315])]
WALL = [(x, -4.0, 2.3) for x in (-3.0, -1.0, 1.0, 3.0)]
SIGMA_PX = 3.0


def camera(name: str, position_m: tuple[float, float, float], target_m: tuple[float, float, float] = (0, 0, 1)) -> pf.Camera:
    """A 640x480 camera of 60 degrees at a place in the room, looking at a point."""
    forward = np.subtract(target_m, position_m)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    focal_px = 320 / np.tan(np.deg2rad(30))
    intrinsics = np.array([[focal_px, 0, 319.5], [0, focal_px, 239.5], [0, 0, 1]])
    return pf.Camera(
        name=name, size_wh=(640, 480), K=intrinsics, cam_from_world=SE3.from_matrix(rotation, -rotation @ position_m)
    )


def expected_error_mm(rig: pf.Rig, xyz_m: np.ndarray) -> np.ndarray:
    """Root mean square error of points (..., 3), NaN where fewer than two cameras see them."""
    xy = rig.project(xyz_m.reshape(-1, 3))
    inside = ((xy >= 0) & (xy < (640, 480))).all(axis=-1)
    score = np.where(inside, 1.0, 0.0)
    _, cov, _ = rig.triangulate(xy, score, np.full(score.shape, SIGMA_PX))
    return 1000 * np.sqrt(np.trace(cov, axis1=-2, axis2=-1)).reshape(xyz_m.shape[:-1])


def main(out: Path) -> dict[str, float]:
    x, y = np.meshgrid(np.linspace(-2, 2, 41), np.linspace(-2, 2, 41))
    grid = np.stack([x, y, np.ones_like(x)], axis=-1)

    figure, axes = pyplot.subplots(1, 2, figsize=(9, 4.2), layout="constrained")
    medians = {}
    for one, (name, places) in zip(axes, {"around": AROUND, "along a wall": WALL}.items(), strict=True):
        rig = pf.Rig(tuple(camera(f"cam{i}", place) for i, place in enumerate(places)))
        error = expected_error_mm(rig, grid)
        medians[name] = float(np.nanmedian(error))
        image = one.imshow(error, extent=(-2, 2, -2, 2), origin="lower", vmin=5, vmax=40, cmap="viridis_r")
        one.set_title(f"{name}: median {medians[name]:.0f} mm")
        one.set_xlabel("x [m]")
        one.set_ylabel("y [m]")
    figure.colorbar(image, ax=axes, label="expected error at 1 m height [mm]")
    figure.savefig(out / "plan_rig.png")
    return medians


if __name__ == "__main__":
    folder = Path("out/gallery")
    folder.mkdir(parents=True, exist_ok=True)
    for name, median_mm in main(folder).items():
        print(f"{name}: median {median_mm:.0f} mm")
    print(f"drawn in {folder / 'plan_rig.png'}; edit the numbers at the top for your own rig")
