"""Fits to simulated people, for any detector: noise of keypoints, and offsets from them to joint centres (`fit-noise`).

The people are known exactly. Their bodies, motions and cameras are drawn for fits alone; none of them appears in a reported
measurement (bodies of random seeds 7000 to 7207). The noise model is of a user's network. Offsets are judged by bodies left out:
constants along directions of the body itself, and slopes on the segment lengths of the person.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from posefuse.api.arguments import lines_of
from posefuse.core import Frame, InputError, JointCentres, PoseSequence, Progress, Region, Skeleton, Truth
from posefuse.core.arrays import Array
from posefuse.core.errors import warn_caller
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import SIDES, mirror_name, pick_keypoints
from posefuse.detection import region_from_keypoints
from posefuse.detection.build import DetectorChoice
from posefuse.detection.card import OnnxCard, read_card
from posefuse.detection.networks import OneStageDetector, OnnxConfig, TopDownDetector
from posefuse.detection.noise import FEATURES, NoiseModel, keypoint_noise_features
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.trc import TrcData, write_trc
from posefuse.formats.truth import read_truth
from posefuse.foundation.output_file import write_text
from posefuse.foundation.settings import settings_from_mapping
from posefuse.foundation.summary import Block, Facts, Heading
from posefuse.pipeline.config import CameraInput, TrackConfig
from posefuse.pipeline.session import find_session
from posefuse.pipeline.track import track_session
from posefuse.tracking import to_joint_centres
from posefuse.tracking.body_directions import keypoint_of, segment_lengths
from posefuse.tracking.joint_centres import MOST_LONGER_M, joint_directions

from .files import joint_centres_text
from .scene import Scene
from .session import simulate

FLOORS = ("wood", "concrete", "tiles", "plain")
DURATION_S, RATE_HZ = 8.0, 2.5
_JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
Range = tuple[Sequence[float], Sequence[float]]
# least and most degrees of legs (abduction, flexion, knee) and arms (abduction, flexion, turn about the vertical, elbow): all
# joints through most of their ranges; and standing with arms raised. Eight scenes of either, of bodies of their own
MOVES: tuple[tuple[Range, Range], ...] = (
    (((0, -20, 2), (25, 60, 80)), ((5, -40, -60, 2), (140, 120, 60, 120))),
    (((0, -8, 1), (14, 8, 12)), ((45, -20, -30, 1), (130, 35, 30, 60))),
)
SCENES_EACH = 8
MOTIONS: list[dict[str, Any]] = [
    {"kind": "squat", "period_s": 5.3},
    {"kind": "reach", "side": "left", "period_s": 1.9},
    {"kind": "walk", "path": {"shape": "line", "start_m": [-1.6, -0.9], "end_m": [1.5, 1.1]}, "speed_mps": 0.8},
    {"kind": "idle", "sway": 2.0},
    {"kind": "wave", "side": "left", "period_s": 2.3},
    {"kind": "reach", "side": "right", "period_s": 2.3},
    {"kind": "walk", "path": {"shape": "circle", "radius_m": 1.0, "clockwise": True}, "speed_mps": 0.7},
    {"kind": "squat", "period_s": 3.7, "knee_flexion_deg": 115},
]


def everyday_scene(i: int) -> dict[str, Any]:
    """One scene: its own body, motion, room, clutter and cameras."""
    rng = np.random.default_rng(90_000 + i)
    motion = dict(MOTIONS[i % len(MOTIONS)])
    if motion["kind"] != "walk":
        motion |= {"position_m": rng.uniform(-0.6, 0.6, 2).round(2).tolist(), "heading_deg": float(rng.integers(0, 360))}
    clutter = [{"kind": "clutter", "count": 7, "area_m": [6, 6], "keep_clear_m": 0.9, "most_height_m": 1.3}] if i % 3 == 1 else []
    size_px = [[640, 480], [1280, 720]][i % 2]
    return _scene(i, rng, 500, {"body": {"random_seed": 7000 + i}, "motion": motion}, size_px, (5.5, 75)) | {"occluders": clutter}


def moving_scene(i: int, motion_file: Path) -> dict[str, Any]:
    """One scene of a person who moves all joints."""
    body = {"random_seed": 7100 + 100 * (i // SCENES_EACH) + i % SCENES_EACH}
    person = {"body": body, "motion": {"kind": "trc", "file": str(motion_file)}}
    return _scene(i, np.random.default_rng(91_000 + i), 600, person, [640, 480], (5.2, 72))


def _scene(
    i: int, rng: np.random.Generator, seed: int, person: dict[str, Any], size_px: list[int], most: tuple[float, int]
) -> dict[str, Any]:
    """One person before four cameras. most: radius of their circle, m, and angle that they see."""
    cameras = {
        "kind": "ring",
        "count": 4,
        "radius_m": round(rng.uniform(3.2, most[0]), 2),
        "height_m": round(rng.uniform(1.0, 2.7), 2),
        "first_angle_deg": float(rng.integers(0, 90)),
        "image": {"size_px": size_px, "horizontal_fov_deg": float(rng.integers(58, most[1]))},
        "sensor": {"noise_dn": 1.5},
    }
    return {
        "duration_s": DURATION_S,
        "rate_hz": RATE_HZ,
        "seed": seed + i,
        "cameras": cameras,
        "people": [person],
        "room": {"floor": FLOORS[i % 4], "walls": ("office", "plain")[i // 2 % 2], "brightness": round(rng.uniform(0.7, 1.2), 2)},
        "record": {"kind": "jpeg", "quality": 90},
    }


def smooth_path(rng: np.random.Generator, low: Sequence[float], high: Sequence[float], t_s: Array) -> Array:
    """(T, n) angles in radians through a random pose every 0.8 s, from limits (n,) in degrees."""
    knots = np.arange(0.0, DURATION_S + 1.6, 0.8)
    return np.asarray(np.deg2rad(PchipInterpolator(knots, rng.uniform(low, high, (len(knots), len(low))))(t_s)))


def moving(seed: int, legs: Range, arms: Range) -> TrcData:
    """Keypoints of a person who stays in one place and moves trunk, legs and arms between limits.

    Rest: +X ahead, +Y left, +Z up, arms down.
    """
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, DURATION_S + 0.4, 1 / 30)
    points: dict[str, Array] = {}
    first, last = rng.uniform(0, 2 * np.pi, 2)
    turn = Rotation.from_euler("z", np.linspace(first, last, len(t_s))[:, None])
    trunk = turn * Rotation.from_euler("zyx", smooth_path(rng, (-25, -10, -12), (25, 25, 12), t_s))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        hip = turn.apply([0.0, sign * 0.09, 0.0])
        # abduction, flexion; then the bend of the knee
        leg = smooth_path(rng, *legs, t_s)
        thigh = turn * Rotation.from_euler("xy", np.stack([sign * leg[:, 0], -leg[:, 1]], axis=-1))
        shank = thigh * Rotation.from_euler("y", leg[:, 2:])
        knee = hip + thigh.apply([0, 0, -0.42])
        ankle = knee + shank.apply([0, 0, -0.4])
        shoulder = trunk.apply([0, sign * 0.18, 0.5])
        arm = smooth_path(rng, *arms, t_s)
        upper = trunk * Rotation.from_euler("yxz", np.stack([-arm[:, 1], sign * arm[:, 0], arm[:, 2]], axis=-1))
        lower = upper * Rotation.from_euler("y", -arm[:, 3:])
        elbow = shoulder + upper.apply([0, 0, -0.29])
        wrist = elbow + lower.apply([0, 0, -0.26])
        points |= {f"{side}_{name}": xyz for name, xyz in zip(_JOINTS, (shoulder, elbow, wrist, hip, knee, ankle), strict=True)}
    xyz = np.stack(list(points.values()), axis=1) + [0, 0, 0.9]
    return TrcData(names=tuple(points), t_s=t_s, xyz_world=xyz, rate_hz=30.0)


def render_everyday(out: Path, count: int, say: Callable[[str], None]) -> list[Path]:
    """Draw the scenes that are not there yet; minutes, and may be interrupted and resumed."""
    return [_rendered(out / f"scene{i:02d}", everyday_scene(i), say) for i in range(count)]


def render_moving(out: Path, count: int, say: Callable[[str], None]) -> list[Path]:
    """The same of people who move all joints about, at most `SCENES_EACH` of each of the `MOVES`."""
    out.mkdir(parents=True, exist_ok=True)
    folders = []
    for i in range(min(count, SCENES_EACH * len(MOVES))):
        motion_file = out.absolute() / f"motion{i:02d}.trc"
        if not motion_file.exists():
            write_trc(motion_file, moving(i, *MOVES[i // SCENES_EACH]))
        folders.append(_rendered(out / f"scene{i:02d}", moving_scene(i, motion_file), say))
    return folders


def is_rendered(folder: Path) -> bool:
    """Whether a scene's folder is complete."""
    return (folder / "truth" / "truth.npz").exists()


