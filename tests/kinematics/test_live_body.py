"""The live fit of one person by itself: what it learns, how it begins and begins again, and feet that stand."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from figure import sequence_of

from posefuse.core import SKELETONS, Skeleton
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.kinematics import JointSettings
from posefuse.kinematics.body import BodySettings, LengthPrior, LiveBody, LiveBodyRules, LiveRays, TrackedPoints
from posefuse.kinematics.body.contacts import StandingFeet
from posefuse.kinematics.body.live import Fade
from posefuse.kinematics.joints import FrameBuffers

PERIOD_NS = 10_000_000
WRIST = ANATOMICAL23.index("left_wrist")
FAST = LiveBodyRules(learn_s=0.3, sample_every_s=0.02, fade_s=0.1)
# in the order of `SEGMENT_ENDS`, of `support/figure.py`
TRUE_M = np.array([0.31, 0.26, 0.43, 0.41, 0.38, 0.26, 0.52])
PRIOR = LengthPrior(names=tuple(SEGMENT_ENDS), mean_m=TRUE_M * 1.05, cov_m2=np.diag((0.05 * TRUE_M) ** 2))


BENT = {f"{side}_{joint}": (25.0, 5.0, 0.0) for side in ("left", "right") for joint in ("arm", "elbow", "hip", "knee", "ankle")}


@pytest.fixture
def standing() -> np.ndarray:
    """(K, 3) a figure with bent limbs."""
    return np.array(sequence_of([BENT], skeleton=ANATOMICAL23.name).xyz_world[0, 0])


def body_with(settings: BodySettings | None = None, skeleton: Skeleton = ANATOMICAL23) -> LiveBody:
    return LiveBody(skeleton, settings or BodySettings(), FAST, PRIOR, FrameBuffers(skeleton, JointSettings()))


def tracked(t_ns: int, xyz: np.ndarray, sigma_m: float = 0.01) -> TrackedPoints:
    known = np.isfinite(xyz[:, 0])
    cov = np.where(known[:, None, None], np.eye(3) * sigma_m**2, np.nan)
    return TrackedPoints(t_ns=t_ns, xyz=xyz, cov=cov, measured=known)


def rays(ring_rig, xyz: np.ndarray) -> LiveRays:
    """Of points as four cameras see them without error."""
    projections = np.stack([np.column_stack([c.cam_from_world.matrix(), c.cam_from_world.xyz]) for c in ring_rig(4)])
    there = np.einsum("vij,kj->kvi", projections[:, :, :3], np.nan_to_num(xyz)) + projections[:, :, 3]
    inverse_var = np.repeat(np.where(np.isfinite(xyz[:, :1]), 1 / 0.003**2, 0.0), len(projections), axis=1)
    return LiveRays(projections=projections, xy=there[..., :2] / there[..., 2:], inverse_var=inverse_var)


def followed(body: LiveBody, ring_rig, xyz: np.ndarray, seconds: float, start_ns: int = 0) -> list[np.ndarray | None]:
    """Output ticks of a person who stays."""
    out = []
    for t_ns in range(start_ns, start_ns + round(seconds * 1e9), PERIOD_NS):
        now = rays(ring_rig, xyz) if body.wants_rays(t_ns) else None
        out.append(body.step(tracked(t_ns, xyz), now))
    return out


def test_nothing_comes_out_before_a_skeleton_is_learnt(ring_rig, standing) -> None:
    out = followed(body_with(), ring_rig, standing, 0.8)
    began = next(i for i, pose in enumerate(out) if pose is not None)
    assert 28 <= began <= 60
    assert all(pose is not None for pose in out[began:])


def test_a_person_behind_a_table_is_learnt_without_legs_and_without_a_warning(ring_rig, standing) -> None:
    """A segment that was never seen has no length, and its neighbours have theirs."""
    hidden = [ANATOMICAL23.index(f"{side}_{part}") for side in ("left", "right") for part in ("knee", "ankle", "heel", "big_toe")]
    seen = standing.copy()
    seen[hidden] = np.nan
    body = body_with()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        followed(body, ring_rig, seen, 0.8)
    lengths = body.learnt.body.lengths
    assert "left_shank" not in lengths
    assert 0.31 < lengths["left_upper_arm"].value_m < 1.05 * 0.31


def test_lengths_lie_between_those_seen_and_those_of_people(ring_rig, standing) -> None:
    body = body_with()
    followed(body, ring_rig, standing, 0.8)
    for name, true_m in zip(SEGMENT_ENDS, TRUE_M, strict=True):
        of_body = {"hips": "pelvis", "shoulders": "shoulders", "trunk": "trunk"}.get(name, f"left_{name}")
        learnt = body.learnt.body.lengths[of_body]
        assert true_m < learnt.value_m < 1.05 * true_m, name
        assert 0 < learnt.sigma_m < 0.01 and learnt.spread_m < 0.001


def test_a_child_gets_a_skeleton_of_its_own_lengths(ring_rig, standing) -> None:
    """Each of its segments is far from those of the people of the prior."""
    body = body_with()
    followed(body, ring_rig, 0.6 * standing, 0.8)
    for name, true_m, usual_m in zip(SEGMENT_ENDS, 0.6 * TRUE_M, PRIOR.mean_m, strict=True):
        of_body = {"hips": "pelvis", "shoulders": "shoulders", "trunk": "trunk"}.get(name, f"left_{name}")
        learnt_m = body.learnt.body.lengths[of_body].value_m
        assert learnt_m - true_m < usual_m - learnt_m, name


def test_refined_lengths_are_approached_slowly(ring_rig, standing) -> None:
    body = body_with()
    followed(body, ring_rig, standing, 0.5)
    offsets = [body.learnt.body.offset]
    for t_ns in range(500_000_000, 3_000_000_000, PERIOD_NS):
        body.step(tracked(t_ns, standing * [1.0, 1.0, 1.04]), None)
        offsets.append(body.learnt.body.offset)
    changes = np.linalg.norm(np.diff(offsets, axis=0), axis=-1)
    assert 0 < changes.max() <= FAST.length_rate_m_s * 0.01 + 1e-12


def test_no_step_where_a_fit_begins_or_begins_again(ring_rig, standing) -> None:
    """The pose moves as the tracked one does, and by a share of what the fit corrects: here 8 cm of a wrist."""
    body = body_with(replace(BodySettings(), contact_sigma_m=0.0))
    wrong = standing.copy()
    wrong[WRIST] += [0.0, 0.08, 0.0]
    steps = []
    before = after = None
    for t_ns in range(0, 4_000_000_000, PERIOD_NS):
        away = np.array([0.3, 0.1, 0.02]) * np.sin(1e-9 * t_ns)
        # who is found again elsewhere, where the fit begins again
        away[0] += 1.0 if 1_500_000_000 < t_ns < 3_000_000_000 else 0.0
        seen = rays(ring_rig, standing + away) if body.wants_rays(t_ns) else None
        now = wrong + away
        out = body.step(tracked(t_ns, now), seen)
        out = now if out is None else out
        if before is not None:
            steps.append(np.nanmax(np.linalg.norm(out - after - (now - before), axis=-1)))
        before, after = now, out
    assert np.linalg.norm(after - before, axis=-1)[WRIST] > 0.04, "the fit corrects"
    # the steepest of a fade, and what two fits in a row differ by
    assert max(steps) < 1.5 * 0.08 * (PERIOD_NS * 1e-9 / FAST.fade_s) + 0.001


def test_a_person_who_jumps_takes_the_correction_along(ring_rig, standing) -> None:
    """At the tick in which tracking finds the person elsewhere, and not when rays are next fitted there."""
    body = body_with()
    last = followed(body, ring_rig, standing, 1.0)[-1]
    there = standing + [2.0, 1.0, 0.0]
    for t_ns in range(1_000_000_000, 1_000_000_000 + 3 * PERIOD_NS, PERIOD_NS):
        out = body.step(tracked(t_ns, there), None)
        assert np.nanmax(np.linalg.norm(out - there, axis=-1)) <= np.nanmax(np.linalg.norm(last - standing, axis=-1)) + 1e-9


def test_rays_move_as_their_points_do(ring_rig, standing) -> None:
    before, now = rays(ring_rig, standing), standing + [0.1, -0.05, 0.2]
    moved = LiveRays.moved(
        before.projections, np.swapaxes(before.xy, 0, 1), before.inverse_var.T,
        then=np.broadcast_to(standing, (4, *standing.shape)), now=now,
    )  # fmt: skip
    np.testing.assert_array_equal(moved.inverse_var, before.inverse_var)
    seen = before.inverse_var > 0
    np.testing.assert_allclose(moved.xy[seen], rays(ring_rig, now).xy[seen], atol=1e-12)


def test_rays_that_disagree_are_as_wrong_as_they_are_apart(ring_rig, standing) -> None:
    """Four rays that miss a point by two standard deviations in each coordinate have chi-squared 32 and 5 degrees of freedom."""
    exact = rays(ring_rig, standing)
    apart = exact.xy.copy()
    apart[WRIST] += 2 * 0.003 * np.array([[1.0], [-1.0], [1.0], [-1.0]])
    factors = replace(exact, xy=apart).disagreement(standing)
    assert factors[WRIST] == pytest.approx(32 / 5)
    assert (np.delete(factors, WRIST) == 1).all()
    inverse_var = exact.inverse_var.copy()
    inverse_var[WRIST, 1:] = 0
    assert (replace(exact, xy=apart, inverse_var=inverse_var).disagreement(standing) == 1).all(), "one ray alone"


def test_a_fade_that_is_interrupted_steps_no_more() -> None:
    """Whatever follows whatever at any time."""
    rng, period_s = np.random.default_rng(0), 0.01
    fade, wanted, before, last, gap = Fade(3, 0.2), np.zeros((3, 3)), np.zeros((3, 3)), 0, 0.0
    for i in range(1, 500):
        changed = rng.random() < 0.08
        if changed:
            wanted, last = rng.normal(0, 0.1, (3, 3)), i
        now = fade.step(round(1e9 * period_s * i), wanted, changed)
        gap = np.abs(before - wanted).max() if changed else gap
        assert np.abs(now - before).max() <= 1.5 * period_s / 0.2 * gap + 1e-12
        if i - last >= 20:
            assert fade.over(round(1e9 * period_s * i))
            np.testing.assert_allclose(now, wanted, atol=1e-12)
        before = now


def test_missing_keypoints_do_not_move_the_others(ring_rig, standing) -> None:
    body, partly = body_with(), standing.copy()
    followed(body, ring_rig, standing, 1.0)
    partly[[WRIST, ANATOMICAL23.index("left_elbow")]] = np.nan
    out = followed(body, ring_rig, partly, 1.0, start_ns=1_000_000_000)
    assert np.nanmax(np.linalg.norm(out[-1] - partly, axis=-1)) < 0.03


def test_a_foot_that_hardly_moves_stands_until_it_lifts() -> None:
    keypoint = np.arange(len(ANATOMICAL23))
    feet, rng = StandingFeet(ANATOMICAL23, keypoint), np.random.default_rng(0)
    rest = rng.normal(size=(len(feet.rows), 3))
    wander = np.cumsum(rng.normal(0, 0.001, (100, len(rest), 3)), axis=0)
    put = np.array([feet.step(i * PERIOD_NS, rest + one) for i, one in enumerate(wander)])
    assert feet.stands.all()
    assert np.ptp(put[30:], axis=0).mean() < 0.5 * np.ptp((rest + wander)[30:], axis=0).mean()
    lifted = [feet.step((100 + i) * PERIOD_NS, rest + wander[-1] + [0, 0, 0.02 * i]) for i in range(60)]
    assert not feet.stands.any()
    np.testing.assert_allclose(lifted[-1], rest + wander[-1] + [0, 0, 0.02 * 59], atol=0.002)
    # on the way no step is larger than what is left of the distance
    assert np.linalg.norm(np.diff(lifted, axis=0), axis=-1).max() < 0.05


@pytest.mark.parametrize("name", ["anatomical23", "blazepose33", "body_25"])
def test_both_feet_stand_where_they_are(ring_rig, name) -> None:
    """Keypoint sets list heels and toes in different orders."""
    xyz = np.array(sequence_of([BENT], skeleton=name).xyz_world[0, 0])
    body = body_with(skeleton=SKELETONS[name])
    out = followed(body, ring_rig, xyz, 1.0)
    for pose in out[-10:]:
        assert np.nanmax(np.linalg.norm(pose - xyz, axis=-1)) < 0.03


def test_feet_may_move_where_contacts_are_off(ring_rig, standing) -> None:
    toe = ANATOMICAL23.index("left_big_toe")
    ways = {}
    for sigma_m in (0.0, 0.004):
        body = body_with(replace(BodySettings(), contact_sigma_m=sigma_m))
        out = followed(body, ring_rig, standing, 1.0)
        for i in range(100):
            now = standing + [0.02 * np.sin(i / 8), 0.0, 0.0]
            t_ns = 1_000_000_000 + i * PERIOD_NS
            seen = rays(ring_rig, now) if body.wants_rays(t_ns) else None
            out.append(body.step(tracked(t_ns, now), seen))
        ways[sigma_m] = np.ptp([pose[toe, 0] for pose in out[-50:]])
    assert ways[0.004] < 0.7 * ways[0.0]
