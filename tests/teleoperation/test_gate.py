"""What makes the robot hold, one cause at a time, and what lets it continue."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from bench.rehearsal.person import person_view
from bench.rehearsal.robots import ExactRobot
from posefuse_teleop.follower import Driver
from posefuse_teleop.gate import FINE, Beat, Pressed, SeenBody, continuity_finding
from posefuse_teleop.hands import BODY
from posefuse_teleop.session import Operator, OperatorNews, step_operator
from posefuse_teleop.settings import TeleoperationSettings
from posefuse_teleop.values import CameraReport, Phase

SETTINGS = TeleoperationSettings()
HAND = np.array([0.3, -0.25, 1.1])
TICK_NS = 10_000_000
BODY_XYZ = person_view(HAND, 0).body_xyz_world


class Run:
    """Operator and robot step by step; `change`, and fields of the view, `robot` and `cameras`, alter what the operator gets."""

    def __init__(self, settings=SETTINGS):
        self.settings, self.now_ns, self.seq = settings, 10**12, 0
        self.robot = ExactRobot([2.0, 0.0, 0.8])
        self.driver = Driver(self.robot, settings)
        self.state, self.operator, self.order = replace(self.driver.state, sent_ns=self.now_ns), Operator(), None

    def tick(self, times=1, *, held=True, change=lambda news: news, hand=HAND, shift_m=0.0, robot=None, cameras=None, **view):
        for _ in range(times):
            self.now_ns, self.seq = self.now_ns + TICK_NS, self.seq + 1
            # a hand never stands to the last bit
            seen = replace(person_view(hand + 1e-5 * np.sin(self.seq), self.now_ns - TICK_NS, shift_m=shift_m), **view)
            pressed = Pressed(heartbeats=(Beat(seq=self.seq, sent_ns=self.now_ns),) if held else ())
            report = CameraReport(**{"t_ns": self.now_ns, "healthy": 4, "total": 4, **(cameras or {})})
            state = replace(self.state, **(robot or {}))
            news = change(OperatorNews(view=seen, pressed=pressed, cameras=report, robot=state))
            self.operator, self.order = step_operator(self.operator, news, self.now_ns, self.settings)
            self.state = self.driver.step([self.order] if self.order else [], self.now_ns)
        return self.phase

    def copied(self):
        other = copy(self)
        other.robot = copy(self.robot)
        other.driver = self.driver.copied(other.robot)
        return other

    @property
    def phase(self):
        return self.operator.gate.phase

    def pressed_again(self):
        """Let go, then pressed."""
        self.tick(20, held=False)
        return self.tick(10)

    def engaged(self):
        assert self.tick(30, held=False) is Phase.READY
        assert self.tick(10) is Phase.ENGAGED
        return self


@pytest.mark.parametrize(("healthy", "phase"), [(0, Phase.IDLE), (1, Phase.READY)])
def test_one_camera_is_enough_where_the_settings_say_so(healthy, phase):
    run = Run(settings=replace(SETTINGS, gate=replace(SETTINGS.gate, least_cameras=1)))
    assert run.tick(15, held=False, cameras={"healthy": healthy}) is phase


def test_engaging_needs_a_switch_that_was_let_go_first():
    run = Run()
    assert run.tick(40) is Phase.IDLE
    assert "let the switch go" in run.operator.gate.reason
    assert run.tick(15, held=False) is Phase.READY
    assert run.tick(1) is Phase.READY  # one beat is no press
    assert run.tick(3) is Phase.ENGAGED


CAUSES = {
    "switch let go": {"held": False},
    "no person": {"person_id": -1},
    "NaN": {"xyz_world": np.full((1, 3), np.nan)},
    "infinite": {"xyz_world": np.array([[np.inf, 0, 0]])},
    "unsure": {"sigma_m": np.array([0.061])},
    "no uncertainty": {"sigma_m": np.array([np.nan])},
    "predicted": {"measured": np.array([False])},
    "one camera": {"views": np.array([1])},
    "hands together": {"other_xyz_world": HAND[None] + 0.02},
    "other hand missing": {"other_xyz_world": np.full((1, 3), np.nan)},
    "hand too fast": {"hand": HAND + [0.07, 0, 0]},
    "near the robot": {"body_xyz_world": np.where([[name == "left_knee"] for name in BODY], [1.6, 0.0, 0.8], BODY_XYZ)},
    "no cameras": {"cameras": {"healthy": 1}},
    "more cameras than there are": {"cameras": {"healthy": 5}},
    "not finite robot": {"robot": {"xyz_world": np.full((1, 3), np.nan)}},
}


@pytest.mark.parametrize("cause", CAUSES)
def test_every_cause_holds_immediately_and_for_less_than_half_a_second_continues_and_for_more_needs_a_new_press(cause):
    run = Run().engaged()
    # two ticks for the switch, which is let go once no beat has come for a tenth of a second
    assert run.tick(12 if cause == "switch let go" else 1, **CAUSES[cause]) is Phase.HOLD
    assert run.order.speed_mps == 0.0 and run.operator.gate.reason
    longer = run.copied()
    assert run.tick(45) is Phase.ENGAGED
    # letting go for so long is the way to a new press, and a hand that stays elsewhere is measured well there
    if cause not in ("switch let go", "hand too fast"):
        longer.tick(69, **CAUSES[cause])
        assert longer.tick(60) is Phase.IDLE
        assert longer.pressed_again() is Phase.ENGAGED


def with_trunk(shoulders, hips):
    """The body's keypoints with shoulders and hips moved."""
    return BODY_XYZ + [shoulders if "shoulder" in name else hips if "_hip" in name else [0.0, 0.0, 0.0] for name in BODY]


