"""A recording in the hand: tables, files, the second solve."""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import built
import numpy as np
import pytest
from checks import assert_same, refusal

import posefuse as pf
from posefuse import core
from posefuse.api.recording import recording_of
from posefuse.api.rig_and_detector import rig_of
from posefuse.core import DependencyError, InputError
from posefuse.formats.truth import read_truth

Make = Callable[..., pf.Recording]


def test_its_repr_is_a_few_lines(make_recording: Make) -> None:
    lines = repr(make_recording()).splitlines()
    assert 3 <= len(lines) <= 8
    assert max(map(len, lines)) < 120


def test_the_table_has_a_row_per_time_step_person_and_keypoint(make_recording: Make) -> None:
    recording = make_recording(people=(7, 3), times=5)
    table = recording.to_dataframe()
    assert len(table) == 5 * 2 * 33
    row = table[(table.person == 3) & (table.keypoint == "nose")].iloc[4]
    np.testing.assert_array_equal([row.x_m, row.y_m, row.z_m], recording.keypoint("nose")[4, 1])
    assert row.time_s == recording.t_s[4] == pytest.approx(5 + 4 * 0.033333333)
    assert row.sigma_m == pytest.approx(np.sqrt((1e-4 + 4e-4 + 9e-4) / 3))


def test_several_people_must_be_distinguished(make_recording: Make) -> None:
    recording = make_recording(people=(7, 3))
    refusal(InputError, r"choose one with \.of", lambda: recording.joint_angles(fit="none")["left_knee", "flexion"])


def test_one_angle_by_name(make_recording: Make) -> None:
    angles = make_recording().joint_angles(fit="none")
    knee = angles["left_knee", "flexion"]
    np.testing.assert_allclose(knee.deg, np.degrees(knee.rad))
    assert knee.rad.shape == knee.sigma_rad.shape == (9,)
    refusal(InputError, r"no joint 'left_nee'.*left_knee", lambda: angles["left_nee", "flexion"])
    refusal(InputError, r"no angle 'bend'.*flexion", lambda: angles["left_knee", "bend"])


def test_what_is_saved_is_read_to_the_last_bit(make_recording: Make, tmp_path: Path) -> None:
    recording = make_recording(people=(7, 3))
    written = recording.save(tmp_path / "result", formats=("trc", "csv"))
    assert {path.name for path in written} >= {"recording.npz", "pose.csv"}
    again = pf.read(tmp_path / "result")
    assert isinstance(again, pf.Recording)
    assert_same((again.poses, again.provenance), (recording.poses, recording.provenance))


def test_saving_does_not_touch_what_is_there(make_recording: Make, tmp_path: Path) -> None:
    (tmp_path / "result").mkdir()
    (tmp_path / "result" / "thesis.txt").write_text("years of work")
    refusal(InputError, r"thesis\.txt", lambda: make_recording().save(tmp_path / "result", replace=True))
    assert (tmp_path / "result" / "thesis.txt").read_text() == "years of work"


def test_a_recording_knows_the_corrections_that_it_was_made_with(make_recording: Make) -> None:
    recording = make_recording()
    made = replace(recording, provenance={**recording.provenance, "edits": {"person": 7}})
    assert (recording.edits, made.edits) == (pf.Edits(), pf.Edits(person=7))


def test_its_report_has_a_usual_place(saved_walk: tuple[Path, Path], make_recording: Make, tmp_path: Path) -> None:
    _, result = saved_walk
    assert make_recording().report_page is None
    assert pf.read(result).report_page == result / "biomechanics" / "report.html"
    live = replace(make_recording(), path=tmp_path / "walk.mcap")
    assert live.report_page == tmp_path / "walk_biomechanics" / "report.html"


def test_who_walks_has_a_gait_and_who_does_not_has_none(make_recording: Make, demo_session: Path) -> None:
    assert make_recording(people=(7, 3)).gait() == (None, None)
    truth = read_truth(demo_session / "truth" / "truth.npz")
    walk = built.poses(truth.xyz_world, 1e-3, t_ns=truth.t_ns, skeleton=truth.skeleton, ids=truth.person_id)
    [gait] = recording_of(built.recording(truth.rig, walk)).gait()
    assert gait is not None and all(len(gait.strike_s[side]) > 1 for side in ("left", "right"))


def test_without_its_videos_nothing_is_played(saved_walk: tuple[Path, Path], make_recording: Make, tmp_path: Path) -> None:
    _, result = saved_walk
    for recording, within, images in ((pf.read(result), None, True), (pf.read(result), tmp_path / "other", False),
                                      (make_recording(), None, False)):  # fmt: skip
        with recording.playback(within=within) as playback:
            seen = playback.at(recording.rig.names[0], int(recording.poses.t_ns[3]), 480)
            assert playback.has_images == images == (seen is not None)


def test_one_without_settings_cannot_be_solved_again(make_recording: Make) -> None:
    refusal(InputError, "provenance has no settings", lambda: make_recording().solve())


def test_angles_are_a_table_of_their_own(make_recording: Make) -> None:
    angles = make_recording(people=(7, 3), times=5).joint_angles(fit="none")
    one = angles.of(3)
    knee = one["left_knee", "flexion"]
    table = one.to_dataframe()
    assert isinstance(one, pf.JointAngles) and len(angles.to_dataframe()) == 2 * len(table)
    rows = table[(table.joint == "left_knee") & (table.angle == "flexion")]
    np.testing.assert_allclose(rows.deg, knee.deg)
    np.testing.assert_allclose(rows.sigma_deg, knee.sigma_deg)


def test_tables_name_their_extra(make_recording: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    recording = make_recording()
    angles = recording.joint_angles(fit="none")
    for call in (recording.to_dataframe, angles.to_dataframe):
        refusal(DependencyError, r"install it with: pip install 'posefuse\[data\]'", call)


# --- a rig in the hand triangulates what it projects


def test_it_finds_the_points_it_projected(ring_rig: Callable[..., core.Rig]) -> None:
    rig = rig_of(ring_rig(5))
    xyz = np.array([[0.1, -0.2, 1.0], [0.4, 0.3, 1.6], [-0.3, 0.2, 0.1]])
    found, cov, reproj = rig.triangulate(rig.project(xyz))
    np.testing.assert_allclose(found, xyz, atol=1e-9)
    assert cov.shape == (3, 3, 3) and (reproj < 1e-6).all()


def test_what_is_made_of_it_stays_a_handle_and_it_is_not_saved_over_anything(demo_session: Path, tmp_path: Path) -> None:
    rig = pf.read_rig(demo_session / "rig.toml")
    assert isinstance(rig.only(["cam02", "cam00"]), pf.Rig) and "cam00" in repr(rig)
    assert pf.read_rig(rig.save(tmp_path / "rig.toml")).id == rig.id
    refusal(InputError, r"rig\.toml", rig.save, tmp_path / "rig.toml")
