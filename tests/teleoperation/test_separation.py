"""Distance to the operator's body: exact for what is known, less for what is not, never more than the true one."""

from dataclasses import replace

import built
import numpy as np
import pytest

from bench.rehearsal.person import person_view
from posefuse.core import SKELETONS
from posefuse_teleop.hands import BODY, BONES, operator_view
from posefuse_teleop.separation import OperatorBody, distances_to_segments, remembered, separation_m, speed_share
from posefuse_teleop.settings import SeparationSettings

EXACT = SeparationSettings(sigmas=0.0, approach_mps=0.0)
HAND = np.array([0.3, -0.25, 1.1])
NOW_NS = 10**12
SPHERE = np.array([[2.0, -0.25, 1.1, 0.1]])
MEASURED = [name not in ("left_fingertips", "right_fingertips", "crown", "left_toes", "right_toes") for name in BODY]


def body(hidden=(), **changes):
    measured = [name not in hidden for name in BODY]
    return remembered(OperatorBody.unknown(), replace(person_view(HAND, NOW_NS), **{"body_measured": measured, **changes}))


def test_distances_agree_with_a_fine_search():
    rng = np.random.default_rng(0)
    points, start, end = rng.normal(size=(7, 3)), rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    share = np.linspace(0, 1, 20001)[:, None]
    for b in range(5):
        line = start[b] + share * (end[b] - start[b])
        searched = np.linalg.norm(points[:, None] - line, axis=-1).min(axis=1)
        assert distances_to_segments(points, start, end)[:, b] == pytest.approx(searched, abs=1e-4)


@pytest.mark.parametrize("hidden", [(), ("left_fingertips", "right_fingertips")])
def test_the_stretched_fingers_count_measured_or_not(hidden):
    # the fingertips are 0.2 m beyond the wrist, limbs 0.08 m thick
    assert separation_m(body(hidden), SPHERE, NOW_NS, EXACT) == pytest.approx(2.0 - 0.5 - 0.08 - 0.1)


def test_what_is_unsure_or_old_counts_as_nearer():
    settings = SeparationSettings(sigmas=2.0, approach_mps=1.6)
    exact = separation_m(body(), SPHERE, NOW_NS, EXACT)
    assert separation_m(body(), SPHERE, NOW_NS, settings) == pytest.approx(exact - 0.02)
    for age_ns in (100_000_000, -100_000_000):
        assert separation_m(body(), SPHERE, NOW_NS + age_ns, settings) == pytest.approx(exact - 0.02 - 0.16)


def test_a_hidden_limb_is_a_ball_about_the_last_joint_in_sight_for_however_long():
    arm = ("right_elbow", "right_wrist", "right_fingertips")
    seen = body()
    for later_s in (0.1, 1.0, 10.0, 3600.0):
        now_ns = NOW_NS + round(later_s * 1e9)
        after = remembered(seen, replace(person_view(HAND, now_ns), body_measured=[name not in arm for name in BODY]))
        counted = separation_m(after, SPHERE, now_ns, SeparationSettings(sigmas=0.0))
        # as far as a hand gets in a moment, and not farther from the shoulder than the arm is long
        grown = separation_m(seen, SPHERE, NOW_NS, EXACT) - 3.0 * later_s
        ball = np.linalg.norm([2.0, -0.05, -0.3]) - (0.37 + 0.29 + 0.2) - 0.08 - 0.1
        assert counted == pytest.approx(max(grown, ball), abs=1e-9)


def test_a_hand_that_is_seen_counts_without_its_elbow():
    # the robot once came within 12 mm of such a hand
    seen, later_ns = body(), NOW_NS + 10_000_000_000
    for forward_m in (0.0, 0.5, 1.0):
        reaching = person_view(HAND + [forward_m, 0, 0], later_ns)
        reaching = replace(reaching, body_measured=[name != "right_elbow" for name in BODY])
        counted = separation_m(remembered(seen, reaching), SPHERE, later_ns, EXACT)
        assert counted <= 2.0 - 0.5 - forward_m - 0.08 - 0.1 + 1e-9


