"""Draw the pictures of docs/simulation.md: python docs/make_simulation_pictures.py"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from posefuse_sim import Scene, read_scene
from posefuse_sim.build import live_scene
from posefuse_sim.cameras import ListedCameras
from posefuse_sim.exact import flesh_of_points
from posefuse_sim.render.model import render_model
from posefuse_sim.render.shot import CameraShooter, exposed, noise_seed
from posefuse_sim.render.stage import RenderStage, working_backend

_SCENES = Path(__file__).resolve().parents[1] / "examples" / "scenes"
_IMAGES = Path(__file__).resolve().parent / "images"
_TILE_WH = (480, 360)
_SEEN, _HIDDEN = (60, 220, 60), (230, 40, 40)
_FRACTION_BITS = 3


def pictures(scene: Scene, after_s: float, cameras: int, with_truth: bool) -> list[np.ndarray]:
    """RGB pictures of the first cameras, `after_s` into the scene, the truth as dots: green seen, red hidden."""
    live = live_scene(scene)
    backend = working_backend()
    stage = RenderStage(render_model(live, live.rig.cameras[:cameras], backend), backend)
    drawn = []
    for c in range(cameras):
        frame = int(np.argmin(np.abs(live.shots[c].t_ns / 1e9 - scene.start_s - after_s)))
        shooter = CameraShooter(live.rig.cameras[c], live.placed[c].sensor, stage)
        poses, seen = exposed(live, c, slice(frame, frame + 1))
        points = seen.xyz_world[0], seen.possible[0], flesh_of_points(live)
        shot = shooter.shoot(poses[0], *points, noise_seed(live, c, frame))
        if with_truth:
            _dot(shot.image, seen.xy_img[0], shot.visible)
        drawn.append(shot.image)
    stage.close()
    return drawn


def _dot(image: np.ndarray, xy_img: np.ndarray, visible: np.ndarray) -> None:
    inside = np.isfinite(xy_img).all(axis=1) & (np.abs(np.nan_to_num(xy_img)) < 4000).all(axis=1)
    for xy, seen in zip(xy_img[inside], visible[inside], strict=True):
        centre = tuple(int(v) for v in np.round(xy * 2**_FRACTION_BITS))
        radius = max(2, image.shape[1] // 200)
        cv2.circle(image, centre, radius << _FRACTION_BITS, _SEEN if seen else _HIDDEN, -1, cv2.LINE_AA, _FRACTION_BITS)


def _write(name: str, rows: list[list[np.ndarray]]) -> None:
    sheet = np.vstack([np.hstack([_fitted(image) for image in row]) for row in rows])
    path = _IMAGES / f"{name}.jpg"
    cv2.imwrite(str(path), sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
    print(path.name, f"{path.stat().st_size // 1024} kB")


def _fitted(image: np.ndarray) -> np.ndarray:
    """The image on a tile of one size, nothing stretched."""
    height, width = image.shape[:2]
    scale = min(_TILE_WH[0] / width, _TILE_WH[1] / height)
    small = cv2.resize(image, (round(width * scale), round(height * scale)), interpolation=cv2.INTER_AREA)
    tile = np.full((_TILE_WH[1], _TILE_WH[0], 3), 255, np.uint8)
    top, left = (_TILE_WH[1] - small.shape[0]) // 2, (_TILE_WH[0] - small.shape[1]) // 2
    tile[top : top + small.shape[0], left : left + small.shape[1]] = small
    return tile


def _with_first_camera(scene: Scene, image: dict[str, object], sensor: dict[str, object]) -> Scene:
    """The scene seen by its camera `rolling` alone, changed."""
    assert isinstance(scene.cameras, ListedCameras)
    camera = next(one for one in scene.cameras.cameras if one.name == "rolling")
    changed = dataclasses.replace(
        camera,
        image=dataclasses.replace(camera.image, **image),
        sensor=dataclasses.replace(camera.sensor, drop_fraction=0, **sensor),
    )
    return dataclasses.replace(scene, cameras=dataclasses.replace(scene.cameras, cameras=(changed,)))


def main() -> None:
    """Draw all of them."""
    _IMAGES.mkdir(exist_ok=True)
    demo = pictures(read_scene(_SCENES / "demo.yaml"), 1.0, 4, with_truth=True)
    _write("simulation_demo", [demo[:2], demo[2:]])
    occluded = pictures(read_scene(_SCENES / "tpose_8cam_occluded.yaml"), 0.0, 4, with_truth=True)
    two = pictures(read_scene(_SCENES / "two_people.yaml"), 4.0, 2, with_truth=True)
    _write("simulation_occluded", [occluded[:2], [occluded[2], two[0]]])
    cube = pictures(read_scene(_SCENES / "calibration_cube.yaml"), 3.0, 2, with_truth=False)
    _write("simulation_cube", [cube])
    faults = read_scene(_SCENES / "faults.yaml")
    perfect = {"readout_s": 0.0, "exposure_s": 0.0}
    lenses = [
        _with_first_camera(faults, {"distortion": ()}, perfect),
        _with_first_camera(faults, {"distortion": (-0.3, 0.09, 0.0, 0.0)}, perfect),
        _with_first_camera(faults, {}, {"readout_s": 0.25, "shutter_bands": 90, "exposure_s": 0.0}),
        _with_first_camera(faults, {}, {"readout_s": 0.0, "exposure_s": 0.12, "blur_samples": 24, "noise_dn": 12.0}),
    ]
    shown = [pictures(scene, 1.0, 1, with_truth=False)[0] for scene in lenses]
    _write("simulation_lens", [shown[:2], shown[2:]])


if __name__ == "__main__":
    main()
