"""The whole-body fit: recovers lengths and motion, fills gaps honestly, respects limits, live as recorded."""

from dataclasses import replace

import numpy as np
import pytest
from built import arrays_of, noisy_views, poses, shaken, unseen
from checks import refusal
from figure import sequence_of, walking

from posefuse.core import InputError, Kind, PoseSequence
from posefuse.kinematics import JOINT_NAMES, joints_from_poses
from posefuse.kinematics.body import BodySettings, LengthPrior, bodies_from_poses, fit_poses, fit_views, tree_kernels
from posefuse.kinematics.body import filter as filter_module
from posefuse.kinematics.body.filter import BodyFilter, Measurement, guessed_state, of_points
from posefuse.kinematics.body.model import tree_from_body
from posefuse.kinematics.body.result import StateReader, length_derivatives, squared_misses, variance_factor
from posefuse.kinematics.body.shape import slopes_of
from posefuse.kinematics.joints import FrameBuffers
from posefuse.kinematics.settings import JointSettings

# the noise is white and this figure never jerks
WHITE = BodySettings(noise_memory_s=0.0, offset_sigma_m=0.0, hip_sigma_m=0.0, robust_dof=1e6, turn_accel_rad_s15=8.0)
SIGMA_M = 0.012
RATE_HZ = 50.0
HIDDEN = ("left_wrist", "left_index", "left_pinky")
LENGTH_M = {"left_thigh": 0.43, "right_shank": 0.41, "left_forearm": 0.26, "right_upper_arm": 0.31, "pelvis": 0.26, "trunk": 0.52}

NAMES = ("upper_arm", "forearm", "thigh", "shank", "shoulders", "hips", "trunk")
TRUE_M = np.array([0.31, 0.26, 0.43, 0.41, 0.38, 0.26, 0.52])


@pytest.fixture(scope="module")
def walk():
    """(steps, skeleton) -> so many time steps of walking."""

    def build(steps: int, skeleton: str = "blazepose33", sigma_m: float = 0.005) -> PoseSequence:
        return sequence_of([walking(i / RATE_HZ) for i in range(steps)], skeleton, sigma_m=sigma_m, rate_hz=RATE_HZ)

    return build


@pytest.fixture(scope="module")
def noisy(walk):
    """(clean, noisy) 3 s of walking; the left hand is missing for half a second."""
    clean = walk(150, sigma_m=SIGMA_M)
    seen = unseen(shaken(clean, SIGMA_M), *HIDDEN, steps=slice(60, 85))
    return clean, poses(seen.xyz_world, SIGMA_M, RATE_HZ, clean.skeleton)


@pytest.fixture(scope="module")
def fitted(noisy):
    return fit_poses(noisy[1], WHITE)


def prior(mean_m: np.ndarray, sigma_m: float) -> LengthPrior:
    return LengthPrior(names=NAMES, mean_m=mean_m, cov_m2=np.eye(len(NAMES)) * sigma_m**2)


def fitted_to_rays(seen: PoseSequence, rig, views, settings: BodySettings, lengths: LengthPrior):
    """Of poses that others still read, in a copy: the fit writes where they lie."""
    return fit_views(replace(seen, **arrays_of(seen, np.array)), rig, views, settings, lengths)


def test_lengths_are_those_of_the_figure(fitted):
    for name, length_m in LENGTH_M.items():
        assert fitted.bodies[0].lengths[name].value_m == pytest.approx(length_m, abs=0.003), name
        assert 0 < fitted.bodies[0].lengths[name].spread_m < 3 * SIGMA_M


def test_noise_does_not_lengthen_bones(walk):
    """Noise across a bone makes its ends seem farther apart: a forearm by 7 mm here."""
    still = np.repeat(walk(1).xyz_world, 3000, axis=0)
    clean, sigma_m = poses(still, SIGMA_M, RATE_HZ, walk(1).skeleton), 0.03
    body = bodies_from_poses(poses(shaken(clean, sigma_m).xyz_world, sigma_m, RATE_HZ, clean.skeleton))[0]
    for name, length_m in LENGTH_M.items():
        assert body.lengths[name].value_m == pytest.approx(length_m, abs=0.0025), name


