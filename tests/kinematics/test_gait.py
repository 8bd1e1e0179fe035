"""Gait events and measures of a figure whose steps are known."""

from pathlib import Path

import numpy as np
import pytest
from built import poses, simulated
from figure import sequence_of

from posefuse.core import SKELETONS
from posefuse.kinematics.gait import _smooth, gait_from_poses

SKELETON = SKELETONS["anatomical23"]
STRIDE_S, SPEED_M_S, WIDTH_M = 1.1, 1.3, 0.12


def stepping(heading_rad=0.7, keypoints=SKELETON.keypoints, gap=None):
    """Feet stand still for 60 % of a stride and then swing forward; left strikes at multiples of the stride time."""
    t = np.arange(0, 6, 0.01)
    xyz = np.full((len(t), 1, len(SKELETON), 3), np.nan)
    turn = np.array([[np.cos(heading_rad), -np.sin(heading_rad), 0], [np.sin(heading_rad), np.cos(heading_rad), 0], [0, 0, 1]])

    def put(name, x, y, z):
        if name in keypoints:
            xyz[:, 0, SKELETON.index(name)] = np.stack([x + 0 * t, y + 0 * t, z + 0 * t], axis=-1) @ turn.T

    for side, y, shift in (("left", WIDTH_M / 2, 0.0), ("right", -WIDTH_M / 2, 0.5)):
        cycle, phase = np.divmod(t / STRIDE_S - shift, 1.0)
        swing = np.clip((phase - 0.6) / 0.4, 0, 1)
        foot = SPEED_M_S * STRIDE_S * (cycle + shift + 0.3 + swing - np.sin(2 * np.pi * swing) / (2 * np.pi))
        pelvis = SPEED_M_S * t
        put(f"{side}_hip", pelvis, 1.5 * y, 0.9)
        put(f"{side}_shoulder", pelvis, 3 * y, 1.4)
        put(f"{side}_ankle", foot, y, 0.09)
        put(f"{side}_heel", foot - 0.05, y, 0.03)
        put(f"{side}_big_toe", foot + 0.18, y, 0.03)
        put(f"{side}_small_toe", foot + 0.18, y, 0.03)
    if gap:
        xyz[gap] = np.nan
    return poses(xyz, 1e-3, skeleton=SKELETON)


@pytest.mark.parametrize("heading_rad", [0.0, 0.7, 3.0])
def test_measures_are_those_walked(heading_rad):
    gait = gait_from_poses(stepping(heading_rad))
    assert gait.speed_m_s == pytest.approx(SPEED_M_S, rel=0.01)
    assert gait.cadence_per_min == pytest.approx(120 / STRIDE_S, rel=0.01)
    assert gait.stride_time_s.mean == pytest.approx(STRIDE_S, abs=0.01)
    assert gait.stride_length_m.mean == pytest.approx(SPEED_M_S * STRIDE_S, rel=0.01)
    assert gait.step_width_m.mean == pytest.approx(WIDTH_M, abs=0.005)
    for side in ("left", "right"):
        assert gait.step_length_m[side].mean == pytest.approx(SPEED_M_S * STRIDE_S / 2, rel=0.01)
        # this figure's feet leave the ground without a jerk, so foot off is seen up to 0.1 s late
        assert 0.6 < gait.stance_share[side].mean < 0.6 + 0.1 / STRIDE_S
    # one foot at least is always on the ground: what both stances exceed a stride by
    both = sum(gait.stance_share[side].mean for side in ("left", "right")) - 1
    assert gait.double_support_share.mean == pytest.approx(both, abs=0.01) and gait.double_support_share.count > 2


@pytest.mark.parametrize("speed_mps", [0.6, 1.2, 1.6])
def test_two_steps_straight_ahead_are_one_stride(speed_mps):
    path = {"shape": "line", "start_m": (-5.0, 0.0), "end_m": (5.0, 0.0)}
    xyz = simulated({"kind": "walk", "speed_mps": speed_mps, "path": path}, seconds=6.0, rate_hz=60.0)
    gait = gait_from_poses(poses(xyz, 1e-3, 60.0, SKELETON))
    both_m = sum(gait.step_length_m[side].mean for side in ("left", "right"))
    assert both_m == pytest.approx(gait.stride_length_m.mean, rel=0.02)


def test_strikes_are_where_the_feet_land():
    strikes = gait_from_poses(stepping()).strike_s["left"]
    late = (strikes + STRIDE_S / 2) % STRIDE_S - STRIDE_S / 2
    assert (np.abs(late) < 0.04).all()


def test_ankles_stand_in_for_feet_and_gaps_are_bridged():
    coarse = tuple(k for k in SKELETON.keypoints if not k.endswith(("heel", "toe")))
    assert gait_from_poses(stepping(keypoints=coarse)).cadence_per_min == pytest.approx(120 / STRIDE_S, rel=0.02)
    assert gait_from_poses(stepping(gap=slice(200, 206))).stride_time_s.mean == pytest.approx(STRIDE_S, abs=0.02)


@pytest.mark.parametrize("rate_hz", [10.0, 25.0, 30.0, 60.0, 100.0])
def test_smoothing_shifts_nothing_in_time(rate_hz):
    even = np.arange(60.0)
    np.testing.assert_allclose(_smooth(even, rate_hz), even, atol=1e-9)


