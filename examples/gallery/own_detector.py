"""Your own detector: any function from an image to keypoints, triangulated like every other.

Here an orange ball is found by its colour in four synthetic images. What you need per keypoint is a pixel, a score, and how
uncertain the pixel is; the covariance of the 3D point follows.
"""

from pathlib import Path

import cv2
import numpy as np

import posefuse as pf


def ball_px(image: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (x, y) of the orange pixels of an RGB image, and its standard deviation in px; NaN where there are none."""
    orange = (image[..., 0] > 180) & (image[..., 1] < 150) & (image[..., 2] < 90)
    rows, columns = np.nonzero(orange)
    if len(rows) < 5:
        return np.full(2, np.nan), np.nan
    return np.array([columns.mean(), rows.mean()]), 0.3


def images_of(rig: pf.Rig, xyz_m: np.ndarray, radius_m: float = 0.08) -> list[np.ndarray]:
    """What the cameras would see of an orange ball in a grey room."""
    images = []
    for one, xy in zip(rig, rig.project(xyz_m[None])[:, 0], strict=True):
        image = np.full((one.size_wh[1], one.size_wh[0], 3), 110, np.uint8)
        depth_m = float((one.cam_from_world @ xyz_m)[2])
        radius_px = one.K[0, 0] * radius_m / depth_m
        centre = (round(16 * float(xy[0])), round(16 * float(xy[1])))  # in sixteenths of a pixel, see `shift`
        cv2.circle(image, centre, round(16 * radius_px), (235, 110, 30), -1, cv2.LINE_AA, shift=4)
        images.append(image)
    return images


def main(session: Path) -> float:
    rig = pf.read_rig(session / "rig.toml")
    true_xyz = np.array([0.25, -0.1, 1.2])
    found = [ball_px(image) for image in images_of(rig, true_xyz)]
    xy_img = np.array([[xy] for xy, _ in found])
    sigma_px = np.array([[sigma] for _, sigma in found])
    xyz, cov, _ = rig.triangulate(xy_img, None, sigma_px)
    error_mm = 1000 * float(np.linalg.norm(xyz[0] - true_xyz))
    print(f"ball at {xyz[0].round(3)} m, off by {error_mm:.1f} mm, stated {1000 * np.sqrt(np.trace(cov[0])):.1f} mm")
    return error_mm


if __name__ == "__main__":
    main(Path("examples/demo"))