def test_segments_keep_their_length(fitted):
    skeleton = fitted.poses.skeleton
    for upper, lower in (("left_hip", "left_knee"), ("right_elbow", "right_wrist")):
        a, b = (fitted.poses.xyz_world[:, 0, skeleton.index(name)] for name in (upper, lower))
        assert np.ptp(np.linalg.norm(a - b, axis=-1)) < 1e-9


def test_the_fit_is_closer_than_the_points(noisy, fitted):
    clean, seen = noisy
    raw, fit = (np.linalg.norm(s.xyz_world - clean.xyz_world, axis=-1) for s in (seen, fitted.poses))
    assert np.nanmean(fit) < 0.45 * np.nanmean(raw)


def test_angles_of_the_fit_are_closer(noisy, fitted):
    clean, seen = noisy
    truth, raw = joints_from_poses(clean), joints_from_poses(seen)
    for name in ("left_knee", "right_hip", "left_elbow", "left_ankle"):
        q = JOINT_NAMES.index(name)
        rmse = [np.sqrt(np.mean((j.angle_rad[:60, 0, q, 0] - truth.angle_rad[:60, 0, q, 0]) ** 2)) for j in (raw, fitted.joints)]
        assert rmse[1] < 0.5 * rmse[0], name


def test_its_covariance_is_honest(noisy, fitted):
    clean, at = noisy[0], fitted.bodies[0].keypoint
    error = (fitted.poses.xyz_world - clean.xyz_world)[:, 0, at]
    cov = fitted.poses.cov_world[:, 0, at] + np.eye(3) * 1e-9
    nees = np.einsum("tki,tkij,tkj->tk", error, np.linalg.inv(cov), error)
    # the skeleton's own lengths are estimates too, and carry no covariance
    assert 2.0 < nees.mean() < 5.0


def test_the_angles_state_their_own_error(noisy, fitted):
    truth = joints_from_poses(noisy[0])
    for joints in (fitted.joints, joints_from_poses(noisy[1])):
        for name in ("left_knee", "right_hip", "trunk", "right_elbow", "left_ankle"):
            q = JOINT_NAMES.index(name)
            axis = 1 if name == "trunk" else 0
            ratio = (joints.angle_rad[:, 0, q, axis] - truth.angle_rad[:, 0, q, axis]) / joints.sigma_rad[:, 0, q, axis]
            assert 0.6 < np.sqrt(np.nanmean(ratio**2)) < 1.5, name


def test_a_gap_is_filled_and_marked(noisy, fitted):
    clean, wrist = noisy[0], noisy[0].skeleton.index("left_wrist")
    gap = slice(60, 85)
    error = np.linalg.norm(fitted.poses.xyz_world - clean.xyz_world, axis=-1)[gap, 0, wrist]
    sigma = np.sqrt(np.trace(fitted.poses.cov_world[:, 0, wrist], axis1=-2, axis2=-1))
    assert (fitted.poses.kind[gap, 0, wrist] == Kind.INTERPOLATED).all()
    assert sigma[72] > 3 * sigma[30]
    assert (error < 3 * sigma[gap]).all()


def causal(body, each_pose, settings):
    """Each pose's fit while only the past is known."""
    work = FrameBuffers(body.skeleton, JointSettings())
    filter_ = BodyFilter(body, settings, work)
    reader = StateReader(filter_, work)
    for pose in each_pose:
        step = filter_.step(of_points(pose.t_ns, pose.xyz_world[0, body.keypoint], pose.cov_world[0, body.keypoint]))
        yield reader.read(step.state)