def _rendered(folder: Path, scene: dict[str, Any], say: Callable[[str], None]) -> Path:
    if not is_rendered(folder):
        simulate(settings_from_mapping(scene, Scene, where=folder.name), folder, processes=1)
        say(f"{folder.name}: rendered")
    return folder


# errors count up to this share of the crop's height: what is further off is a confusion
MOST_ERROR = 0.06
# regions come from poses that are not exact: standard deviation of their place and size, shares of the side, and of their angle
_MOVED, _GROWN, _TURNED_RAD = 0.02, 0.05, 0.06
# of the scenes, each judged by a fit to the others
_PARTS = 4
_SYNONYMS = {"left_foot_index": "left_big_toe", "right_foot_index": "right_big_toe"}


@dataclass(frozen=True, eq=False)
class NoiseSamples:
    """M looks at people, n keypoints that the truth has, along x and y: shares of the crop's height.

    Attributes:
        names: of the n keypoints, as the network calls them.
        error: (M, n, 2); NaN where the network gives nothing. values: feature -> (M, n, 2).
    """

    names: tuple[str, ...]
    error: Array
    values: dict[str, Array]


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """A fitted model, and its fit on held-out people.

    Attributes:
        noise: the model. samples: looks that it was fitted to.
        ratio: mean of (error / sigma)^2 per axis, each quarter of the scenes judged by a fit to the others; 1 is right.
    """

    noise: NoiseModel
    samples: int
    ratio: float