@pytest.mark.parametrize("share", [0.05, 0.2, 0.4])
def test_time_steps_that_a_live_session_skipped_change_no_measure(share):
    walk = stepping()
    whole, kept = gait_from_poses(walk), np.flatnonzero(np.random.default_rng(4).random(len(walk)) > share)
    gait = gait_from_poses(poses(walk.xyz_world[kept], 1e-3, t_ns=walk.t_ns[kept], skeleton=SKELETON))
    assert gait.speed_m_s == pytest.approx(whole.speed_m_s, rel=0.01)
    assert gait.cadence_per_min == pytest.approx(whole.cadence_per_min, rel=0.01)
    assert gait.stride_length_m.mean == pytest.approx(whole.stride_length_m.mean, rel=0.01)


@pytest.mark.parametrize("gap", [slice(250, 350), slice(180, 240)])
def test_no_step_is_measured_across_a_time_out_of_sight(gap):
    gait, whole = gait_from_poses(stepping(gap=gap)), gait_from_poses(stepping())
    away_s = (gap.start / 100, gap.stop / 100)
    for side in ("left", "right"):
        assert not any(away_s[0] < t_s < away_s[1] for t_s in (*gait.strike_s[side], *gait.off_s[side]))
        assert gait.stance_share[side].mean == pytest.approx(whole.stance_share[side].mean, abs=0.02)
    assert gait.cadence_per_min == pytest.approx(120 / STRIDE_S, rel=0.02)
    assert gait.speed_m_s == pytest.approx(SPEED_M_S, rel=0.01)
    assert gait.stride_time_s.mean == pytest.approx(STRIDE_S, abs=0.02) and gait.stride_time_s.sd < 0.02
    assert gait.stride_length_m.mean == pytest.approx(SPEED_M_S * STRIDE_S, rel=0.01)


@pytest.mark.parametrize("rest_s", [1.0, 5.0])
def test_walks_with_a_rest_between_them_are_measured_as_one_without(rest_s):
    walk, rest = stepping(), round(rest_s / 0.01)
    whole = gait_from_poses(walk)
    there = walk.xyz_world
    onward = there + [*(SPEED_M_S * 6 * np.array([np.cos(0.7), np.sin(0.7)])), 0]
    xyz = np.concatenate([there, np.linspace(there[-1], onward[0], rest), onward])
    gait = gait_from_poses(poses(xyz, 1e-3, skeleton=SKELETON))
    assert gait.cadence_per_min == pytest.approx(whole.cadence_per_min, rel=0.02)
    assert gait.speed_m_s == pytest.approx(SPEED_M_S, rel=0.03)
    assert gait.stride_time_s.mean == pytest.approx(STRIDE_S, abs=0.02) and gait.stride_time_s.sd < 0.03
    for side in ("left", "right"):
        assert gait.stance_share[side].mean == pytest.approx(whole.stance_share[side].mean, abs=0.02)


def test_the_simulated_walk_round_a_circle_is_measured_as_set():
    from posefuse.formats.truth import read_truth

    truth = read_truth(Path(__file__).parents[2] / "examples" / "demo" / "truth" / "truth.npz")
    gait = gait_from_poses(poses(truth.xyz_world, 1e-3, t_ns=truth.t_ns, skeleton=truth.skeleton, ids=truth.person_id))
    assert gait.speed_m_s == pytest.approx(1.2, rel=0.02)
    assert gait.stride_length_m.mean == pytest.approx(1.2 * gait.stride_time_s.mean, rel=0.03)


def test_standing_and_short_recordings_are_no_walk():
    assert gait_from_poses(sequence_of([{}] * 300)) is None
    assert gait_from_poses(sequence_of([{}] * 5)) is None


def test_events_agree_with_a_gait_laboratory(shared_data):
    import ezc3d

    file = ezc3d.c3d(str(shared_data / "btk" / "FunctionalWalk.c3d"))
    labels = file["parameters"]["POINT"]["LABELS"]["value"]
    points = file["data"]["points"][:3].transpose(2, 1, 0) / 1000
    xyz = np.full((len(points), 1, len(SKELETON), 3), np.nan)
    parts = {"hip": "FEP", "knee": "FEO", "ankle": "TIO", "heel": "HEE", "big_toe": "TOE", "small_toe": "TOE"}
    for side in ("left", "right"):
        for name, label in parts.items():
            xyz[:, 0, SKELETON.index(f"{side}_{name}")] = points[:, labels.index(side[0].upper() + label)]
    gait = gait_from_poses(poses(xyz, 1e-3, 120.0, SKELETON))
    event = file["parameters"]["EVENT"]
    times = np.array(event["TIMES"]["value"]).reshape(2, -1, order="F")[1]
    first_s = file["header"]["points"]["first_frame"] / 120
    for found, kind, tolerance_s in ((gait.strike_s, "Foot Strike", 0.06), (gait.off_s, "Foot Off", 0.03)):
        for time_s, label, context in zip(times - first_s, event["LABELS"]["value"], event["CONTEXTS"]["value"], strict=True):
            if label == kind:
                assert np.abs(found[context.lower()] - time_s).min() < tolerance_s