ENDS = {
    "another person": {"person_id": 2},
    "forearm of another length": {"forearm_m": np.array([0.36])},
    "hand jumped": {"hand": HAND + [0.135, 0, 0]},
    "trunk jumped": {"body_xyz_world": with_trunk([0.0, 0.08, 0.0], [0.0, 0.08, 0.0])},
    "trunk of another length": {"body_xyz_world": with_trunk([0.0, 0.0, 0.055], [0.0, 0.0, -0.055])},
    "left and right swapped": {"change": lambda news: swapped_hands(news)},
}


@pytest.mark.parametrize("cause", ENDS)
def test_another_body_or_hand_ends_the_engagement_even_for_one_pose_and_a_press_during_it(cause):
    run = Run().engaged()
    assert run.tick(1, **ENDS[cause]) is Phase.IDLE
    assert run.order.speed_mps == 0.0 and run.operator.gate.reason
    assert run.tick(60) is Phase.IDLE
    assert run.pressed_again() is Phase.ENGAGED
    press = Run()
    assert press.tick(30, held=False) is Phase.READY
    press.tick(2)
    press.tick(1, **ENDS[cause])
    assert press.tick(60) is Phase.IDLE


@pytest.mark.parametrize(("missing", "longest"), [("view", 13), ("cameras", 101), ("robot", 11)])
def test_what_stops_coming_holds_when_it_is_too_old(missing, longest):
    run = Run().engaged()
    for times, phase in ((longest, Phase.HOLD), (60, Phase.IDLE)):
        assert run.tick(times, change=lambda news: replace(news, **{missing: None})) is phase


@pytest.mark.parametrize("jump_ns", [-1, 200_000_000, 3600 * 10**9])
def test_the_clock_may_neither_stall_nor_go_back(jump_ns):
    run = Run().engaged()
    run.now_ns += jump_ns - TICK_NS
    assert run.tick() is not Phase.ENGAGED


@pytest.mark.parametrize(("gap_s", "phase"), [(0.3, Phase.ENGAGED), (0.6, Phase.IDLE), (3600.0, Phase.IDLE)])
def test_a_program_that_was_stopped_for_longer_than_a_short_loss_needs_a_new_press(gap_s, phase):
    run = Run().engaged()
    run.now_ns += round(gap_s * 1e9)
    assert run.tick() is not Phase.ENGAGED
    assert run.tick(60) is phase
    assert run.pressed_again() is Phase.ENGAGED