def collect(folder: Path, detector: TopDownDetector | OneStageDetector, seed: int) -> NoiseSamples:
    """Network outputs and errors for every person of a rendered scene, with the regions of normal use."""
    truth = read_truth(folder / "truth" / "truth.npz")
    names, theirs, ours = shared_keypoints(detector.skeleton, truth.skeleton)
    rng = np.random.default_rng(seed)
    errors: list[Array] = []
    values: dict[str, list[Array]] = {name: [] for name in FEATURES}
    for view in truth.views:
        paths = sorted((folder / "videos" / view.camera).glob("*.*g"))
        for i, (path, people) in enumerate(zip(paths, view.xy_img, strict=True)):
            region = region_from_keypoints(people[0], truth.skeleton)
            image = cv2.imread(str(path))
            if region is None or image is None:
                continue
            frame = Frame(
                camera=view.camera, seq=i, t_ns=int(view.t_ns[i]), received_ns=0, image=np.ascontiguousarray(image[..., ::-1])
            )
            seen = detector.observed(frame, _as_in_use(region, rng))
            if seen is None:
                continue
            exact = people[0] @ seen.input_from_img[:, :2].T + seen.input_from_img[:, 2]
            errors.append((seen.keypoints.xy[0, ours] - exact[theirs]) / seen.height_px)
            found = keypoint_noise_features(seen.keypoints, seen.height_px)
            for name in FEATURES:
                values[name].append(found[name][0, ours])
    shape = (len(errors), len(names), 2)
    return NoiseSamples(
        names, np.array(errors).reshape(shape), {name: np.array(rows).reshape(shape) for name, rows in values.items()}
    )


