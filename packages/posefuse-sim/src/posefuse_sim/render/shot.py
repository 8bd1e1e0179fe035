"""One frame of one camera: lens, rolling shutter, motion blur, sensor noise, and which points it sees."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields

import cv2
import numpy as np

from posefuse.core import Camera
from posefuse.core.arrays import Array
from posefuse.core.depth import MM_PER_M, DepthImage, DepthNoise
from posefuse.core.ideal_image import IdealOptics, SourceView, optics_of
from posefuse.core.se3 import wxyz_from_matrix
from posefuse_sim.build import LiveScene
from posefuse_sim.cameras import DepthSettings, SensorSettings
from posefuse_sim.exact import SeenPoints, seen_points

from .stage import RenderStage

_MID_GREY = 118.0
_PAD_PX = 2
_DEPTH_SEED = 7
# width of the blocks that a stereo camera matches, over which errors are alike
_BLOCK_PX = 5.0


@dataclass(frozen=True)
class ExposureMoment:
    """What is exposed when, as one image to draw.

    Attributes:
        first_row, last_row: rows of the image, last one excluded. after_s: since the frame's mid-exposure.
        middle: whether it is the middle of those rows' exposure.
    """

    first_row: int
    last_row: int
    after_s: float
    middle: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class Shot:
    """One frame.

    Attributes:
        image: (H, W, 3) uint8 RGB. visible: (Q,) which points it shows.
        depth: as the camera measures it at mid-exposure; None from a camera without depth.
    """

    image: Array
    visible: Array
    depth: DepthImage | None


def body_poses(live: LiveScene, t_s: Array) -> Array:
    """(T, M, 7) poses of everything that moves, in the renderer's order: bones of all people, from rest, then props."""
    parts = []
    for bones in live.bones(t_s):
        parts.append(np.concatenate([bones[..., :3, 3], wxyz_from_matrix(bones[..., :3, :3])], axis=-1))
    for pose in live.prop_poses(t_s):
        parts.append(np.concatenate([pose.xyz, pose.wxyz], axis=-1)[:, None])
    return np.concatenate(parts, axis=1) if parts else np.zeros((len(t_s), 0, 7))


def exposed(live: LiveScene, camera_index: int, frames: slice) -> tuple[Array, SeenPoints]:
    """Poses (F, moments, M, 7) of everything that moves while these frames are exposed, and the points that are looked for."""
    moments = moments_of(live.placed[camera_index].sensor, live.rig.cameras[camera_index].size_wh[1])
    t_s = live.shots[camera_index].t_ns[frames, None] / 1e9 + np.array([moment.after_s for moment in moments])
    poses = body_poses(live, t_s.ravel())
    return poses.reshape(*t_s.shape, *poses.shape[1:]), seen_points(live, camera_index, frames)


def noise_seed(live: LiveScene, camera_index: int, frame: int) -> list[int]:
    """The numbers that the noise of a frame is drawn from."""
    return [live.scene.seed, 41, camera_index, int(live.shots[camera_index].seq[frame])]