def test_the_end_of_the_causal_fit_is_the_end_of_the_recorded_one(noisy, fitted):
    body = fitted.bodies[0]
    last = list(causal(body, (noisy[1].at(i) for i in range(150)), WHITE))[-1]
    np.testing.assert_allclose(last.xyz, fitted.poses.xyz_world[-1, 0, body.keypoint], atol=1e-9)
    np.testing.assert_allclose(last.sigmas, fitted.joints.sigma_rad[-1, 0], rtol=1e-6)


def test_a_long_session_stays_sound(walk):
    """Half a minute of the same second, at uneven times: the covariance neither drifts nor loses its symmetry."""
    second = walk(50, "coco17", SIGMA_M)
    times = np.cumsum(15_000_000 + 10_000_000 * (np.arange(1500) % 2)).tolist()
    again = (replace(second.at(i % 50), t_ns=t_ns) for i, t_ns in enumerate(times))
    body, sigma = bodies_from_poses(second)[0], []
    ankle = list(body.keypoint).index(second.skeleton.index("left_ankle"))
    for fit in causal(body, again, BodySettings()):
        assert np.abs(fit.cov - np.swapaxes(fit.cov, -1, -2)).max() < 1e-12
        sigma.append(np.sqrt(np.trace(fit.cov[ankle])))
    assert np.mean(sigma[-50:]) == pytest.approx(np.mean(sigma[200:250]), rel=0.02)


@pytest.fixture
def rays(noisy, ring_rig):
    """Four cameras, and what they see of the person; an arm is for a while in the image of one camera alone."""
    clean, score = noisy[0], np.ones((150, 1, 4, len(noisy[0].skeleton)))
    score[60:85, :, 1:, clean.skeleton.indices(HIDDEN)] = 0
    return ring_rig(4), noisy_views(ring_rig(4), clean, 1.0, 2, score)


def test_rays_see_what_points_cannot(noisy, fitted, rays):
    """A wrist seen by one camera only has no 3D point, but its ray still bounds it."""
    clean, seen = noisy
    wrist = clean.skeleton.index("left_wrist")
    by_rays = fitted_to_rays(seen, *rays, WHITE, prior(TRUE_M, 0.05))
    errors = [np.linalg.norm(f.poses.xyz_world - clean.xyz_world, axis=-1)[60:85, 0, wrist].mean() for f in (fitted, by_rays)]
    assert errors[1] < 0.7 * errors[0]


def test_a_fit_to_rays_is_written_where_the_poses_lie(noisy, fitted, rays):
    seen = noisy[1]
    own = replace(seen, **arrays_of(seen, np.array))
    placed = fit_views(own, *rays, WHITE, prior(TRUE_M, 0.05))
    for name in ("xyz_world", "cov_world", "kind"):
        assert np.shares_memory(getattr(placed.poses, name), getattr(own, name))
        assert not np.shares_memory(getattr(fitted.poses, name), getattr(seen, name))
        assert not getattr(placed.poses, name).flags.writeable
    assert list(placed.bodies) == [0] and len(placed.joints.person_id) == 0


def test_an_outlier_moves_the_fit_little(noisy, fitted):
    clean, seen = noisy
    xyz, knee = seen.xyz_world.copy(), seen.skeleton.index("right_knee")
    xyz[40, 0, knee] += [0.4, -0.3, 0.2]
    spoiled = replace(seen, xyz_world=xyz)
    error = {}
    for dof in (5.0, 1e6):
        fit = fit_poses(spoiled, BodySettings(noise_memory_s=0.0, robust_dof=dof), fitted.bodies)
        error[dof] = np.linalg.norm(fit.poses.xyz_world[40, 0, knee] - clean.xyz_world[40, 0, knee])
    assert error[5.0] < 0.03 < error[1e6]