def fit_noise(scenes: Sequence[NoiseSamples], made_by: str) -> NoiseFit:
    """The model of greatest likelihood of all scenes, judged by fits that leave each fourth of them out."""
    ratios = []
    for part in range(_PARTS):
        others = [one for i, one in enumerate(scenes) if i % _PARTS != part]
        mine = [one for i, one in enumerate(scenes) if i % _PARTS == part]
        if others and mine:
            ratios.append(_ratio(_stacked(mine), _model(_stacked(others), made_by)))
    everything = _stacked(scenes)
    judged = np.concatenate(ratios) if ratios else _ratio(everything, _model(everything, made_by))
    return NoiseFit(_model(everything, made_by), len(everything.error), float(np.nanmean(judged)))


def noise_text(noise: NoiseModel) -> str:
    """The model as TOML, as `read_noise` reads it."""
    lines = [f'made_by = "{noise.made_by}"', f"least = {noise.least}", f"most = {noise.most}", "", "[weights]"]
    lines += [f"{name} = {value:.4f}" for name, value in noise.weights.items()]
    lines += ["", '# keypoints that the simulated people do not have take the value of ""', "[offset]"]
    lines += [f'"{name}" = {value:.4f}' for name, value in noise.offset.items()]
    return "\n".join(lines) + "\n"


def shared_keypoints(skeleton: Skeleton, truth: Skeleton) -> tuple[tuple[str, ...], Array, Array]:
    """Names of keypoints that both have, and their places in the truth and in the network's set."""
    by_true_name = {_SYNONYMS.get(name, name): name for name in skeleton.keypoints}
    shared = [name for name in truth.keypoints if name in by_true_name]
    names = tuple(by_true_name[name] for name in shared)
    return names, truth.indices(shared), skeleton.indices(names)


def _as_in_use(region: Region, rng: np.random.Generator) -> Region:
    move, grow, turn = rng.normal(0, _MOVED, 2) * region.side_px, rng.normal(0, _GROWN), rng.normal(0, _TURNED_RAD)
    return Region(centre_img=region.centre_img + move, side_px=region.side_px * np.exp(grow), angle_rad=region.angle_rad + turn)


def _stacked(scenes: Sequence[NoiseSamples]) -> NoiseSamples:
    values = {name: np.concatenate([one.values[name] for one in scenes]) for name in FEATURES}
    return NoiseSamples(scenes[0].names, np.concatenate([one.error for one in scenes]), values)


def _model(data: NoiseSamples, made_by: str) -> NoiseModel:
    # both axes are samples of one law; detections without a keypoint take its average
    square = np.minimum(data.error**2, MOST_ERROR**2)
    square = np.where(np.isfinite(square), square, np.nanmean(square, axis=(0, 2), keepdims=True))
    flat = np.moveaxis(square, 2, 1).reshape(-1, len(data.names))
    design = np.stack([np.moveaxis(data.values[name], 2, 1).reshape(flat.shape) for name in FEATURES], axis=-1)
    other_side = [data.names.index(mirror_name(name)) for name in data.names]
    offset, weight = fit_log_sigma(flat, design, other_side)
    offsets = dict(zip(data.names, offset.tolist(), strict=True)) | {"": float(offset.mean())}
    return NoiseModel(made_by=made_by, weights=dict(zip(FEATURES, weight.tolist(), strict=True)), offset=offsets)