def test_the_other_arm_behind_the_body_leaves_the_robot_its_full_speed_at_two_metres():
    hidden = ("left_elbow", "left_wrist", "left_fingertips", "right_fingertips", "crown", "left_toes", "right_toes")
    away_m = separation_m(body(hidden), SPHERE, NOW_NS + 50_000_000, SeparationSettings())
    assert speed_share(away_m, SeparationSettings()) == 1.0


def test_without_the_trunk_nothing_is_known_and_nothing_moves():
    for unknown in (OperatorBody.unknown(), body(["left_hip"]), body(person_id=-1), body(body_sigma_m=np.full(len(BODY), -1.0))):
        distance = separation_m(unknown, SPHERE, NOW_NS, EXACT)
        assert np.isnan(distance) and speed_share(distance, EXACT) == 0.0


def test_a_trunk_that_is_no_longer_seen_holds():
    gone = separation_m(body(), SPHERE, NOW_NS + 500_000_000, SeparationSettings())
    assert speed_share(gone, SeparationSettings()) == 0.0


def test_a_robot_without_spheres_or_at_no_finite_place_is_not_far_away():
    for spheres in (np.zeros((0, 4)), SPHERE * np.nan, np.vstack([SPHERE, SPHERE * np.inf])):
        assert np.isnan(separation_m(body(), spheres, NOW_NS, EXACT))


def test_the_speed_falls_from_slow_to_stop_and_limits_in_the_wrong_order_let_no_robot_move_that_is_too_near():
    assert [speed_share(d, SeparationSettings()) for d in (2.0, 0.8, 0.6, 0.4, 0.1, -1.0)] == pytest.approx([1, 1, 0.5, 0, 0, 0])
    wrong = SeparationSettings(slow_m=0.3, stop_m=0.4)
    assert [speed_share(d, wrong) for d in (0.1, 0.35, 0.4, 0.41)] == [0.0, 0.0, 0.0, 1.0]


def test_another_body_is_not_completed_with_limbs_of_the_last_one():
    unseen = replace(person_view(HAND, NOW_NS), person_id=2, body_measured=np.zeros(len(BODY), bool))
    assert np.isnan(separation_m(remembered(body(), unseen), SPHERE, NOW_NS, EXACT))


@pytest.mark.parametrize("skeleton", ["coco17", "blazepose33"])
def test_the_ends_of_hands_head_and_feet_are_measured_by_no_detector(skeleton):
    skeleton = SKELETONS[skeleton]
    pose = built.pose(np.random.default_rng(0).normal(size=(1, len(skeleton), 3)), [1], NOW_NS, skeleton=skeleton)
    view = operator_view(pose, ("right",), None, NOW_NS)
    assert view.body_measured.tolist() == MEASURED
    gone = operator_view(pose, ("right",), 9, NOW_NS)
    assert gone.person_id == -1 and np.isnan(gone.body_xyz_world).all() and not (gone.body_measured.any() or gone.measured.any())
    assert np.array_equal(view.body_xyz_world[BODY.index("right_wrist")], pose.xyz_world[0, skeleton.index("right_wrist")])


# --- the law: no operator is nearer than counted


