"""Cameras of a scene: where they stand, lens, sensor and depth, and the rig they make."""

from __future__ import annotations

import math
from dataclasses import field, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic import Field

from posefuse.core import SE3, Camera, ConfigError, PosefuseError, Rig
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.foundation.settings import settings


@settings
class DepthSettings:
    """A stereo depth camera aligned with the colour image; see `render.shot.measured_depth` for the model.

    The defaults resemble a RealSense D435 at 848 x 480.

    Attributes:
        focal_px: of the depth imager. baseline_m: between its two lenses.
        disparity_sigma_px: error of a match. step_px: smallest step of the disparity; 0 for none.
        floor_m: error that does not grow with distance.
        lateral_px: how far off its place a pixel looks, one standard deviation.
        edge_loss: share of the pixels next to edges of depth that have no depth.
        reach_m: nothing is measured farther away.
    """

    focal_px: Annotated[float, Gt(0)] = 425.0
    baseline_m: Annotated[float, Gt(0), Le(10)] = 0.05
    disparity_sigma_px: Annotated[float, Ge(0)] = 0.08
    step_px: Annotated[float, Ge(0), Le(1)] = 1 / 32
    floor_m: Annotated[float, Ge(0)] = 0.003
    lateral_px: Annotated[float, Ge(0), Le(20)] = 0.8
    edge_loss: Annotated[float, Ge(0), Le(1)] = 0.5
    reach_m: Annotated[float, Gt(0), Le(65)] = 10.0


Point = tuple[float, float, float]
Row = tuple[float, float, float]
_UP = np.array([0.0, 0.0, 1.0])
_SQUARE_LEAST = 1e-6
_FARTHEST_M = 1e6
# the largest side of a framebuffer that OpenGL from 4.1 on demands of a driver
MOST_SIDE_PX = 16_384
# each camera is a video to render and a view to solve for: no room has more
MOST_CAMERAS = 1000
# frames per second, as for a whole scene
MOST_HZ = 1000


@settings
class ImageSettings:
    """Image and lens of a camera.

    Attributes:
        size_px: (width, height).
        horizontal_fov_deg: angle seen between the left and right edge by an ideal lens; K replaces it.
        K: 3x3 intrinsic matrix in px, pixel centres at integers.
        lens: ``pinhole`` or ``fisheye``, OpenCV's models.
        distortion: coefficients in OpenCV's order; the image is really bent by them.
    """

    size_px: tuple[Annotated[int, Ge(16), Le(MOST_SIDE_PX)], Annotated[int, Ge(16), Le(MOST_SIDE_PX)]] = (640, 480)
    horizontal_fov_deg: Annotated[float, Gt(0), Lt(150)] = 60.0
    K: tuple[Row, Row, Row] | None = None
    lens: Literal["pinhole", "fisheye"] = "pinhole"
    distortion: tuple[float, ...] = ()


@settings
class SensorSettings:
    """When and how well a camera records. The defaults are a perfect, synchronised global-shutter camera.

    Attributes:
        rate_hz: frames per second of its own clock; None takes the scene's.
        phase_s: first exposure after the start of the scene.
        offset_s: what its clock shows when the session clock shows 0; the time stamps carry it.
        drift_ppm: how much faster its clock runs than the session clock, in parts per million.
        jitter_s: standard deviation of the moment of exposure; the time stamps know it.
        drop_fraction: share of frames that are lost, at random.
        readout_s: rolling shutter, from first to last row; 0 is a global shutter.
        shutter_bands: horizontal bands in which a rolling shutter is rendered.
        exposure_s: how long each row is exposed; 0 freezes motion.
        blur_samples: moments that are averaged over the exposure.
        noise_dn: standard deviation of sensor noise at mid grey, in grey levels of 255.
        depth: the camera measures depth too; None: it does not.
    """

    rate_hz: Annotated[float, Gt(0), Le(MOST_HZ)] | None = None
    phase_s: Annotated[float, Ge(0)] = 0.0
    offset_s: float = 0.0
    drift_ppm: Annotated[float, Gt(-100_000), Lt(100_000)] = 0.0
    jitter_s: Annotated[float, Ge(0)] = 0.0
    drop_fraction: Annotated[float, Ge(0), Lt(1)] = 0.0
    readout_s: Annotated[float, Ge(0)] = 0.0
    shutter_bands: Annotated[int, Ge(2), Le(MOST_SIDE_PX)] = 8
    exposure_s: Annotated[float, Ge(0)] = 0.0
    blur_samples: Annotated[int, Ge(2), Le(1000)] = 5
    noise_dn: Annotated[float, Ge(0)] = 0.0
    depth: DepthSettings | None = None


@settings
class CameraOverride:
    """What one camera of a ring has of its own; None leaves what all have.

    Attributes:
        roll_deg: turn about the viewing direction, clockwise as seen from behind the camera.
    """

    image: ImageSettings | None = None
    sensor: SensorSettings | None = None
    roll_deg: float = 0.0