def test_an_outlier_among_lasting_errors_moves_the_fit_little(walk):
    """How long errors last says how much measurements count, not which of them is an outlier."""
    clean = walk(40, sigma_m=SIGMA_M)
    knee = clean.skeleton.index("right_knee")
    spoiled = clean.xyz_world.copy()
    spoiled[20:28, 0, knee] += [0.15, -0.1, 0.05]
    fit = fit_poses(replace(clean, xyz_world=spoiled), BodySettings(noise_memory_s=0.5, robust_dof=2.0))
    assert np.linalg.norm(fit.poses.xyz_world[:, 0, knee] - clean.xyz_world[:, 0, knee], axis=-1).max() < 0.02


@pytest.mark.parametrize("flexion", [175.0, 100.0])
def test_a_recording_may_begin_with_straight_arms_held_up(flexion):
    """A straight limb has no plane and no frame; where it points is known all the same."""
    up = {"left_arm": (flexion, 0, 0), "right_arm": (flexion, -8, 0), "left_elbow": (1, 0, 0), "right_elbow": (1, 0, 0)}
    sequence = sequence_of([up] * 12, sigma_m=0.005)
    body = bodies_from_poses(sequence)[0]
    work = FrameBuffers(sequence.skeleton, JointSettings())
    tree = tree_from_body(body, BodySettings())
    q, rot = guessed_state(body, tree, work, sequence.xyz_world[0, 0, body.keypoint])
    frame, origin = np.empty((len(body.nodes), 3, 3)), np.empty((len(body.nodes), 3))
    tree_kernels.forward_kinematics(tree, q, rot, frame, origin)
    for side in ("left", "right"):
        elbow = sequence.xyz_world[0, 0, sequence.skeleton.index(f"{side}_elbow")]
        assert np.linalg.norm(origin[body.node(f"{side}_carrying")] - elbow) < 0.02


def test_limits_hold_a_knee_back():
    sequence = sequence_of([{"left_knee": (-40, 0, 0), "left_hip": (20, 0, 0)}] * 12, sigma_m=0.03)
    bodies = bodies_from_poses(sequence)
    knee = JOINT_NAMES.index("left_knee")
    flexion = {}
    for limited in (True, False):
        fit = fit_poses(sequence, BodySettings(joint_limits=limited), bodies)
        flexion[limited] = np.degrees(fit.joints.angle_rad[-1, 0, knee, 0])
    assert flexion[True] > -20 > flexion[False]


def test_an_elbow_is_not_held_at_its_end_of_motion_while_its_points_are_bent():
    """Noise may turn an upper arm by half a turn about its axis: that is a minimum, too, and was kept for seconds.

    It takes time to notice: live the elbow is bent backwards until then, in a recording it is not.
    """
    w = 2 * np.pi * np.arange(450) / 30
    angles = [{"left_arm": (-25 * np.sin(one), -8, 10), "left_elbow": (25 + 8 * np.sin(one), 0, 0)} for one in w]
    clean = sequence_of(angles, "coco17", sigma_m=0.03, rate_hz=30)
    bodies, elbow = bodies_from_poses(clean), JOINT_NAMES.index("left_elbow")
    held, recorded = [], []
    for seed in range(4):
        seen = shaken(clean, 0.03, seed)
        fits = causal(bodies[0], (seen.at(i) for i in range(len(seen))), BodySettings())
        held.append(np.mean([fit.angles[elbow, 0] < 0 for fit in fits]))
        recorded.append(np.mean(fit_poses(seen, BodySettings(), bodies).joints.angle_rad[:, 0, elbow, 0] < 0))
    assert np.mean(held) < 0.1
    assert np.mean(recorded) < np.mean(held) / 4


def test_an_elbow_that_bends_at_the_very_end_does_not_bend_backwards():
    """Two uncertain looks are too few to be sure that an arm, straight until then, is turned; no later ones come."""
    straight, bent = {"left_elbow": (2, 0, 0)}, {"left_arm": (0, 0, 180), "left_elbow": (50, 0, 0)}
    sequence = sequence_of([straight] * 30 + [bent] * 2, "coco17", sigma_m=0.06, rate_hz=30)
    flexion = fit_poses(sequence).joints.angle_rad[:, 0, JOINT_NAMES.index("left_elbow"), 0]
    assert (flexion[-2:] > 0).all()