def moments_of(sensor: SensorSettings, height: int) -> tuple[ExposureMoment, ...]:
    """The images that make one frame: bands of a rolling shutter times samples of the exposure."""
    bands = min(sensor.shutter_bands, height) if sensor.readout_s else 1
    edges = np.round(np.linspace(0, height, bands + 1)).astype(int)
    samples = sensor.blur_samples if sensor.exposure_s else 1
    within = sensor.exposure_s * ((np.arange(samples) + 0.5) / samples - 0.5)
    moments = []
    for first, last in itertools.pairwise(edges):
        row_share = ((first + last - 1) / 2) / max(height - 1, 1) - 0.5
        for i, after in enumerate(within):
            moments.append(ExposureMoment(int(first), int(last), float(sensor.readout_s * row_share + after), i == samples // 2))
    return tuple(moments)


class CameraShooter:
    """Draws the frames of one camera on a stage."""

    def __init__(self, camera: Camera, sensor: SensorSettings, stage: RenderStage) -> None:
        self._camera, self._sensor, self._stage = camera, sensor, stage
        self._optics = optics_of(camera)
        self.moments = moments_of(sensor, camera.size_wh[1])

    def shoot(self, poses: Array, xyz_world: Array, possible: Array, flesh_m: Array, noise_seed: list[int]) -> Shot:
        """One frame.

        Args:
            poses: (moments, M, 7) world poses of all moving bodies.
            xyz_world: (Q, 3) points to look for. possible: (Q,) which may be seen at all. flesh_m: (Q,), see `surroundings`.
            noise_seed: numbers the sensor noise is drawn from.
        """
        width, height = self._camera.size_wh
        total = np.zeros((height, width, 3), np.float32)
        count = np.zeros(height)
        visible = np.zeros(len(xyz_world), bool)
        depth_m = np.full((height, width), np.nan, np.float32)
        row = np.nan_to_num(self._camera.project(xyz_world)[:, 1], nan=-1.0)
        for moment, bodies in zip(self.moments, poses, strict=True):
            self._stage.place(bodies)
            band, band_depth_m, view, depth = self._draw(moment)
            total[moment.first_row : moment.last_row] += band
            count[moment.first_row : moment.last_row] += 1
            if moment.middle:
                here = possible & (row >= moment.first_row - 0.5) & (row < moment.last_row - 0.5)
                visible |= here & self._not_hidden(xyz_world, flesh_m, view, depth)
                depth_m[moment.first_row : moment.last_row] = band_depth_m
        image = total / count[:, None, None]
        measures = self._sensor.depth
        measured = None if measures is None else measured_depth(depth_m, measures, [*noise_seed, _DEPTH_SEED])
        return Shot(image=self._with_noise(image, noise_seed), visible=visible, depth=measured)

    def _draw(self, moment: ExposureMoment) -> tuple[Array, Array, SourceView, Array]:
        """The rows of one moment (h, W, 3) and their depth (h, W), and the ideal image they come from with its depth."""
        rows = slice(moment.first_row, moment.last_row)
        view, map_px = _view_of_rows(self._optics, rows)
        rgb, depth = self._stage.draw(view, self._camera.cam_from_world)
        if map_px is None:
            return rgb, depth, view, depth
        # outside what the lens shows the map is NaN, which is drawn black
        outside = np.nan_to_num(map_px, nan=-10.0)
        bent = cv2.remap(np.ascontiguousarray(rgb), outside[..., 0], outside[..., 1], cv2.INTER_LINEAR)
        # depths of two surfaces are not mixed
        deep = cv2.remap(np.ascontiguousarray(depth), outside[..., 0], outside[..., 1], cv2.INTER_NEAREST, borderValue=np.nan)
        return bent, deep, view, depth

    def _not_hidden(self, xyz_world: Array, flesh_m: Array, view: SourceView, depth: Array) -> Array:
        xyz_cam = self._camera.cam_from_world @ xyz_world
        ahead = np.maximum(xyz_cam[:, 2], 1e-6)
        norm = xyz_cam[:, :2] / ahead[:, None]
        column, row = np.round(view.px_from_norm(norm)).astype(int).T
        surface = depth[np.clip(row, 0, view.height - 1), np.clip(column, 0, view.width - 1)]
        # from depth along the axis to distance along the ray
        before_m = (ahead - surface) * np.sqrt(1 + (norm**2).sum(axis=-1))
        return np.asarray(before_m <= flesh_m)

    def _with_noise(self, image: Array, seed: list[int]) -> Array:
        if self._sensor.noise_dn:
            rng = np.random.default_rng(seed)
            # photons: the variance grows with the light; a floor stays in the dark
            spread = self._sensor.noise_dn * np.sqrt(0.25 + 0.75 * image / _MID_GREY)
            image = image + spread * rng.standard_normal(image.shape, dtype=np.float32)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _view_of_rows(optics: IdealOptics, rows: slice) -> tuple[SourceView, Array | None]:
    """The part of the ideal image that image rows need, and the map into that part."""
    view = optics.view
    if optics.map_px is None:
        return view.cut(0, rows.start, view.width, rows.stop - rows.start), None
    map_px = optics.map_px[rows]
    if not np.isfinite(map_px).any():
        return view.cut(0, 0, 1, 1), map_px
    low = np.maximum(np.floor(np.nanmin(map_px, axis=(0, 1))).astype(int) - _PAD_PX, 0)
    high = np.minimum(np.ceil(np.nanmax(map_px, axis=(0, 1))).astype(int) + _PAD_PX + 1, [view.width, view.height])
    part = view.cut(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))
    return part, map_px - low.astype(np.float32)


# a jump between neighbours by more than this share of the depth is an edge
_EDGE_SHARE = 0.05


def measured_depth(true_m: Array, settings: DepthSettings, seed: list[int]) -> DepthImage:
    """What a stereo depth camera makes of the true depth of every pixel.

    Noise acts on the disparity d = f b / z: sigma(z) = z^2 sigma_d / (f b) then is what `core.depth.DepthNoise` states
    (Khoshelham and Elberink 2012), and steps of the disparity are steps of depth that grow with distance. Errors of neighbouring
    pixels are alike, because the camera matches blocks. Each pixel looks a little off its place (lateral noise of 0.8 px, Nguyen,
    Izadi and Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and tracking", 3DIMPVT 2012), so that outlines
    are ragged; next to edges of depth some pixels have no depth, where one of the two lenses does not see the surface.

    Args:
        true_m: (H, W) depth along the optical axis, m; NaN or beyond `reach_m` where there is none.
        settings: of the camera. seed: numbers the noise is drawn from.
    """
    rng = np.random.default_rng(seed)
    noise = noise_of(settings)
    shape = true_m.shape
    true_m = np.where((true_m > 0) & (true_m <= settings.reach_m), true_m, np.nan).astype(np.float32)
    off_px = np.rint(rng.normal(scale=settings.lateral_px, size=(2, *shape))).astype(np.int64)
    rows, columns = np.indices(shape)
    seen_m = true_m[(rows + off_px[0]).clip(0, shape[0] - 1), (columns + off_px[1]).clip(0, shape[1] - 1)]
    span = noise.focal_px * noise.baseline_m
    disparity = span / seen_m + noise.disparity_sigma_px * _alike(rng, shape)
    if noise.step_px:
        disparity = np.rint(disparity / noise.step_px) * noise.step_px
    depth_m = span / np.maximum(disparity, 1e-6) + noise.floor_m * rng.standard_normal(shape, np.float32)
    lost = _near_edges(true_m) & (rng.random(shape) < settings.edge_loss)
    known = np.isfinite(depth_m) & ~lost & (depth_m > 0) & (depth_m <= settings.reach_m)
    return DepthImage(values=np.where(known, np.rint(depth_m * MM_PER_M), 0).astype(np.uint16), noise=noise)


def noise_of(settings: DepthSettings) -> DepthNoise:
    """The noise that such a camera states."""
    return DepthNoise(**{field.name: getattr(settings, field.name) for field in fields(DepthNoise)})


def _alike(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """(H, W) normal numbers of variance 1 that are alike within a block."""
    drawn = rng.standard_normal(shape, np.float32)
    sigma = _BLOCK_PX / 2
    smooth = cv2.GaussianBlur(drawn, (0, 0), sigma)
    # a Gaussian filter of width sigma leaves 1 / (4 pi sigma^2) of the variance
    return np.asarray(smooth * (2 * np.sqrt(np.pi) * sigma))


def _near_edges(depth_m: Array) -> Array:
    """(H, W) pixels next to a jump of depth."""
    filled = np.nan_to_num(depth_m, nan=0.0)
    kernel = np.ones((2 * max(1, round(_BLOCK_PX / 2)) + 1,) * 2, np.uint8)
    jump = cv2.dilate(filled, kernel) - cv2.erode(filled, kernel)
    return np.asarray(jump > _EDGE_SHARE * np.maximum(filled, 1.0))