def test_poses_that_repeat_to_the_last_bit_are_frozen():
    run = Run().engaged()
    assert run.tick(11, xyz_world=HAND[None]) is Phase.ENGAGED
    assert run.tick(3, xyz_world=HAND[None]) is Phase.HOLD
    assert "frozen" in run.operator.gate.reason


def test_doubt_slows_before_it_stops():
    run = Run().engaged()
    doubts = (
        ({"sigma_m": np.array([0.045])}, 0.25),
        ({"views": np.array([2])}, 0.25),
        ({"cameras": {"healthy": 3}}, 0.375),
        ({}, 0.5),
    )
    for doubt, speed_mps in doubts:
        assert run.tick(**doubt) is Phase.ENGAGED and run.order.speed_mps == pytest.approx(speed_mps)


def pressing(**button):
    """With a button of the switch pressed, too."""
    return {"change": lambda news: replace(news, pressed=replace(news.pressed, **button))}


@pytest.mark.parametrize("fault", [pressing(emergency=True), {"robot": {"fault": "brake"}}])
def test_faults_and_the_emergency_stop_are_left_by_a_reset_only(fault):
    run = Run().engaged()
    assert run.tick(**fault) is Phase.STOPPED
    assert run.tick(30, held=False) is Phase.STOPPED
    assert run.tick(5, **pressing(reset=True)) is Phase.STOPPED  # held
    run.tick(20, held=False)
    assert run.tick(held=False, **pressing(reset=True)) is Phase.IDLE
    assert run.pressed_again() is Phase.ENGAGED


def test_the_robot_must_stand_before_it_engages():
    """Otherwise the clutch would engage at a place that the robot has left already."""
    for speed_mps, phase in ((0.0011, Phase.READY), (0.0009, Phase.ENGAGED)):
        run, velocity = Run(), np.array([[0.0, speed_mps, 0.0]])
        run.tick(30, held=False)
        assert run.tick(30, robot={"velocity_world": velocity}) is phase


def test_all_must_be_well_for_a_tenth_of_a_second_before_it_continues():
    run = Run().engaged()
    run.tick(2, person_id=-1)
    for _ in range(10):
        assert run.tick() is Phase.HOLD
    assert run.tick() is Phase.ENGAGED
    # what is missing in between starts the time again
    run.tick(2, person_id=-1)
    run.tick(6)
    run.tick(1, person_id=-1)
    assert run.tick(10) is Phase.HOLD
    assert run.tick() is Phase.ENGAGED


def test_the_robot_must_stand_before_it_continues():
    run, moving = Run().engaged(), np.array([[0.0, 0.1, 0.0]])
    run.tick(1, person_id=-1)
    assert run.tick(40, robot={"velocity_world": moving}) is Phase.HOLD
    assert run.tick() is Phase.ENGAGED
    # a robot that does not stand in time needs a new press, although all else has been well meanwhile
    run.tick(1, person_id=-1)
    run.tick(60, robot={"velocity_world": moving})
    assert run.tick(30) is Phase.IDLE
    both = Run()
    both.tick(30, held=False)
    # one of two end effectors that moves is enough
    one_moves = {name: np.vstack([value] * 2) for name, value in (("xyz_world", np.zeros((1, 3))), ("wxyz", [[1.0, 0, 0, 0]]))}
    still = np.zeros((2, 3))
    one_moves |= {"measured_xyz_world": still, "turn_rate_world": still, "velocity_world": np.vstack([0 * moving, moving])}
    assert both.tick(30, robot=one_moves) is Phase.READY


def test_a_late_pose_is_no_other_body():
    run = Run().engaged()
    assert run.tick(3, hand=HAND + [0.3, 0, 0], measured_ns=run.now_ns - 500_000_000) is Phase.HOLD
    assert run.tick(20) is Phase.ENGAGED


