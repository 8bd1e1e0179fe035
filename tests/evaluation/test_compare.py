"""Comparing recordings: what was done to one of them is found, and what is left is what it differs by."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from checks import refusal
from commands import error, figures, tracked
from scipy.spatial.transform import Rotation

from posefuse.core import InputError
from posefuse.evaluation.compare import Tracks, _speed_costs, compare, comparison_page, similarity
from posefuse.evaluation.tracks import plain_name, read_tracks
from posefuse.formats.page import Note
from posefuse.formats.trc import TrcData, read_trc, write_trc

NAMES = ("neck", "left_wrist", "right_wrist", "left_ankle", "right_ankle")


def mover(rate_hz: float, duration_s: float = 8.0, start_s: float = 0.0) -> Tracks:
    """A person who walks along a bent way swinging arms, sampled at any rate."""
    t_s = start_s + np.arange(round(duration_s * rate_hz)) / rate_hz
    phase = np.arange(len(NAMES)) * 1.3
    swing = 0.3 * np.sin(2 * np.pi * 0.9 * t_s[:, None] + phase) + 0.1 * np.sin(2 * np.pi * 0.23 * t_s[:, None] + 2 * phase)
    rest = np.array([[0, 0, 1.5], [0, 0.3, 1], [0, -0.3, 1], [0, 0.1, 0.1], [0, -0.1, 0.1]])
    xyz = rest + np.stack([swing + 0.9 * t_s[:, None], 0.2 * t_s[:, None] ** 1.5 + 0 * swing, 0.1 * swing**2], axis=-1)
    return Tracks(f"{rate_hz:g} Hz", NAMES, t_s, xyz)


def test_offset_motion_and_scale_are_found_to_fractions_of_a_frame_between_rates() -> None:
    a, b = mover(60), mover(100, start_s=0.4)
    turn, shift, factor, late_s = Rotation.from_rotvec([0.2, -0.4, 1.9]).as_matrix(), np.array([3.0, -2.0, 0.4]), 1.03, 1.2345
    moved = Tracks("b", NAMES, b.t_s - late_s, (b.xyz_m - shift) @ turn / factor)
    found = compare(a, moved, scale=True)
    assert found.alignment.offset_s == pytest.approx(late_s, abs=0.001)
    assert found.alignment.scale == pytest.approx(factor, abs=1e-3)
    np.testing.assert_allclose(found.alignment.rotation, turn, atol=2e-3)
    assert found.errors.mpjpe_mm < 3
    # without the scale it cannot fit as well
    assert compare(a, moved).errors.mpjpe_mm > 2 * found.errors.mpjpe_mm


def test_the_page_states_which_of_the_two_has_a_refused_calibration() -> None:
    a, b = mover(50), replace(mover(50), warning="b: this calibration was refused")
    notes = [block for block in comparison_page(compare(a, b, time=False)).blocks if isinstance(block, Note)]
    assert [note.text for note in notes if note.warning] == ["b: this calibration was refused"]


def test_noise_is_what_is_left() -> None:
    a = mover(50)
    noisy = Tracks("noisy", NAMES, a.t_s, a.xyz_m + np.random.default_rng(0).normal(0, 0.01, a.xyz_m.shape))
    found = compare(a, noisy, time=False)
    assert found.errors.mpjpe_mm == pytest.approx(10 * np.sqrt(8 / np.pi), rel=0.05)


def test_drift_shows_when_aligned_by_the_first_seconds_only() -> None:
    a = mover(50)
    walked = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(a.xyz_m.mean(1)[:, :2], axis=0), axis=-1))])
    drifting = Tracks("b", NAMES, a.t_s, a.xyz_m + 0.02 * walked[:, None, None] * np.array([0.6, 0.8, 0]))
    assert compare(a, drifting, time=False, space=False).drift_mm_per_m == pytest.approx(20, rel=1e-6)
    assert compare(a, drifting, time=False, start_s=0.5).drift_mm_per_m > 10


@pytest.mark.parametrize("gone", ["points come and go", "some points for a while", "all points for a while"])
def test_points_that_are_not_seen_change_neither_the_way_nor_the_drift(gone: str) -> None:
    a, hidden = mover(50), np.zeros((400, len(NAMES)), bool)
    if gone == "points come and go":
        hidden = np.random.default_rng(3).random(hidden.shape) < 0.2
    else:
        hidden[150:200, : 2 if gone.startswith("some") else None] = True
    whole = compare(a, a, time=False, space=False)
    drifting = replace(a, name="b", xyz_m=a.xyz_m + 0.02 * whole.walked_m[:, None, None] * np.array([0.6, 0.8, 0]))
    partly = replace(a, xyz_m=np.where(hidden[..., None], np.nan, a.xyz_m))
    found = compare(partly, drifting, time=False, space=False)
    assert found.walked_m[-1] == pytest.approx(whole.walked_m[-1], rel=0.02)
    assert found.drift_mm_per_m == pytest.approx(20, rel=0.02)


def test_a_drift_of_a_person_who_stays_is_not_shown_as_a_number() -> None:
    a = mover(50, duration_s=0.2)
    found = compare(a, replace(a, name="b"), time=False, space=False)
    assert np.isnan(found.drift_mm_per_m) and "'drift': 'not determined over 0.2 m walked'" in str(found.summary())


def test_gaps_are_bridged_briefly_and_never_outside() -> None:
    a = mover(50, 2.0)
    xyz = np.array(a.xyz_m)
    xyz[10:15, 0], xyz[40:80, 1] = np.nan, np.nan
    holed = Tracks("holed", NAMES, a.t_s, xyz)
    at = holed.at(a.t_s)
    assert np.isfinite(at[12, 0]).all() and np.isnan(at[60, 1]).all() and np.isfinite(at[60, 2]).all()
    assert np.isnan(holed.at(np.array([-0.1, 2.5]))).all()


def test_parts_of_one_session_that_hardly_overlap_keep_their_clock() -> None:
    whole = mover(50)
    first, last = (replace(whole, t_s=whole.t_s[part], xyz_m=whole.xyz_m[part]) for part in (slice(0, 200), slice(160, 375)))
    found = compare(first, last, space=False)
    assert found.alignment.offset_s == pytest.approx(0, abs=1e-3)
    assert found.errors.mpjpe_mm < 1


@pytest.mark.parametrize("begins_s", [3.5, 4.5])
def test_an_offset_between_parts_of_one_clock_is_doubted(begins_s: float) -> None:
    """Parts of one session that hardly overlap, tracked with two rigs, were moved onto each other without a word."""
    a = mover(50, 4.0)
    doubts = {}
    for name, other in (("part", mover(50, 4.0, begins_s)), ("whole", mover(50, 8.0)), ("late", replace(a, t_s=a.t_s + 0.5))):
        found = compare(a, replace(other, name=name))
        notes = [block for block in comparison_page(found).blocks if isinstance(block, Note) and block.warning]
        doubts[name] = "".join(note.text for note in notes)
        assert found.summary()[0] == notes[0] if notes else True
    words = f"by their own times 50 Hz and part have {max(0.0, 4.0 - begins_s):.1f} s in common"
    assert doubts["part"].startswith(words) and "`align_time=False`" in doubts["part"]
    assert doubts["whole"] == doubts["late"] == ""


def test_a_mirror_image_is_not_taken_for_a_rotation() -> None:
    points = np.random.default_rng(1).normal(size=(30, 3))
    rotation, _, _ = similarity(points * [1, 1, -1], points, scale=False)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_nothing_in_common_is_reported_with_the_names() -> None:
    a = mover(50)
    refusal(InputError, r"neck.*tail|tail.*neck", lambda: compare(a, Tracks("other", ("tail",), a.t_s, a.xyz_m[:, :1])))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("overlap_s", [10.0, 7.0])
def test_rounds_of_one_circle_are_compared_by_their_own_times(seed: int, overlap_s: float) -> None:
    """Some steps later the same figure walks the same way, turned by as much as it went round in them."""
    t_s, rng = np.arange(0, 10, 1 / 30), np.random.default_rng(seed)
    heading, steps = 2 * np.pi * t_s / 6, 2 * np.pi * t_s / 1.0
    turned = Rotation.from_rotvec(heading[:, None] * [0, 0, 1]).as_matrix()
    swing = 0.3 * np.sin(steps[:, None] + np.array([0, 0, np.pi, np.pi, 0]))
    rest = np.array([[0, 0, 1.5], [0, 0.3, 1], [0, -0.3, 1], [0, 0.1, 0.1], [0, -0.1, 0.1]])
    body = rest + np.stack([1.3 + 0 * swing, swing * [0, 1, 1, 1, 1], 0 * swing], axis=-1)
    xyz = np.einsum("tij,tkj->tki", turned, body)
    a, b = (Tracks(name, NAMES, t_s, xyz + rng.normal(0, 0.004, xyz.shape)) for name in "ab")
    later = t_s >= 10 - overlap_s
    found = compare(a, replace(b, t_s=t_s[later], xyz_m=b.xyz_m[later]))
    assert found.alignment.offset_s == pytest.approx(0, abs=0.005)
    assert np.trace(found.alignment.rotation) == pytest.approx(3, abs=0.01)


@pytest.mark.parametrize("space", [True, False])
def test_a_single_time_step_is_too_little_to_find_an_offset(space: bool) -> None:
    one = mover(50, 0.02)
    for pair in ((one, mover(50)), (mover(50), one)):
        refusal(InputError, "too few points are known in both", compare, *pair, space=space)


@pytest.mark.parametrize("late_s", [0.4, 1.3, 2.2])
def test_whole_gait_cycles_are_distinguished_by_positions_where_speeds_repeat(late_s: float) -> None:
    def walk(t_s: np.ndarray) -> np.ndarray:
        """Straight on at 1.2 m/s; limbs swing with a period of 1.1 s, so speeds are the same every cycle."""
        phase = 2 * np.pi * t_s / 1.1
        swings = np.stack([np.sin(phase), np.sin(phase + np.pi), 0 * phase, 0.5 * np.cos(phase)], axis=1)
        forward, height = 1.2 * t_s[:, None] + 0.3 * swings, np.array([0.1, 0.1, 1.0, 1.4])
        return np.stack([forward, np.broadcast_to([0.1, -0.1, 0.0, 0.2], forward.shape), 0 * forward + height], axis=-1)

    names = ("left_ankle", "right_ankle", "mid_hip", "left_wrist")
    t_a, t_b = np.arange(late_s, 6.0, 1 / 100), np.arange(0.0, 6.0, 1 / 60)
    noise = np.random.default_rng(3).normal(0, 0.002, (len(t_b), len(names), 3))
    a, b = Tracks("a", names, t_a - late_s, walk(t_a)), Tracks("b", names, t_b, walk(t_b) + noise)
    assert compare(a, b, space=False).alignment.offset_s == pytest.approx(-late_s, abs=2e-3)


@pytest.mark.parametrize("space", [True, False])
def test_a_few_points_that_are_metres_wrong_do_not_shift_the_offset(space: bool) -> None:
    a, b, rng = mover(30), mover(30), np.random.default_rng(0)
    xyz = b.xyz_m + rng.normal(0, 0.004, b.xyz_m.shape)
    xyz[rng.uniform(size=xyz.shape[:2]) < 0.004] += [3.0, 0.0, -2.0]
    assert compare(a, Tracks("b", NAMES, b.t_s - 0.9, xyz), space=space).alignment.offset_s == pytest.approx(0.9, abs=0.1 / 30)


def exhaustive_costs(a: Tracks, b: Tracks, rate_hz: float) -> dict[int, float]:
    """Mean absolute difference of speeds at every shift, one after the other: an answer that shares no code."""
    tables = []
    for one in (a, b):
        xyz = one.at(np.arange(one.t_s[0], one.t_s[-1], 1 / rate_hz))
        speed = np.full(xyz.shape[:2], np.nan)
        speed[2:-2] = np.linalg.norm(xyz[4:] - xyz[:-4], axis=-1) * rate_hz / 4
        tables.append(speed)
    least, costs = min(map(len, tables)) // 2, {}
    for lag in range(least - len(tables[1]), len(tables[0]) - least + 1):
        start, end = max(0, lag), min(len(tables[0]), len(tables[1]) + lag)
        apart = np.abs(tables[0][start:end] - tables[1][start - lag : end - lag])
        costs[lag] = float(np.nanmean(apart)) if np.isfinite(apart).mean() > 0.1 else np.nan
    return costs


@pytest.mark.parametrize("seed", range(6))
def test_all_shifts_at_once_find_what_every_shift_tried_alone_finds(seed: int) -> None:
    """Random motion with gaps, noise and false jumps; the second recording begins and ends elsewhere."""
    rng, rate_hz = np.random.default_rng(seed), 30.0
    t_s = np.arange(round(40 * rate_hz)) / rate_hz
    waves = np.sin(2 * np.pi * rng.uniform(0.1, 1.5, (1, 5, 3, 4)) * t_s[:, None, None, None] + rng.uniform(0, 6, (1, 5, 3, 4)))
    xyz = (0.15 * waves).sum(axis=-1)
    late_s, cut = float(rng.uniform(-8, 8)), slice(round(5 * rate_hz), round(33 * rate_hz))
    other = xyz[cut] + rng.normal(0, 0.004, xyz[cut].shape)
    other[rng.uniform(size=other.shape[:2]) < 0.004] += [3.0, 0.0, -2.0]
    other[rng.integers(0, 700) :, rng.integers(0, 5)] = np.nan
    a, b = Tracks("a", NAMES, t_s, xyz), Tracks("b", NAMES, t_s[cut] - late_s, other)
    lag_s, cost = _speed_costs(a, b)
    expected = exhaustive_costs(a, b, 60.0)
    first_s = a.t_s[0] - b.t_s[0]
    np.testing.assert_allclose(lag_s, np.array(list(expected)) / 60.0 + first_s, atol=1e-9)
    np.testing.assert_array_equal(np.isnan(cost), np.isnan(list(expected.values())))
    best = min(expected, key=lambda lag: np.nan_to_num(expected[lag], nan=np.inf))
    assert lag_s[np.nanargmin(cost)] == pytest.approx(best / 60.0 + first_s, abs=1e-9)


def test_an_hour_is_aligned_by_its_details() -> None:
    """The whole hour is compared at the full rate: one cycle of a second looks like all others."""
    rng, rate_hz = np.random.default_rng(1), 20.0
    t_s = np.arange(round(3600 * rate_hz)) / rate_hz
    slow = np.cumsum(rng.normal(0, 0.01, (len(t_s), 3, 3)), axis=0)
    a = Tracks("a", NAMES[:3], t_s, slow + 0.3 * np.sin(2 * np.pi * t_s)[:, None, None] * [1, 0, 0.2])
    b = Tracks("b", NAMES[:3], t_s[20_000:60_000] + 123.456, a.xyz_m[20_000:60_000])
    assert compare(a, b).alignment.offset_s == pytest.approx(-123.456, abs=1e-3)


# --- comparisons as a user runs them


MARKERS = ("RShoulder", "LShoulder", "RWrist", "LWrist")


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [
        ("RShoulder", "right_shoulder"), ("LBigToe", "left_big_toe"), ("jRightHip", "right_hip"), ("right hip", "right_hip"),
        ("Hip", "mid_hip"), ("left_foot_index", "left_big_toe"), ("model:LKnee", "left_knee"), ("ankle.left", "left_ankle"),
        ("Neck", "neck"),
    ],
)  # fmt: skip
def test_names_of_other_systems_are_understood(theirs: str, ours: str) -> None:
    assert plain_name(theirs) == ours


@pytest.fixture
def trc(tmp_path: Path) -> Path:
    t_s = np.arange(120) / 60
    xyz = np.random.default_rng(0).normal(size=(1, 4, 3)) + 0.3 * np.sin(3 * t_s[:, None, None] + np.arange(12).reshape(4, 3))
    write_trc(tmp_path / "a.trc", TrcData(names=MARKERS, t_s=t_s, xyz_world=xyz, rate_hz=60.0))
    return tmp_path / "a.trc"


def test_a_file_compared_with_its_delayed_copy_of_another_kind(trc: Path, capsys, read_page) -> None:
    a = read_tracks(trc)
    assert "neck" in a.points and "mid_hip" not in a.points
    csv = trc.with_name("b.csv")
    lines = ["t_s," + ",".join(f"{name}_{axis}" for name in MARKERS for axis in "xyz")]
    lines += [f"{t + 0.1:.6f}," + ",".join(f"{v:.7f}" for v in row[:4].ravel()) for t, row in zip(a.t_s, a.xyz_m, strict=True)]
    csv.write_text("\n".join(lines) + "\n")
    found = figures(capsys, "compare", trc, csv, "--out", trc.parent / "out")
    assert found["offset_s"] == pytest.approx(-0.1, abs=5e-4)
    assert found["mean_mm"] < 0.5
    assert json.loads((trc.parent / "out" / "compare.json").read_text())["mean_mm"] == found["mean_mm"]
    page = read_page(trc.parent / "out" / "compare.html")
    assert page.headings[0] == "b.csv compared with a.trc" and "right shoulder" in page.tables[1][-1] + page.tables[1][1]
    [one, other] = page.plot("right shoulder, x")["series"]
    np.testing.assert_allclose(one["y"][1:-1], other["y"][1:-1], atol=0.005)


def test_a_result_is_the_same_as_each_of_its_files(demo_session, tmp_path, capsys) -> None:
    result = tracked(demo_session, tmp_path / "result", "trc,c3d,csv", 1.0)
    for kind in ("trc", "c3d"):
        [file] = result.glob(f"*.{kind}")
        found = figures(capsys, "compare", result, file)
        assert found["mean_mm"] < 0.01 and abs(found["offset_s"]) < 1e-4 and len(found["points"]) > 12


def test_a_file_of_several_subjects_is_refused_by_their_names(trc: Path) -> None:
    data = read_trc(trc)
    both = [f"{subject}:{name}" for subject in ("Ann", "Ben") for name in data.names]
    write_trc(trc, replace(data, names=tuple(both), xyz_world=np.concatenate([data.xyz_world, data.xyz_world + 1], axis=1)))
    refusal(InputError, r"a\.trc: expected one subject, got Ann, Ben; export", read_tracks, trc)
    write_trc(trc, replace(data, names=tuple(both[:4])))
    assert read_tracks(trc).points[:4] == tuple(plain_name(name) for name in data.names)


def test_a_point_that_a_file_has_under_two_names_counts_once() -> None:
    a = mover(60)
    twice = Tracks("twice", (*NAMES, NAMES[0]), a.t_s, np.concatenate([a.xyz_m, a.xyz_m[:, :1]], axis=1))
    assert compare(twice, a).points == NAMES


def test_what_cannot_be_compared_is_reported_in_one_line(trc: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = trc.with_suffix(".xyz")
    other.write_text("?")
    assert "expected a posefuse result folder" in error(capsys, "compare", trc, other)
    assert "no such file" in error(capsys, "compare", trc, trc.with_name("none.trc"))