def _ratio(data: NoiseSamples, noise: NoiseModel) -> Array:
    """(M, n, 2) of (error / sigma)^2, errors counted up to `MOST_ERROR`."""
    return np.asarray(np.minimum(data.error**2, MOST_ERROR**2) / noise.sigma(data.values, data.names) ** 2)


def fit_log_sigma(square: Array, design: Array, other_side: Sequence[int]) -> tuple[Array, Array]:
    """Offsets (n,) and weights (F,) of log sigma = offset + design . weights, for Gaussian errors of that sigma.

    Args:
        square: (M, n) squared errors per coordinate, in whatever unit sigma is to have, outliers limited.
        design: (M, n, F) features.
        other_side: (n,) place of each keypoint's mirror image: people are as good as those.
    """
    count = square.shape[1]

    def loss(parameters: Array) -> tuple[float, Array]:
        offset, weight = parameters[:count], parameters[count:]
        log_sigma = offset + design @ weight
        ratio = square * np.exp(-2 * log_sigma)
        slope = 1 - ratio
        gradient = np.concatenate([slope.mean(0), np.einsum("mk,mkf->f", slope, design) / len(square)])
        return float((log_sigma + ratio / 2).mean(0).sum()), gradient

    typical = 0.5 * np.log(np.maximum(square.mean(), 1e-12))
    start = np.concatenate([np.full(count, typical), np.zeros(design.shape[-1])])
    solved = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 2000})
    offset = solved.x[:count]
    return (offset + offset[list(other_side)]) / 2, solved.x[count:]


# Directions each joint may be moved along, as found to pay by bodies left out. The hip is not moved along the spine as a whole:
# the mesh gives 12 mm down, real footage (bench/real_footage.py) gives up; "sinking" is nothing when standing, and grows as the
# thigh is lifted.
WANTED = {
    "shoulder": ("forward", "up", "outward", "arm", "raising"),
    "elbow": ("upper_arm", "bend", "lowering"),
    "wrist": ("forearm", "hand", "palm"),
    "hip": ("forward", "outward", "sinking"),
    "knee": ("thigh", "bend", "outward", "forward"),
    "ankle": ("shank", "foot", "outward"),
    "ear": ("face", "crown", "outward"),
    "nose": ("face", "crown"),
}
ARM = ("shoulder", "elbow", "wrist")
# Joints whose offsets also depend on the segment lengths of the person, where cross-validation over bodies shows a gain.
BY_LENGTH = ("shoulder", "hip", "knee", "ankle")
# what a slope of 1 costs, in time steps whose lengths are a metre off: keeps slopes small that the bodies do not determine
RIDGE = 0.3
# an error larger than this is a confusion, not an offset
MOST_M = 0.15
# errors beyond this pull with constant force
HUBER_M = 0.015
Run = tuple[PoseSequence, Truth]


def directions_of(skeleton: Skeleton) -> dict[str, tuple[str, ...]]:
    """Those of `WANTED` that a keypoint set determines: without fingers there is no palm."""
    xyz = np.random.default_rng(0).normal(size=(len(skeleton), 3))
    known = joint_directions(xyz, skeleton, "left")
    return {joint: tuple(name for name in names if np.isfinite(known[joint][name]).all()) for joint, names in WANTED.items()}


def samples(poses: PoseSequence, truth: Truth, joint: str, wanted: Sequence[str]) -> tuple[Array, Array]:
    """Directions (M, D, 3) and what is missing to the joint centre (M, 3) of both sides over time, confusions left out."""
    inside = (poses.t_ns >= truth.t_ns[0]) & (poses.t_ns <= truth.t_ns[-1])
    xyz, true_xyz = poses.xyz_world[inside, 0], true_xyz_at(truth, poses.t_ns[inside])[:, 0]
    along, missing = [], []
    for side in SIDES:
        known = joint_directions(xyz, poses.skeleton, side)[joint]
        rows = np.stack([known[name] for name in wanted], axis=-2)
        name = [keypoint_of(side, joint)]
        away = (pick_keypoints(true_xyz, truth.skeleton, name) - pick_keypoints(xyz, poses.skeleton, name))[:, 0]
        good = np.isfinite(rows).all(axis=(-1, -2)) & (np.linalg.norm(away, axis=-1) < MOST_M)
        along.append(rows[good])
        missing.append(away[good])
    return np.concatenate(along), np.concatenate(missing)


