"""Values built whole out of what a test is about: where keypoints are, and how well they are known."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from posefuse.core import (
    SE3,
    Camera,
    CameraTruth,
    DetectionBatch,
    Detections2D,
    Frame,
    JointAngles,
    Kind,
    LookKind,
    Observations,
    Pose3D,
    PoseSequence,
    Recording,
    Rig,
    Skeleton,
    Truth,
    Views,
    ViewSequence,
)
from posefuse.core.skeleton import COCO17
from posefuse.core.values import keypoint_boxes

if TYPE_CHECKING:
    from posefuse.health.camera_monitor import CameraState, Monitor
    from posefuse.realtime.messages import SeenView

Point = tuple[float, float, float]
# the left side of someone who faces +x, m; y to the left, z up
_LEFT = {
    "eye": (0.10, 0.03, 1.65), "ear": (0.0, 0.08, 1.63), "shoulder": (0.0, 0.19, 1.42), "elbow": (0.03, 0.27, 1.14),
    "wrist": (0.12, 0.28, 0.90), "hip": (0.0, 0.10, 0.93), "knee": (0.03, 0.11, 0.50), "ankle": (0.0, 0.11, 0.09),
    "heel": (-0.05, 0.11, 0.03), "foot_index": (0.18, 0.11, 0.03), "big_toe": (0.18, 0.11, 0.03), "small_toe": (0.14, 0.15, 0.03),
    "eye_inner": (0.11, 0.02, 1.65), "eye_outer": (0.09, 0.05, 1.65), "mouth": (0.11, 0.02, 1.58), "pinky": (0.15, 0.30, 0.83),
    "index": (0.17, 0.27, 0.82), "thumb": (0.16, 0.25, 0.85),
}  # fmt: skip
# the same with straight limbs, where the joints of ROS are at zero
_STRAIGHT = {
    "shoulder": (0, 0.2, 1.4), "elbow": (0, 0.2, 1.1), "wrist": (0, 0.2, 0.85), "hip": (0, 0.1, 0.9), "knee": (0, 0.1, 0.5),
    "ankle": (0, 0.1, 0.1), "ear": (0, 0.08, 1.6), "eye": (0.08, 0.03, 1.63),
}  # fmt: skip


def standing(x: float = 0.0, y: float = 0.0, size: float = 1.0, skeleton: Skeleton = COCO17, **others: Point) -> np.ndarray:
    """(K, 3) a person of 1.75 m times `size` standing at (x, y); `others`: keypoints that lie between left and right."""
    return of_sides(skeleton, _LEFT, nose=(0.12, 0.0, 1.62), **others) * size + [x, y, 0]


def straight(skeleton: Skeleton = COCO17, **left: Point) -> np.ndarray:
    """(K, 3) a person who stands straight at the origin; `left`: where parts of the left side are, and mirrored of the right."""
    return of_sides(skeleton, _STRAIGHT | left, nose=(0.1, 0.0, 1.6))


def simulated(motion: Mapping[str, Any], seconds: float, rate_hz: float) -> np.ndarray:
    """(T, 1, 23, 3) exact keypoints of a simulated person."""
    from posefuse.foundation.settings import settings_from_mapping
    from posefuse_sim.exact import truth_of
    from posefuse_sim.scene import Scene

    scene = {"duration_s": seconds, "rate_hz": rate_hz, "cameras": {"kind": "ring", "count": 2}, "people": [{"motion": motion}]}
    return truth_of(settings_from_mapping(scene, Scene, where="person")).xyz_world


def without(view: Detections2D, keypoints: Sequence[int] | np.ndarray) -> Detections2D:
    """The same view, these keypoints unseen."""
    xy, score = view.xy_img.copy(), view.score.copy()
    xy[:, keypoints], score[:, keypoints] = np.nan, 0.0
    return replace(view, xy_img=xy, score=score)


def shaken(poses: PoseSequence, sigma_m: float, seed: int = 0) -> PoseSequence:
    """The same people, off by noise."""
    noise_m = np.random.default_rng(seed).normal(size=poses.xyz_world.shape) * sigma_m
    return replace(poses, xyz_world=poses.xyz_world + noise_m)


def unseen(poses: PoseSequence, *keypoints: str, steps: slice = slice(None)) -> PoseSequence:
    """The same people, these keypoints missing at these time steps."""
    xyz = poses.xyz_world.copy()
    xyz[steps][:, :, poses.skeleton.indices(keypoints)] = np.nan
    return replace(poses, xyz_world=xyz)


def of_sides(skeleton: Skeleton, left: Mapping[str, Point], **others: Point) -> np.ndarray:
    """(K, 3) a body that is symmetric about y = 0, out of the parts of its left side; `others` by their whole names, NaN else."""
    known = dict(others)
    for part, (x, y, z) in left.items():
        known |= {f"left_{part}": (x, y, z), f"right_{part}": (x, -y, z)}
    return np.array([known.get(name, (np.nan,) * 3) for name in skeleton.keypoints], float)


def poses(
    xyz: np.ndarray,
    sigma_m: float = 0.01,
    rate_hz: float = 100.0,
    skeleton: Skeleton = COCO17,
    *,
    cov: np.ndarray | None = None,
    t_ns: Sequence[int] | np.ndarray | None = None,
    ids: Sequence[int] | None = None,
    **others: Any,
) -> PoseSequence:
    """(T, N, K, 3) as measured with `cov` (..., 3, 3), else `sigma_m` in every direction: NaN is missing, the rest is fused."""
    return PoseSequence(
        t_ns=np.round(np.arange(len(xyz)) * 1e9 / rate_hz).astype(np.int64) if t_ns is None else t_ns,
        skeleton=skeleton,
        person_id=np.arange(xyz.shape[1]) if ids is None else ids,
        **(_measured(xyz, np.eye(3) * sigma_m**2 if cov is None else cov) | others),
    )


def pose(
    xyz: np.ndarray,
    ids: Sequence[int] | None = None,
    t_ns: int = 0,
    *,
    skeleton: Skeleton = COCO17,
    cov: np.ndarray | None = None,
    **others: Any,
) -> Pose3D:
    """(N, K, 3) at one time, as `poses`; 1 cm in every direction without `cov`."""
    return Pose3D(
        t_ns=t_ns,
        skeleton=skeleton,
        person_id=np.arange(len(xyz)) if ids is None else ids,
        **(_measured(xyz, np.eye(3) * 1e-4 if cov is None else cov) | others),
    )


def arrays_of(poses: Pose3D | PoseSequence, change: Callable[[np.ndarray], np.ndarray]) -> dict[str, Any]:
    """What is known of each keypoint, changed: its people or keypoints chosen, ordered or repeated."""
    return {name: change(getattr(poses, name)) for name in ("xyz_world", "cov_world", "reproj_px", "n_views", "kind")}


def _measured(xyz: np.ndarray, cov: np.ndarray) -> dict[str, Any]:
    seen = np.isfinite(xyz[..., 0])
    return {
        "xyz_world": xyz,
        "cov_world": np.where(seen[..., None, None], np.broadcast_to(cov, (*xyz.shape, 3)), np.nan),
        "reproj_px": np.where(seen, 1.0, np.nan),
        "n_views": np.where(seen, 4, 0),
        "kind": np.where(seen, Kind.FUSED, Kind.MISSING),
    }


def frame(camera: str = "a", t_ns: int = 0, image: np.ndarray | None = None, **others: Any) -> Frame:
    """Of a camera, black without an image, and received when it was exposed."""
    image = np.zeros((6, 8, 3), np.uint8) if image is None else image
    return Frame(camera=camera, t_ns=t_ns, image=image, **({"seq": 0, "received_ns": t_ns} | others))


def detections(
    camera: str,
    xy: np.ndarray,
    t_ns: int = 0,
    *,
    score: float | np.ndarray = 0.9,
    sigma_px: float | np.ndarray = 2.0,
    skeleton: Skeleton = COCO17,
    **others: Any,
) -> Detections2D:
    """People (N, K, 2) px in one view: NaN is unseen, of score 0; boxes are about what is seen."""
    seen = np.isfinite(xy[..., 0])
    low, high = (np.where(seen[..., None], xy, far).transpose(1, 0, 2) for far in (np.inf, -np.inf))
    box = np.concatenate([low.min(axis=0), high.max(axis=0)], axis=1)
    stated = {
        "score": np.where(seen, score, 0.0),
        "sigma_px": np.broadcast_to(sigma_px, seen.shape),
        "box_img": np.where(np.isfinite(box), box, 0),
    }
    return Detections2D(camera=camera, t_ns=t_ns, skeleton=skeleton, xy_img=xy, **(stated | others))


def random_detections(rng: np.random.Generator, camera: str, t_ns: int, people: int) -> Detections2D:
    """People of random numbers, with what detectors may add: what stores them keeps every bit."""
    k = len(COCO17)
    xy, score, sigma = (rng.normal(size=(people, k, *shape)) for shape in ((2,), (), ()))
    cues = {"clothing_lab": rng.normal(size=(people, 3, 3)), "track_id": rng.integers(-1, 9, people)}
    return detections(camera, xy, t_ns, score=score, sigma_px=sigma, box_img=rng.normal(size=(people, 4)), **cues)


def joint_angles(angle_rad: np.ndarray, *, joints: Sequence[str], **others: Any) -> JointAngles:
    """(T, N, J, 3) at 100 Hz of people whose pelvis is at the origin, as measured with a tenth of each angle."""
    times, people = angle_rad.shape[:2]
    stated = {
        "t_ns": np.arange(times) * 10_000_000,
        "person_id": range(people),
        "segments": ("pelvis",),
        "world_from_segment": SE3.identity((times, people, 1)),
        "angle_names": (("flexion", "adduction", "rotation"),) * len(joints),
        "sigma_rad": np.abs(angle_rad) * 0.1,
    }
    return JointAngles(angle_rad=angle_rad, joints=joints, **(stated | others))


def camera(K: np.ndarray, distortion: Sequence[float] = (), pose: SE3 | None = None, **others: Any) -> Camera:
    """Of 640 x 480 px, at the origin of the world unless its pose is given."""
    stated = {"name": "a", "size_wh": (640, 480), "cam_from_world": pose or SE3.identity()}
    return Camera(K=K, distortion=np.array(distortion), **(stated | others))


def turned(rig: Rig, camera: int, rotvec_rad: Sequence[float] | np.ndarray) -> Rig:
    """The rig with one camera turned about its own centre, by a rotation vector in its own axes."""
    cameras = list(rig)
    turn = SE3.from_rotvec(np.array(rotvec_rad, float), np.zeros(3))
    cameras[camera] = replace(cameras[camera], cam_from_world=turn @ cameras[camera].cam_from_world)
    return replace(rig, cameras=tuple(cameras))


def views(rig: Rig, xyz: np.ndarray, sigma_px: float = 1.0, seed: int | None = None, skeleton: Skeleton = COCO17) -> Views:
    """What a rig sees of (N, K, 3) people; exact without a seed."""
    xy = np.moveaxis(rig.project(xyz), 0, 1)
    if seed is not None:
        xy = xy + np.random.default_rng(seed).normal(size=xy.shape) * sigma_px
    seen = np.isfinite(xy[..., 0])
    return Views(
        t_ns=0,
        skeleton=skeleton,
        camera_names=rig.names,
        person_id=np.arange(len(xyz)),
        xy_img=xy,
        score=np.where(seen, 0.9, 0.0),
        sigma_px=np.where(seen, sigma_px, np.nan),
    )


def view_sequence(
    rig: Rig,
    sequence: PoseSequence,
    xy: np.ndarray,
    score: np.ndarray | None = None,
    sigma_px: float | np.ndarray = 1.0,
    depth_m: np.ndarray | None = None,
) -> ViewSequence:
    """What a rig sees of the people of a sequence, px (T, N, C, K, 2): NaN, or of score 0, is unseen."""
    score = np.isfinite(xy[..., 0]) * 1.0 if score is None else score
    return ViewSequence(
        t_ns=sequence.t_ns,
        skeleton=sequence.skeleton,
        camera_names=rig.names,
        person_id=sequence.person_id,
        xy_img=xy,
        score=score,
        sigma_px=np.where(score > 0, sigma_px, np.nan),
        depth_m=depth_m,
    )


def noisy_views(
    rig: Rig, sequence: PoseSequence, noise_px: float, seed: int, score: np.ndarray | None = None, sigma_px: float = 1.0
) -> ViewSequence:
    """What a rig sees of the people of a sequence, off by noise; of `score` (T, N, C, K) 0 is unseen."""
    xy = np.moveaxis(rig.project(sequence.xyz_world), 0, 2)
    xy = xy + np.random.default_rng(seed).normal(size=xy.shape) * noise_px
    shown = xy if score is None else np.where(score[..., None] > 0, xy, np.nan)
    return view_sequence(rig, sequence, shown, score, sigma_px)


def truth(rig: Rig, xyz: np.ndarray, t_ns: Sequence[int] | np.ndarray, skeleton: Skeleton, **others: Any) -> Truth:
    """The truth about people (T, N, K, 3), whom every camera sees at all of these times."""
    t_ns, visible = np.asarray(t_ns), np.ones(xyz.shape[:-1], bool)
    views = [CameraTruth(camera=one.name, t_ns=t_ns, xy_img=one.project(xyz), visible=visible) for one in rig]
    stated = {"person_id": np.arange(xyz.shape[1]), "views": tuple(views)}
    return Truth(rig=rig, t_ns=t_ns, skeleton=skeleton, xyz_world=xyz, **(stated | others))


def recording(rig: Rig, sequence: PoseSequence, score: float = 0.9, sigma_px: float = 2.0, **provenance: Any) -> Recording:
    """A recording of exact views of a sequence; of score 0 it has poses and no view."""
    xy = np.where(score, np.stack([camera.project(sequence.xyz_world) for camera in rig], axis=2), np.nan)
    scores = np.where(np.isfinite(xy).all(axis=-1), score, 0.0)
    return recording_from_views(rig, sequence, xy, scores, np.where(scores > 0, sigma_px, np.nan), provenance)


def observations_from_views(views: ViewSequence) -> Observations:
    """Observations of cameras that were exposed exactly at the time steps; boxes are those of the keypoints."""
    batches, person_ids = [], []
    for i, t_ns in enumerate(views.t_ns.tolist()):
        found = []
        for c, camera in enumerate(views.camera_names):
            here = (views.score[i, :, c] > 0).any(axis=-1)
            xy, score = views.xy_img[i, here, c], views.score[i, here, c]
            found.append(
                Detections2D(
                    camera=camera,
                    t_ns=t_ns,
                    skeleton=views.skeleton,
                    xy_img=xy,
                    score=score,
                    sigma_px=views.sigma_px[i, here, c],
                    box_img=keypoint_boxes(xy, score),
                    depth_m=None if views.depth_m is None else views.depth_m[i, here, c],
                )
            )
            person_ids.append(views.person_id[here])
        batches.append(DetectionBatch(step=i, t_ns=t_ns, kind=LookKind.EXPECTED, detections=tuple(found)))
    return Observations.from_batches(views.skeleton, views.camera_names, batches).with_person_ids(np.concatenate(person_ids))


def recording_from_views(
    rig: Rig,
    sequence: PoseSequence,
    xy_img: np.ndarray,
    score: np.ndarray,
    sigma_px: np.ndarray,
    provenance: Mapping[str, Any] | None = None,
) -> Recording:
    """A recording of cameras that were exposed exactly at the poses' times, seen at xy_img (T, N, C, K, 2)."""
    seen = observations_from_views(view_sequence(rig, sequence, xy_img, score, sigma_px))
    return Recording(rig=rig, poses=sequence, observations=seen, provenance=provenance or {})