@pytest.mark.parametrize("skeleton", ["coco17", "body_25b", "paper14", "anatomical23"])
def test_any_skeleton_can_be_fitted(walk, skeleton):
    sequence = walk(30, skeleton)
    fit = fit_poses(sequence)
    error = np.linalg.norm(fit.poses.xyz_world - sequence.xyz_world, axis=-1)
    assert np.nanmax(error) < 0.01


def test_a_person_hardly_seen_keeps_their_points(walk):
    one = walk(20)
    xyz = np.repeat(one.xyz_world, 2, axis=1)
    xyz[2:, 1] = np.nan
    fit = fit_poses(poses(xyz, 0.005, RATE_HZ, one.skeleton, ids=[4, 9]))
    assert list(fit.bodies) == [4]
    np.testing.assert_array_equal(fit.poses.xyz_world[:, 1], xyz[:, 1])
    assert np.isfinite(fit.joints.angle_rad[:2, 1]).any() and np.isnan(fit.joints.angle_rad[2:, 1]).all()
    neither = poses(xyz * np.nan, 0.005, RATE_HZ, one.skeleton, ids=[4, 9])
    for hardly in (neither, walk(3)):
        refusal(InputError, rf"both hips and both shoulders.*there are {len(hardly)}, and no person", fit_poses, hardly)


def test_a_person_who_was_never_fitted_keeps_their_points(noisy, fitted):
    seen = noisy[1]
    fit = fit_poses(poses(seen.xyz_world * np.nan, SIGMA_M, RATE_HZ, seen.skeleton), WHITE, fitted.bodies)
    assert not fit.bodies and np.isnan(fit.poses.xyz_world).all()


def rays_with_noise(rig, xyz: np.ndarray, noise_px: float, stated_px: float) -> Measurement:
    """What the cameras of a rig without distortion see of points (A, 3)."""
    xy = np.moveaxis(rig.project(xyz), 0, 1)
    return Measurement(
        t_ns=0, xyz=np.zeros((len(xyz), 3)), cov=np.zeros((len(xyz), 3, 3)), projections=rig.projections(),
        xy=xy + np.random.default_rng(6).normal(size=xy.shape) * noise_px, inverse_var=np.full(xy.shape[:2], stated_px**-2),
    )  # fmt: skip


def test_rays_that_are_farther_off_than_stated_widen_the_covariance_and_outliers_hardly(ring_rig) -> None:
    rig, xyz = ring_rig(4), np.random.default_rng(5).uniform([-0.5, -0.4, 0.2], [0.5, 0.4, 1.8], (400, 3))
    gaussian = 1e9

    def factor(seen: Measurement, robust: float = gaussian) -> np.ndarray:
        return variance_factor(squared_misses(xyz, seen.projections, seen.xy, seen.inverse_var), robust)

    assert factor(rays_with_noise(rig, xyz, 2.0, 2.0)).mean() == pytest.approx(8 / 5, rel=0.1)
    assert factor(rays_with_noise(rig, xyz, 6.0, 2.0)).mean() == pytest.approx(9 * 8 / 5, rel=0.1)
    seen = rays_with_noise(rig, xyz, 2.0, 2.0)
    seen.xy[:, 0] += 300
    assert factor(seen).min() > 1000
    assert factor(seen, 2.0).max() < 4.0
    alone = replace(seen, inverse_var=seen.inverse_var * [1, 0, 0, 0])
    assert (factor(alone) == 1).all()