def huber_fit(along: Array, missing: Array, ridge: float = 0.0) -> Array:
    """(D,) metres along each direction (M, D, 3) of least Huber-like loss; `ridge` pulls them to zero."""
    design = along.swapaxes(-1, -2).reshape(-1, along.shape[1])
    weight = np.ones(len(missing))
    metres: Array = np.zeros(along.shape[1])
    for _ in range(20):
        w = np.repeat(weight, 3)[:, None]
        normal = (design * w).T @ design + ridge * np.eye(along.shape[1])
        metres = np.linalg.solve(normal, (design * w).T @ missing.reshape(-1))
        weight = HUBER_M / np.maximum(np.linalg.norm(missing - moved_by(along, metres), axis=-1), HUBER_M)
    return np.asarray(metres)


def moved_by(along: Array, metres: Array) -> Array:
    """(M, 3) of directions (M, D, 3) and metres (D,)."""
    return np.asarray(np.einsum("mdx,d->mx", along, metres))


def fit_joint_centres(runs: Sequence[Run], made_by: str = "") -> JointCentres:
    """Constants first; then, of what they leave, slopes on how much longer than usual each body is by those constants.

    Args:
        runs: poses as the detector marks them, time step by time step, and the truth; one keypoint set.
        made_by: for people.
    """
    wanted = directions_of(runs[0][0].skeleton)
    each = {joint: [samples(*run, joint, names) for run in runs] for joint, names in wanted.items()}
    offsets = {}
    for joint, parts in each.items():
        along, missing = (np.concatenate(rows) for rows in zip(*parts, strict=True))
        offsets[joint] = dict(zip(wanted[joint], huber_fit(along, missing).tolist(), strict=True))
    plain = JointCentres(made_by=made_by, offsets=offsets)
    lengths = np.concatenate([segment_lengths(to_joint_centres(p, plain).xyz_world, p.skeleton) for p, _ in runs])
    if not np.isfinite(lengths).any(axis=0).all():
        return plain
    usual = np.nanmean(lengths, axis=0)
    longer = np.clip(np.nan_to_num(lengths - usual), -MOST_LONGER_M, MOST_LONGER_M)
    by_length = {joint: _slopes(each[joint], wanted[joint], offsets[joint], longer) for joint in BY_LENGTH}
    return JointCentres(
        made_by=made_by, offsets=offsets, lengths=dict(zip(SEGMENT_ENDS, usual.tolist(), strict=True)), by_length=by_length
    )


def _slopes(
    parts: Sequence[tuple[Array, Array]], names: Sequence[str], offsets: dict[str, float], longer: Array
) -> dict[str, dict[str, float]]:
    """Direction -> segment -> metres per metre that a body's segment is longer (bodies, S)."""
    metres = np.array([offsets[name] for name in names])
    along = [(a[:, :, None] * own[:, None]).reshape(len(a), -1, 3) for (a, _), own in zip(parts, longer, strict=True)]
    left = np.concatenate([missing - moved_by(a, metres) for a, missing in parts])
    slopes = huber_fit(np.concatenate(along), left, RIDGE).reshape(-1, len(SEGMENT_ENDS))
    return {name: dict(zip(SEGMENT_ENDS, row, strict=True)) for name, row in zip(names, slopes.tolist(), strict=True)}


# scenes in which the person was tracked in fewer do not make a table of joint centres
_LEAST_RUNS = 2