def white_jerk(dt: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition (3, 3) of position, speed and acceleration over `dt`, and the Cholesky factor (3, 3) of what jerk adds."""
    step = np.array([[1, dt, dt * dt / 2], [0, 1, dt], [0, 0, 1]])
    process = density * np.array(
        [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
    )
    return step, np.linalg.cholesky(process)


def of_white_jerk(count: int, people: int, dt: float, density: float, rng: np.random.Generator) -> np.ndarray:
    """(T, N, 17, 3) motion that is exactly the smoother's model."""
    step, process = white_jerk(dt, density)
    state, xyz = np.zeros((3, people, 17, 3)), np.empty((count, people, 17, 3))
    for i in range(count):
        xyz[i] = state[0]
        state = np.tensordot(step, state, 1) + np.tensordot(process, rng.normal(size=state.shape), 1)
    return xyz


def camera_state(camera: str, captured: int, used: int, **others: Any) -> "CameraState":
    """Of a camera that runs; frames that were not used were replaced by newer ones."""
    from posefuse.health.camera_monitor import CameraState

    stated = {"state": "running", "replaced": captured - used}
    return CameraState(camera=camera, captured=captured, used=used, **(stated | others))


def admitted(monitor: "Monitor", seen: "SeenView", now_ns: int) -> Detections2D | None:
    """The view of a camera group as a monitor passes it on."""
    return monitor.admit(seen.detections, now_ns, received_ns=seen.received_ns, still=seen.still)