def random_motion(rng: np.random.Generator, steps: int, rate_hz: float) -> list[dict]:
    """Joints that turn at random, each at its own pace; one dict of angles per time step."""
    limits = {
        "pelvis": (40, 10, 10), "trunk": (0, 20, 20), "neck": (20, 15, 20), "left_hip": (40, 15, 15), "right_hip": (40, 15, 15),
        "left_knee": (40, 0, 0), "right_knee": (40, 0, 0), "left_arm": (60, 20, 30), "right_arm": (60, 20, 30),
        "left_elbow": (45, 0, 0), "right_elbow": (45, 0, 0), "left_ankle": (15, 5, 5), "right_ankle": (15, 5, 5),
    }  # fmt: skip
    t_s = np.arange(steps)[:, None, None] / rate_hz
    waves = np.sin(2 * np.pi * rng.uniform(0.05, 0.8, (1, len(limits), 3)) * t_s + rng.uniform(0, 6.28, (1, len(limits), 3)))
    bent = [[50.0 * name.endswith(("knee", "elbow")), 0, 0] for name in limits]
    angles = waves * np.array(list(limits.values())) + bent
    return [dict(zip(limits, map(tuple, one), strict=True)) for one in angles]


@pytest.mark.parametrize("by_rays", [False, True])
def test_a_recording_fitted_in_blocks_is_as_one_fitted_whole(ring_rig, monkeypatch, by_rays):
    """A long recording is smoothed block by block, in constant memory; limbs are hidden across the borders of blocks."""
    rng, rate_hz, steps = np.random.default_rng(4), 12.0, 1000
    clean = sequence_of(random_motion(rng, steps, rate_hz), sigma_m=SIGMA_M, rate_hz=rate_hz)
    rig = ring_rig(3)
    score = np.ones((steps, 1, 3, len(clean.skeleton)))
    for names, hidden in (
        (("left_wrist", "left_elbow", "left_index", "left_pinky"), slice(270, 420)),
        (("right_knee",), slice(560, 601)),
    ):
        score[hidden, :, :, clean.skeleton.indices(names)] = 0
    score[895:905] = 0
    shown = (score > 0).all(axis=2)[..., None]
    seen = poses(np.where(shown, shaken(clean, SIGMA_M, 4).xyz_world, np.nan), SIGMA_M, rate_hz, clean.skeleton)
    views = noisy_views(rig, clean, 1.5, 5, score, 1.5)
    bodies = bodies_from_poses(seen)
    found = []
    for block in (filter_module._BLOCK_STEPS, steps):
        monkeypatch.setattr(filter_module, "_BLOCK_STEPS", block)
        fit = fitted_to_rays(seen, rig, views, BodySettings(), prior(TRUE_M, 0.05)) if by_rays else fit_poses(seen, bodies=bodies)
        found.append(fit)
    in_blocks, whole = found
    off_m = np.linalg.norm(in_blocks.poses.xyz_world - whole.poses.xyz_world, axis=-1)
    assert whole.bodies and np.nanmax(off_m) < 1e-4
    np.testing.assert_array_equal(in_blocks.poses.kind, whole.poses.kind)
    np.testing.assert_allclose(in_blocks.joints.angle_rad, whole.joints.angle_rad, atol=1e-3)


# --- segment lengths solved together with poses: derivatives, recovery of simulated truth, the part of the prior


KEYS = ("left_upper_arm", "right_forearm", "left_thigh", "right_shank", "shoulders", "pelvis", "trunk")
SETTINGS = BodySettings(noise_memory_s=0.0, offset_sigma_m=0.0, hip_sigma_m=0.0, robust_dof=1e6, length_steps=10)
STEPS, LENGTHS_RATE_HZ, SIGMA_PX = 20, 20.0, 0.5


def squat(t: float) -> dict:
    bend = 50 - 45 * np.cos(2 * np.pi * t)
    legs = {f"{side}_{joint}": (part * bend, 3, 2) for side in ("left", "right") for joint, part in (("hip", 0.8), ("knee", 1.2))}
    arms = {f"{side}_arm": (0.9 * bend, -12, 6) for side in ("left", "right")}
    return legs | arms | {f"{side}_elbow": (20 + 0.6 * bend, 0, 0) for side in ("left", "right")} | {"trunk": (0, 4, 3)}