def test_what_is_allowed_at_most():
    """Just within each limit the robot follows; `ENDS` and `CAUSES` are just outside of it."""
    run = Run().engaged()
    allowed = {
        "hand": {"hand": HAND + [0.055, 0, 0]},
        "trunk": {"body_xyz_world": with_trunk([0.0, 0.07, 0.0], [0.0, 0.07, 0.0])},
        "one keypoint of the trunk": {"body_xyz_world": BODY_XYZ + [[0.2 * (name == "left_hip"), 0, 0] for name in BODY]},
        "length of the trunk": {"body_xyz_world": with_trunk([0.0, 0.0, 0.04], [0.0, 0.0, -0.04])},
        "forearm": {"forearm_m": np.array([0.345])},
        "sigma": {"sigma_m": np.array([0.0599])},
        "other hand": {"other_xyz_world": HAND[None] + [0, 0.101, 0]},
        "cameras": {"cameras": {"healthy": 2, "total": 2}},
    }
    for name, view in allowed.items():
        assert run.tick(1, **view) is Phase.ENGAGED, name
        assert run.tick(5) is Phase.ENGAGED, name


def test_limits_of_the_stated_deviation_in_the_wrong_order_hold_at_the_upper_one():
    settings = replace(SETTINGS, gate=replace(SETTINGS.gate, slow_sigma_m=0.06, hold_sigma_m=0.06))
    run = Run(settings).engaged()
    run.tick(sigma_m=np.array([0.059]))
    assert run.order.speed_mps == pytest.approx(0.5)
    assert run.tick(sigma_m=np.array([0.06])) is Phase.HOLD


def test_an_order_without_hands_is_answered():
    order = Run().engaged().order
    none = replace(order, xyz_world=np.zeros((0, 3)), wxyz=np.zeros((0, 4)), grip=np.zeros(0, bool))
    assert none.usable
    for wrong in (replace(order, wxyz=2 * order.wxyz), replace(order, wxyz=np.nan * order.wxyz), replace(order, speed_mps=-0.1)):
        assert order.usable and not wrong.usable


@pytest.mark.parametrize("wrong", ["duplicate", "late", "future", "backward"])
def test_heartbeats_that_do_not_count(wrong):
    run = Run().engaged()
    seq, sent_ns = run.seq, run.now_ns
    beats = {
        "duplicate": lambda: Beat(seq=seq, sent_ns=run.now_ns),
        "late": lambda: Beat(seq=run.seq, sent_ns=run.now_ns - 101_000_000),
        "future": lambda: Beat(seq=run.seq, sent_ns=run.now_ns + 1_000_000),
        "backward": lambda: Beat(seq=run.seq, sent_ns=sent_ns - 1),
    }
    assert run.tick(12, change=lambda news: replace(news, pressed=Pressed(heartbeats=(beats[wrong](),)))) is Phase.HOLD


# --- another body under the same id

ELSEWHERE = replace(SETTINGS, robot=replace(SETTINGS.robot, shared=False))


def another_body(news, shift_m, size):
    """All of the operator moved, and larger or smaller, about where the operator stands."""
    view = news.view
    moved = {name: size * getattr(view, name) + shift_m for name in ("xyz_world", "other_xyz_world", "body_xyz_world")}
    return replace(news, view=replace(view, forearm_m=size * view.forearm_m, **moved))


def moved_aside(news):
    return another_body(news, np.array([0.0, 0.7, 0.0]), 1.0)


def swapped_hands(news):
    view, body = news.view, news.view.body_xyz_world.copy()
    sides = [[BODY.index(f"{side}_{part}") for part in ("elbow", "wrist")] for side in ("left", "right")]
    body[sides[0]], body[sides[1]] = body[sides[1]], body[sides[0]]
    # with what keeps a hand from being frozen
    hand = view.other_xyz_world + (view.xyz_world - HAND)
    return replace(news, view=replace(view, xyz_world=hand, other_xyz_world=view.xyz_world, body_xyz_world=body))