@dataclass(frozen=True, kw_only=True)
class FittedCard:
    """What was fitted, and the files next to the card that hold it; no joint centres where too few scenes were tracked."""

    noise_file: Path
    joint_centres_file: Path | None
    noise: NoiseFit

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "noise": self.noise_file,
            "joint_centres": self.joint_centres_file,
            "crops": self.noise.samples,
            "squared_error_over_variance": self.noise.ratio,
        }

    def summary(self) -> list[Block]:
        """The noise, for people."""
        facts = {"crops": self.noise.samples, "squared error over variance": f"{self.noise.ratio:.2f} per axis; 1 is right"}
        return [Heading("Noise of people left out of the fit"), Facts(facts)]


def fit_card(card_file: Path, scenes_in: Path, *, scenes: int, moving: int, device: str, progress: Progress) -> FittedCard:
    """Fit a card on simulated people and write the files next to it.

    Args:
        scenes_in: folder of the rendered scenes. scenes, moving: how many for the noise, and for the joint centres.
        device: on which the network runs.

    Raises:
        PosefuseError: a card or network that is not right, or a network that finds no person.
    """
    note = lines_of(progress, "scenes")
    card = read_card(card_file, OnnxCard)
    detector = OnnxConfig(card=str(card_file), device=device).build()
    everyday = render_everyday(scenes_in / "everyday", scenes, note)
    samples = []
    for i, folder in enumerate(everyday):
        samples.append(collect(folder, detector, seed=i))
        progress("noise", i + 1, len(everyday))
    seen = [one for one in samples if len(one.error)]
    if not seen:
        raise InputError(f"{card_file}: the network finds no person in any of {len(samples)} scenes; is its card right?")
    made_by = f"posefuse fit-noise: {len(seen)} rendered scenes, {sum(len(one.error) for one in seen)} crops"
    noise = fit_noise(seen, made_by)
    noise_file = card_file.with_suffix(".noise.toml")
    write_text(noise_file, noise_text(noise.noise))
    folders = [*everyday, *render_moving(scenes_in / "moving", moving, note)]
    choice = DetectorChoice(name="onnx", options={"card": str(card_file.absolute()), "device": device})
    centres_file = _joint_centres(card_file, choice, card, folders, progress)
    return FittedCard(noise_file=noise_file, joint_centres_file=centres_file, noise=noise)


def _joint_centres(
    card_file: Path, choice: DetectorChoice, card: OnnxCard, folders: Sequence[Path], progress: Progress
) -> Path | None:
    runs: list[Run] = []
    for i, folder in enumerate(folders):
        try:
            runs.append(_tracked(folder, choice))
        except InputError as error:
            warn_caller(f"{folder.name}: left out ({error})")
        progress("joint centres", i + 1, len(folders))
    if len(runs) < _LEAST_RUNS:
        line = f"joint centres: the person was tracked in {len(runs)} scenes; expected at least {_LEAST_RUNS}; not fitted"
        warn_caller(line)
        return None
    path = Path(card_file.with_suffix(".joint_centres.toml"))
    write_text(path, joint_centres_text(fit_joint_centres(runs, f"{card.name}, fitted to {len(runs)} simulated bodies")))
    return path


def _tracked(folder: Path, choice: DetectorChoice) -> Run:
    """What the pipeline makes of a scene, time step by time step and uncorrected, and the truth."""
    truth = read_truth(folder / "truth" / "truth.npz")
    inputs = {name: CameraInput(images=f"videos/{name}") for name in truth.rig.names}
    rate_hz = 1e9 / float(truth.views[0].t_ns[1] - truth.views[0].t_ns[0])
    config = TrackConfig(detector=choice, raw=True, joint_centres=False, rate_hz=rate_hz, cameras=inputs)
    done = track_session(find_session(folder, config), config)
    return done.recording.poses, truth