@pytest.fixture(scope="module")
def squatter():
    """Exact keypoints of a person whose lengths are all different, and of no usual proportions."""
    return sequence_of([squat(i / LENGTHS_RATE_HZ) for i in range(STEPS)], "coco17", sigma_m=0.005, rate_hz=LENGTHS_RATE_HZ)


def lengths(fit) -> tuple[np.ndarray, np.ndarray]:
    solved = fit.bodies[0].lengths
    return np.array([solved[key].value_m for key in KEYS]), np.array([solved[key].sigma_m for key in KEYS])


def test_derivatives_by_lengths_equal_finite_differences(squatter) -> None:
    body = bodies_from_poses(squatter)[0]
    tree = tree_from_body(body, SETTINGS)
    state = guessed_state(body, tree, FrameBuffers(squatter.skeleton, JointSettings()), squatter.xyz_world[5, 0, body.keypoint])
    assert state is not None

    def places(offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        frame, origin = np.empty_like(state[1]), np.empty((len(body.nodes), 3))
        tree_kernels.forward_kinematics(tree._replace(offset=offset), *state, frame, origin)
        points = [tree_kernels.place(frame, origin, n, x) for n, x in zip(tree.node, tree.local, strict=True)]
        return np.stack(points), frame

    slopes = slopes_of(body, NAMES)
    derived = length_derivatives(tree, slopes, places(tree.offset)[1])
    for s in range(len(NAMES)):
        ahead, back = (places(tree.offset + sign * 1e-5 * slopes[:, s])[0] for sign in (1, -1))
        np.testing.assert_allclose(derived[..., s], (ahead - back) / 2e-5, atol=1e-8)
        assert np.abs(derived[..., s]).max() > 0.4, NAMES[s]


def test_every_length_is_recovered_from_a_wrong_start(squatter, ring_rig) -> None:
    """Medians of poses that are 8 % too small are too short; rays are not. Poses do not take up what lengths lack."""
    rig = ring_rig(4)
    views = noisy_views(rig, squatter, SIGMA_PX, 3, sigma_px=SIGMA_PX)
    small = replace(squatter, xyz_world=0.92 * squatter.xyz_world + 0.08 * np.nanmean(squatter.xyz_world, axis=2, keepdims=True))
    before = np.array([bodies_from_poses(small)[0].lengths[key].value_m for key in KEYS])
    fit = fitted_to_rays(small, rig, views, SETTINGS, prior(TRUE_M * 0.9, 0.5))
    metres, sigma = lengths(fit)
    assert (np.abs(before / TRUE_M - 1) > 0.05).all()
    # the trunk is the weakest: the spine stretches
    np.testing.assert_allclose(metres[:-1], TRUE_M[:-1], atol=0.004)
    assert (np.abs(metres - TRUE_M) < 4 * sigma).all() and (sigma < 0.01).all()
    assert np.nanmax(np.linalg.norm(fit.poses.xyz_world - squatter.xyz_world, axis=-1)) < 0.02


def test_a_prior_counts_by_its_sigma(squatter, ring_rig) -> None:
    rig = ring_rig(4)
    views = noisy_views(rig, squatter, SIGMA_PX, 4, sigma_px=SIGMA_PX)
    tight, _ = lengths(fitted_to_rays(squatter, rig, views, SETTINGS, prior(TRUE_M * 1.1, 1e-5)))
    loose, _ = lengths(fitted_to_rays(squatter, rig, views, SETTINGS, prior(TRUE_M * 1.1, 1.0)))
    np.testing.assert_allclose(tight, TRUE_M * 1.1, atol=1e-4)
    np.testing.assert_allclose(loose, TRUE_M, atol=0.004)