def hidden(news, what):
    view = news.view
    if what == "hand":
        return replace(news, view=replace(view, measured=[False], xyz_world=view.xyz_world + 5.0))
    if what == "body":
        return replace(news, view=replace(view, measured=[False], body_measured=np.zeros(len(BODY), bool)))
    return replace(news, view=replace(view, person_id=-1, xyz_world=np.full((1, 3), np.nan)))


@pytest.fixture(scope="module")
def engaged_run():
    return Run(ELSEWHERE).engaged()


def assert_never_again_without_a_press(run, change, rng):
    """After a loss of less than `reengage_s` that hides the swap; the switch stays held."""
    lost = int(rng.integers(0, 40)) if rng.random() < 0.5 else 0
    what = rng.choice(["hand", "body", "person"])
    run.tick(lost, change=lambda news: hidden(news, what))
    for _ in range(20):
        assert run.tick(change=change) is not Phase.ENGAGED, (lost, what, run.operator.gate)
    assert run.phase is Phase.IDLE and run.order.speed_mps == 0.0


@pytest.mark.parametrize(("nearest_m", "farthest_m", "sizes"), [(0.6, 1.5, (0.85, 1.0, 1.15)), (0.2, 0.6, (0.8, 0.9, 1.1, 1.2))])
def test_another_body_under_the_same_id_never_gets_the_robot_without_a_new_press(engaged_run, nearest_m, farthest_m, sizes):
    for seed in range(200):
        rng, run = np.random.default_rng([seed, 3]), engaged_run.copied()
        angle, size = rng.uniform(0, 2 * np.pi), rng.choice(sizes)
        shift_m = rng.uniform(nearest_m, farthest_m) * np.array([np.cos(angle), np.sin(angle), 0.0])

        def change(news, shift_m=shift_m, size=size):
            return another_body(news, shift_m, size)

        assert_never_again_without_a_press(run, change, rng)
        if seed % 50 == 0:
            run.tick(15, held=False, change=change)
            assert run.tick(12, change=change) is Phase.ENGAGED


@pytest.mark.parametrize("off_s", [-0.2, 0.2])
def test_another_body_while_the_clock_is_off_does_not_get_it_either(engaged_run, off_s):
    """It comes from afar while no view is of now, and is where the operator was when views count again."""
    run, off_ns = engaged_run.copied(), round(off_s * 1e9)

    def at(x_m):
        return lambda news: another_body(news, np.array([x_m, 0.0, 0.0]), 1.05)

    for k in range(30):
        then_ns = run.now_ns - off_ns
        assert run.tick(change=at(0.8 - 0.025 * k), t_ns=then_ns, measured_ns=then_ns) is not Phase.ENGAGED
    assert run.tick(40, change=at(0.05)) is Phase.IDLE


def test_swapped_hands_never_get_the_robot_without_a_new_press(engaged_run):
    for seed in range(40):
        assert_never_again_without_a_press(engaged_run.copied(), swapped_hands, np.random.default_rng([seed, 4]))