class MovingOperator:
    """Walks, turns, leans and bends every joint at random, and always some part of the body moves at 3 m/s.

    Attributes:
        xyz: (T, K, 3) where everything truly is. t_ns: (T,) when.
    """

    def __init__(self, rng, count=600):
        self.rng = rng
        # of the longest bones: people of 1.5 to 2 m
        self.length = {bone: rng.uniform(0.75, 1.0) * most for bone, most in BONES.items()}
        rates, phases = rng.uniform(0.5, 4.0, size=(99, 3)), rng.uniform(0, 2 * np.pi, size=(99, 3))
        self.waves = 1.6 * np.sin(0.02 * np.arange(count)[:, None, None] * rates + phases).mean(axis=2)
        self.xyz = self._posed()
        fastest_m = np.linalg.norm(np.diff(self.xyz, axis=0), axis=-1).max(axis=1)
        self.t_ns = NOW_NS + np.concatenate([[0], np.cumsum(np.ceil(1e9 * fastest_m / 3.0))]).astype(np.int64)

    def _posed(self):
        waves = iter(self.waves.T)

        def direction(pitch, yaw):
            return np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], axis=-1)

        heading = 2.0 * next(waves)
        across = direction(0 * heading, heading + np.pi / 2)
        at = {"mid_hip": np.stack([0.5 * next(waves), 0.5 * next(waves), 0.95 + 0.05 * next(waves)], axis=-1)}

        def attach(child, parent, pitch, swing):
            bone = (parent, child) if (parent, child) in self.length else (child, parent)
            way = direction(pitch + swing * next(waves), heading + swing * next(waves))
            at[child] = at[parent] + self.length[bone] * way

        attach("neck", "mid_hip", np.pi / 2, 0.4)
        # shoulders and hips so wide that they and the trunk's sides fit together
        for side, sign in (("left", 1.0), ("right", -1.0)):
            for joint, middle in (("shoulder", "neck"), ("hip", "mid_hip")):
                at[f"{side}_{joint}"] = at[middle] + 0.6 * self.length[f"{side}_{joint}", middle] * sign * across
        attach("nose", "neck", 1.0, 0.5)
        attach("crown", "nose", 2.0, 0.4)
        for side in ("left", "right"):
            attach(f"{side}_elbow", f"{side}_shoulder", -0.8, 1.0)
            attach(f"{side}_wrist", f"{side}_elbow", 0.0, 1.2)
            attach(f"{side}_fingertips", f"{side}_wrist", 0.0, 1.2)
            attach(f"{side}_knee", f"{side}_hip", -1.5, 0.4)
            attach(f"{side}_ankle", f"{side}_knee", -1.6, 0.4)
            attach(f"{side}_toes", f"{side}_ankle", 0.0, 0.3)
        return np.stack([at[name] for name in BODY], axis=1)

    def hidden(self):
        """(T, K) bool: every keypoint by itself for times of any length, and whole parts of the body together."""
        count, rng = len(self.xyz), self.rng
        found = np.zeros((count, len(BODY)), bool)
        parts = [[k] for k in range(len(BODY))] + [[k for k, name in enumerate(BODY) if word in name] for word in WORDS]
        for part in parts:
            at = 20 + rng.exponential(50)
            while at < count:
                lasts = rng.exponential(rng.choice([5, 50, 500]))
                found[int(at) : int(at + lasts), part] = True
                at += lasts + rng.exponential(rng.choice([20, 200]))
        return found | ~np.array(MEASURED)


WORDS = ("left", "right", "wrist", "elbow", "knee", "ankle", "shoulder", "hip", "left_wr", "right_e")


@pytest.mark.parametrize("seed", range(40))
def test_no_operator_is_nearer_than_counted(seed):
    rng = np.random.default_rng([seed, 48])
    operator = MovingOperator(rng)
    hidden, sigma_m = operator.hidden(), 0.02
    sigmas_m = np.full(len(BODY), sigma_m)
    spheres = np.concatenate([rng.normal(size=(6, 3)) * [1.2, 1.2, 0.5] + [0, 0, 1.0], rng.uniform(0.05, 0.2, (6, 1))], axis=1)
    start, end = (np.array([BODY.index(bone[i]) for bone in BONES]) for i in (0, 1))
    state, known, view = OperatorBody.unknown(), 0, person_view(HAND, NOW_NS)
    for i, now_ns in enumerate(operator.t_ns.tolist()):
        if i >= 4 and rng.random() < 0.7:
            # a pose is some steps old when it arrives; what is hidden is predicted to be anywhere
            seen = i - int(rng.integers(1, 5))
            error = rng.normal(size=(len(BODY), 3))
            error *= 2 * sigma_m * rng.random((len(BODY), 1)) / np.linalg.norm(error, axis=1, keepdims=True)
            error[hidden[seen]] *= 100.0
            body = {"body_xyz_world": operator.xyz[seen] + error, "body_measured": ~hidden[seen], "body_sigma_m": sigmas_m}
            state = remembered(state, replace(view, t_ns=now_ns, measured_ns=int(operator.t_ns[seen]), **body))
        counted = separation_m(state, spheres, now_ns, SeparationSettings())
        if not np.isnan(counted):
            xyz = operator.xyz[i]
            true = distances_to_segments(spheres[:, :3], xyz[start], xyz[end]) - 0.08 - spheres[:, 3:]
            assert counted <= true.min() + 1e-9
            known += 1
    # the trunk was seen in the beginning
    assert known > 500