@settings
class RingCameras:
    """Cameras evenly on a circle, looking inwards; named cam00, cam01, ...

    Attributes:
        radius_m, height_m: of the circle. centre_m: (x, y) of its centre.
        look_at_m: the point all look at.
        first_angle_deg: direction of the first camera from the centre, from world x towards y.
        overrides: differences of single cameras, by name.
    """

    kind: Literal["ring"]
    count: Annotated[int, Ge(1), Le(MOST_CAMERAS)] = 4
    radius_m: Annotated[float, Gt(0)] = 4.5
    height_m: float = 2.2
    centre_m: tuple[float, float] = (0.0, 0.0)
    look_at_m: Point = (0.0, 0.0, 1.0)
    first_angle_deg: float = 20.0
    image: ImageSettings = ImageSettings()
    sensor: SensorSettings = SensorSettings()
    overrides: dict[str, CameraOverride] = field(default_factory=dict)


@settings
class PlacedCamera:
    """One camera where it is wanted.

    Attributes:
        roll_deg: turn about the viewing direction, clockwise as seen from behind the camera.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
    position_m: Point
    look_at_m: Point = (0.0, 0.0, 1.0)
    roll_deg: float = 0.0
    image: ImageSettings = ImageSettings()
    sensor: SensorSettings = SensorSettings()


@settings
class ListedCameras:
    """Every camera by itself."""

    kind: Literal["list"]
    cameras: Annotated[tuple[PlacedCamera, ...], MinLen(1), MaxLen(MOST_CAMERAS)]


CameraSettings = Annotated[RingCameras | ListedCameras, Field(discriminator="kind")]


def placed_cameras(settings_: RingCameras | ListedCameras) -> tuple[PlacedCamera, ...]:
    """The cameras one by one, whatever way they were given; raises ConfigError for an override of no camera."""
    if isinstance(settings_, ListedCameras):
        return settings_.cameras
    placed = {
        f"cam{i:02d}": PlacedCamera(
            name=f"cam{i:02d}",
            position_m=spot,
            look_at_m=settings_.look_at_m,
            image=settings_.image,
            sensor=settings_.sensor,
        )
        for i, spot in enumerate(_ring_spots(settings_))
    }
    for name, own in settings_.overrides.items():
        if name not in placed:
            raise ConfigError(f"cameras.overrides: no camera {name!r}; there are: {choices(placed)}")
        camera = placed[name]
        placed[name] = replace(camera, image=own.image or camera.image, sensor=own.sensor or camera.sensor, roll_deg=own.roll_deg)
    return tuple(placed.values())


def _ring_spots(ring: RingCameras) -> list[Point]:
    angles = np.deg2rad(ring.first_angle_deg) + 2 * np.pi * np.arange(ring.count) / ring.count
    x, y = ring.centre_m
    return [(x + ring.radius_m * float(np.cos(a)), y + ring.radius_m * float(np.sin(a)), ring.height_m) for a in angles]


def rig_from_cameras(placed: tuple[PlacedCamera, ...]) -> Rig:
    """The exact rig; raises ConfigError naming the camera whose name, lens, matrix or direction cannot be."""
    try:
        return Rig(tuple(_camera(one) for one in placed), world_set_by="simulated", residual_px=0.0)
    except PosefuseError as error:
        raise ConfigError(f"cameras: {error}") from None


def _camera(placed: PlacedCamera) -> Camera:
    width, height = placed.image.size_px
    focal = width / 2 / np.tan(np.deg2rad(placed.image.horizontal_fov_deg) / 2)
    intrinsics = placed.image.K or [[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]]
    return Camera(
        name=placed.name,
        size_wh=(width, height),
        K=np.array(intrinsics),
        cam_from_world=_cam_from_world(placed),
        distortion=np.array(placed.image.distortion),
        model=placed.image.lens,
        readout_s=placed.sensor.readout_s,
    )


def _cam_from_world(placed: PlacedCamera) -> SE3:
    try:
        return looking_at(np.array(placed.position_m), np.array(placed.look_at_m), float(np.deg2rad(placed.roll_deg)))
    except ConfigError as error:
        raise ConfigError(f"camera {placed.name}: {error}") from None


def looking_at(centre: Array, point: Array, roll_rad: float = 0.0) -> SE3:
    """cam_from_world of a camera at `centre` (3,) whose axis passes through `point` (3,), the top of its image up.

    roll_rad: turn about the viewing direction, clockwise as seen from behind the camera.
    """
    distance = math.dist(centre, point)
    if distance < _SQUARE_LEAST:
        raise ConfigError(f"look_at_m is its own position {tuple(centre.tolist())}; give another point")
    if not distance < _FARTHEST_M:
        raise ConfigError(f"expected a position within {_FARTHEST_M:g} m of look_at_m, got {tuple(centre.tolist())}")
    forward = (point - centre) / distance
    # straight up or down has no horizon: take world y as the top of the image
    reference = _UP if np.linalg.norm(np.cross(forward, _UP)) > _SQUARE_LEAST else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, reference)
    right = right / np.linalg.norm(right)
    down = np.cross(forward, right)
    # a camera turned clockwise: its right axis moves towards what was down
    turned_right = np.cos(roll_rad) * right + np.sin(roll_rad) * down
    rotation: Array = np.stack([turned_right, np.cross(forward, turned_right), forward])
    return SE3.from_matrix(rotation, -rotation @ centre)