@pytest.mark.parametrize("place", [(0.0, 0.0, 1.0), (3.0, -2.0, 1.2), (-4.0, 5.0, 0.1)])
def test_hands_near_each_other_that_are_swapped_are_named_so_anywhere_in_the_room(place):
    """Each has moved by no more than a hand may move in one frame, and the trunk stands."""
    trunk, time_ns = np.add(place, [[0.0, 0.2, 0.4], [0.0, -0.2, 0.4], [0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]), np.full(4, 10**9)
    hand, other = (np.add(place, [[0.4, y, 0.2]]) for y in (-0.045, 0.045))
    seen = {"hand_xyz": hand, "other_xyz": other, "hand_ns": 10**9, "trunk_xyz": trunk, "trunk_ns": time_ns}
    known = SeenBody(person_id=0, **seen, lengths_m=np.array([0.26, 0.4]))
    later = {"hand_ns": known.hand_ns + 33_000_000, "trunk_ns": time_ns + 33_000_000}
    crossed = replace(known, hand_xyz=known.other_xyz, other_xyz=known.hand_xyz, **later)
    found = continuity_finding(known, crossed, TeleoperationSettings().gate)
    assert found.ends and found.reason == "left and right hand were swapped"
    assert continuity_finding(known, replace(known, **later), TeleoperationSettings().gate) == FINE


def test_hands_swapped_while_they_touch_do_not_get_it_either():
    run = Run(ELSEWHERE).engaged()
    run.tick(10, change=lambda news: replace(news, view=replace(news.view, other_xyz_world=news.view.xyz_world + 0.03)))
    assert run.phase is Phase.HOLD
    assert_never_again_without_a_press(run, swapped_hands, np.random.default_rng(1))


def test_a_swap_during_another_fault_does_not_get_it_either():
    for name in ("one camera", "unsure", "no cameras", "not finite robot", "no fault"):
        run = Run(ELSEWHERE).engaged()
        run.tick(20, change=moved_aside, **CAUSES.get(name, {}))
        assert run.tick(20, change=moved_aside) is Phase.IDLE, name


def test_a_hand_hidden_for_a_moment_may_come_back_where_it_can_have_moved():
    for lost, forward_m in ((1, 0.02), (10, 0.2), (30, 0.3), (30, -0.5)):
        run = Run(ELSEWHERE).engaged()
        stood = run.state.xyz_world
        assert run.tick(lost, change=lambda news: hidden(news, "hand")) is Phase.HOLD
        assert run.tick(15, hand=HAND + [forward_m, 0, 0]) is Phase.ENGAGED, (lost, forward_m)
        # the clutch engages again where the hand is: nothing moves by that
        assert np.abs(run.state.xyz_world - stood).max() < 1e-3


def test_heartbeats_that_come_late_are_no_release():
    """Found by the fault bench: with the switch held, late heartbeats looked like a release and the next ones like a press."""
    run = Run(ELSEWHERE).engaged()

    def late(news):
        beats = tuple(replace(beat, sent_ns=beat.sent_ns - 300_000_000) for beat in news.pressed.heartbeats)
        return replace(moved_aside(news), pressed=Pressed(heartbeats=beats))

    assert run.tick(20, change=late) is Phase.IDLE
    assert run.tick(40, change=moved_aside) is Phase.IDLE
    assert "let the switch go" in run.operator.gate.reason


def test_a_hand_alone_that_comes_back_elsewhere_is_another_hand():
    """Without a trunk nothing shows whose it is: what explains 0.5 m of a known body, 0.3 s of reaching, does not count."""
    unseen = {"body_measured": np.array([not name.endswith(("shoulder", "hip")) for name in BODY])}
    run = Run().engaged()
    assert run.tick(30, measured=np.array([False]), **unseen) is Phase.HOLD
    assert run.tick(1, hand=HAND + [0.5, 0.0, 0.0], **unseen) is Phase.IDLE


@pytest.mark.parametrize("hide", [0, 5])
def test_lengths_of_a_body_are_remembered_from_view_to_view_and_past_views_without_it(hide):
    """A forearm that grows by 1 % per view is another body's before it is 50 % longer; so is such a one after a hidden hand."""
    run = Run(ELSEWHERE).engaged()
    forearm_m = person_view(HAND, 0).forearm_m
    run.tick(hide, change=lambda news: hidden(news, "hand"))
    for views in range(1, 41):
        if run.tick(forearm_m=forearm_m * (1.5 if hide else 1.01**views)) is Phase.IDLE:
            break
    assert run.phase is Phase.IDLE
    assert "another length" in run.operator.gate.reason


def test_an_operator_may_walk():
    run = Run(ELSEWHERE).engaged()
    for step in range(100):
        run.tick(shift_m=np.array([0.0, 0.012 * step, 0.0]))
    assert run.phase is Phase.ENGAGED
