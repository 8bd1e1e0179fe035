"""The report page: whole in itself, truthful about gaps, harmless text, clear errors; its figures are those of the recording."""

import csv
import statistics
from dataclasses import replace
from itertools import pairwise

import ezc3d
import numpy as np
import pytest
from built import poses, recording_from_views
from motions import columns_of

from posefuse import __version__
from posefuse.core import SKELETONS, InputError
from posefuse.evaluation.biomechanics import BiomechanicsSettings, write_biomechanics
from posefuse.evaluation.gait_cycles import PERCENT, gait_cycles, write_gait_cycles
from posefuse.evaluation.report import (
    QUALITY_COLUMNS,
    RANGES,
    longest_gap,
    parameter_blocks,
    quality_rows,
    spread_text,
    time_plots,
    write_report,
)
from posefuse.formats.page import MISSING
from posefuse.kinematics import JOINTS, joints_from_poses
from posefuse.kinematics.gait import Spread, gait_from_poses

SKELETON = SKELETONS["anatomical23"]


def walker(times=240, rate_hz=60.0, people=1):
    """A figure of two stiff legs that strides along x at 1.2 m/s."""
    t = np.arange(times) / rate_hz
    xyz = np.full((times, people, len(SKELETON), 3), np.nan)

    def put(name, x, y, z):
        xyz[:, :, SKELETON.index(name)] = np.stack([x + 1.2 * t, y + 0 * t, z + 0 * t], axis=-1)[:, None]

    for side, y, phase in (("left", 0.1, 0.0), ("right", -0.1, np.pi)):
        swing = 0.35 * np.sin(2 * np.pi * t + phase)
        put(f"{side}_shoulder", 0, 2 * y, 1.45)
        put(f"{side}_hip", 0, y, 0.95)
        put(f"{side}_knee", swing / 2 + 0.08, y, 0.5)
        put(f"{side}_ankle", swing, y, 0.09)
        put(f"{side}_heel", swing - 0.05, y, 0.03)
        put(f"{side}_big_toe", swing + 0.17, y, 0.03)
        put(f"{side}_small_toe", swing + 0.16, y, 0.03)
    return xyz, np.round(t * 1e9).astype(np.int64)


def recording_of(ring_rig, xyz, t_ns, provenance=None):
    rig = ring_rig(4)
    shape = (len(t_ns), xyz.shape[1], 4, len(SKELETON))
    seen, unstated = np.zeros(shape), np.full(shape, np.nan)
    made = poses(xyz, t_ns=t_ns, skeleton=SKELETON)
    return recording_from_views(rig, made, np.full((*shape, 2), np.nan), seen, unstated, provenance or {})


def reported(read_page, tmp_path, recording, *more):
    return read_page(write_report(recording, joints_from_poses(recording.poses), tmp_path / "r.html", *more))


def test_the_page_states_session_rig_and_version(read_page, tmp_path, ring_rig):
    recording = recording_of(ring_rig, *walker(), {"session": "trial <3>", "version": "1 & <2>"})
    page = reported(read_page, tmp_path, recording, "Knee study <b>")
    about = dict(page.tables[0])
    assert page.headings[0] == "Knee study <b>" and about["session"] == "trial <3>"
    assert recording.rig.id[:12] in about["rig"] and "4 cameras" in about["rig"] and about["version"] == f"posefuse {__version__}"
    assert "1 & <2>" in page.text


def test_a_refused_calibration_is_stated(read_page, tmp_path, ring_rig):
    recording = recording_of(ring_rig, *walker())
    refused = replace(recording, rig=replace(recording.rig, refused="corners fit"))
    said = "calibration was refused (corners fit) and kept all the same: do not trust positions"
    assert said in reported(read_page, tmp_path, refused).text
    assert "refused" not in reported(read_page, tmp_path, recording).text


def test_how_well_the_cameras_fit_is_stated_and_what_is_wrong_with_the_rig(read_page, tmp_path, ring_rig):
    fit = {"seen": 1.0, "left_out": 0.87, "reproj_px": 84.3, "sigmas": 9.4}
    unseen = {"seen": 0.0, "left_out": 0.0, "reproj_px": None, "sigmas": None}
    about = {"camera_fits": {"cam02": fit, "cam03": unseen}, "rig_warnings": ["cam02 is off by 160 mm"]}
    page = reported(read_page, tmp_path, recording_of(ring_rig, *walker(), about))
    rows = {row[0]: row for table in page.tables for row in table if row[0] in about["camera_fits"]}
    assert rows["cam02"][1:] == ["100%", "87%", "84.3", "9.4"]
    assert rows["cam03"][1:3] == ["0%", "0%"]
    assert "cam02 is off by 160 mm" in page.text


@pytest.mark.parametrize(
    ("provenance", "shown"),
    [
        ({"recorded": "2026-03-01T09:30:00Z"}, "2026-03-01 09:30:00 UTC"),
        ({"start_ns": 1_772_357_400 * 10**9}, "2026-03-01 09:30:00 UTC"),
        ({"start_ns": 5 * 10**9}, "not stated by the files"),
        ({}, "not stated by the files"),
    ],
)
def test_the_date_of_the_recording_is_the_one_that_its_files_state(read_page, tmp_path, ring_rig, provenance, shown):
    page = reported(read_page, tmp_path, recording_of(ring_rig, *walker(), provenance))
    assert dict(page.tables[0])["date of the recording"] == shown


def test_gait_parameters_are_those_of_the_recording(read_page, tmp_path, ring_rig):
    recording = recording_of(ring_rig, *walker())
    page = reported(read_page, tmp_path, recording)
    rows = {(row[0], row[1]): row for row in page.tables[1]}
    gait = gait_from_poses(recording.poses)
    speed, step = rows["Walking speed", ""], rows["Step length", "left"]
    assert speed[2] == f"{gait.speed_m_s:.2f}\N{NO-BREAK SPACE}m/s"
    assert step[2].endswith(f"({gait.step_length_m['left'].count})")
    assert rows["Double support", ""][2].endswith(f"({gait.double_support_share.count})")
    assert rows["Asymmetry of the step length", ""][2] == "+0\N{NO-BREAK SPACE}%"
    assert set(RANGES) <= {(j.name.removeprefix("left_"), angle) for j in JOINTS for angle in j.angle_names}


def test_angles_over_time_are_those_of_the_recording_with_gaps_and_bands(read_page, tmp_path, ring_rig):
    xyz, t_ns = walker()
    xyz[60:90, :, SKELETON.index("left_knee")] = np.nan
    recording = recording_of(ring_rig, xyz, t_ns)
    joints = joints_from_poses(recording.poses)
    [plot] = [one for one in reported(read_page, tmp_path, recording).data["plots"] if one["title"] == "Knee flexion"
              and one["x"] == "s"]  # fmt: skip
    for side in ("left", "right"):
        q = joints.joints.index(f"{side}_knee")
        angle, sigma = np.degrees(joints.angle_rad[:, 0, q, 0]), np.degrees(joints.sigma_rad[:, 0, q, 0])
        [line] = [one for one in plot["series"] if one["type"] == "line" and one["colour"] == side]
        [band] = [one for one in plot["series"] if one["type"] == "band" and one["colour"] == side]
        np.testing.assert_allclose(line["y"], angle, atol=0.01)
        np.testing.assert_allclose(band["high"] - band["low"], 4 * sigma, atol=0.1)
        assert np.isnan(line["y"][60:90]).all() == (side == "left")


@pytest.mark.parametrize("fit", ["none", "points"])
def test_foot_strikes_and_foot_offs_are_the_same_in_all_files(tmp_path, ring_rig, fit):
    """Those of `Recording.gait`, of the page and of a study, also where the fit moves points: noise of 2 cm moves events."""
    xyz, t_ns = walker()
    recording = recording_of(ring_rig, xyz + np.random.default_rng(2).normal(0, 0.02, xyz.shape), t_ns)
    write_biomechanics(recording, tmp_path, BiomechanicsSettings(fit=fit))
    groups, gait = ezc3d.c3d(str(tmp_path / "points_angles.c3d"))["parameters"], gait_from_poses(recording.poses)
    event, seconds = groups["EVENT"], groups["EVENT"]["TIMES"]["value"][1]
    kinds = list(zip(event["CONTEXTS"]["value"], event["LABELS"]["value"], strict=True))
    for label, times in (("Foot Strike", gait.strike_s), ("Foot Off", gait.off_s)):
        for side in ("left", "right"):
            written = [t_s for t_s, kind in zip(seconds, kinds, strict=True) if kind == (side.title(), label)]
            np.testing.assert_allclose(written, times[side], atol=1e-5)
    assert np.all(np.diff(seconds) >= 0) and groups["SUBJECTS"]["NAMES"]["value"] == ["person 0"]
    begins = {side: np.round(gait.strike_s[side], 4) for side in ("left", "right")}
    assert all(float(row["begin_s"]) in begins[row["side"]] for row in read_rows(tmp_path / "gait_cycles.csv"))


def test_every_file_has_the_time_of_the_session(read_page, tmp_path, ring_rig):
    """Also of a recording that begins later: what is read off one file is found at that time in the others."""
    xyz, t_ns = walker()
    recording = recording_of(ring_rig, xyz, t_ns + 2_000_000_000)
    write_biomechanics(recording, tmp_path, BiomechanicsSettings(fit="none"))
    angles, cycles = (read_rows(tmp_path / name) for name in ("angles.csv", "gait_cycles.csv"))
    knee, motion = next(row for row in cycles if row["joint"] == "left_knee"), columns_of(tmp_path / "angles.mot")
    assert float(angles[0]["t_s"]) == motion["time"][0] == 2
    begin = [abs(float(row["t_s"]) - float(knee["begin_s"])) < 1e-4 for row in angles].index(True)
    found_deg = [float(knee["deg_at_0"]), float(angles[begin]["left_knee.flexion_deg"]), motion["knee_angle_l"][begin]]
    np.testing.assert_allclose(found_deg, found_deg[0], atol=6e-4)
    data = read_page(tmp_path / "report.html").data
    plots = [one["x"] for plot in data["plots"] if plot["x"] == "s" for one in plot["series"]]
    assert data["players"][0]["t"][0] == min(map(min, plots)) == 2
    file = ezc3d.c3d(str(tmp_path / "points_angles.c3d"))["parameters"]
    assert file["EVENT"]["TIMES"]["value"][1].min() < 1 and file["POSEFUSE"]["START_NS"]["value"][0].startswith("2000000000")


def read_rows(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_the_mean_cycle_is_the_mean_of_the_strides(read_page, tmp_path, ring_rig):
    recording = recording_of(ring_rig, *walker(times=480))
    joints, gait = joints_from_poses(recording.poses), gait_from_poses(recording.poses)
    [plot] = [one for one in reported(read_page, tmp_path, recording).data["plots"] if one["title"] == "Hip flexion"
              and one["x"] != "s"]  # fmt: skip
    q, t_s = joints.joints.index("right_hip"), recording.poses.t_ns / 1e9
    hip_deg, strikes = np.degrees(joints.angle_rad[:, 0, q, 0]), gait.strike_s["right"]
    strides = [np.interp(a + (b - a) * PERCENT / 100, t_s, hip_deg) for a, b in pairwise(strikes)]
    [mean] = [one for one in plot["series"] if one["type"] == "line" and one["colour"] == "right" and "faint" not in one]
    [band] = [one for one in plot["series"] if one["type"] == "band" and one["colour"] == "right"]
    faint = [one for one in plot["series"] if one.get("faint") and one["colour"] == "right"]
    np.testing.assert_allclose(mean["y"], np.mean(strides, axis=0), atol=0.01)
    np.testing.assert_allclose(band["high"] - band["low"], 2 * np.std(strides, axis=0), atol=0.1)
    np.testing.assert_allclose([one["y"] for one in faint], strides, atol=0.01)
    least, most = plot["ranges"][1]
    assert least < min(band["low"]) and most > max(band["high"])


def test_cycles_leave_out_pauses_and_what_is_not_known(ring_rig):
    xyz, t_ns = walker(times=480)
    xyz[200:230, :, SKELETON.index("left_knee")] = np.nan
    recording = recording_of(ring_rig, xyz, t_ns)
    joints, gait = joints_from_poses(recording.poses), gait_from_poses(recording.poses)
    whole = {one.joint: one for one in gait_cycles(joints, 0, gait) if one.angle == "flexion"}
    assert len(whole["left_knee"].angle_rad) == len(whole["right_knee"].angle_rad) - 1
    knee = whole["left_knee"]
    assert not any(begin < 200 / 60 < end for begin, end in zip(knee.begin_s, knee.end_s, strict=True))
    strikes = {side: np.concatenate([times, times[-1:] + 4.0]) for side, times in gait.strike_s.items()}
    object.__setattr__(gait, "strike_s", strikes)
    again = {one.joint: one for one in gait_cycles(joints, 0, gait) if one.angle == "flexion"}
    np.testing.assert_array_equal(again["right_knee"].angle_rad, whole["right_knee"].angle_rad)


def test_the_pelvis_turns_relative_to_the_walk(ring_rig):
    xyz, t_ns = walker(times=480)
    turned = np.linspace(0, 2, 480)
    turn = np.zeros((480, 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(turned)
    turn[:, 1, 0], turn[:, 0, 1], turn[:, 2, 2] = np.sin(turned), -np.sin(turned), 1
    for rotated in (xyz, np.einsum("tij,tnkj->tnki", turn, xyz)):
        recording = recording_of(ring_rig, rotated, t_ns)
        gait = gait_from_poses(recording.poses)
        cycles = gait_cycles(joints_from_poses(recording.poses), 0, gait)
        [pelvis] = [one for one in cycles if (one.joint, one.angle) == ("pelvis", "rotation_left")]
        assert np.abs(np.degrees(pelvis.angle_rad)).max() < 2


def test_every_cycle_is_a_row_of_the_table(tmp_path, ring_rig):
    recording = recording_of(ring_rig, *walker())
    cycles = gait_cycles(joints_from_poses(recording.poses), 0, gait_from_poses(recording.poses))
    lines = write_gait_cycles(tmp_path / "c.csv", {3: cycles}).read_text().splitlines()
    assert len(lines) == 1 + sum(len(one.angle_rad) for one in cycles)
    row = lines[1].split(",")
    assert row[:5] == ["3", cycles[0].joint, cycles[0].angle, cycles[0].side, "1"]
    np.testing.assert_allclose([float(cell) for cell in row[7:]], np.degrees(cycles[0].angle_rad[0]), atol=6e-4)


def test_the_player_shows_the_recording(read_page, tmp_path, ring_rig):
    recording = recording_of(ring_rig, *walker(times=60))
    [content] = reported(read_page, tmp_path, recording).data["players"]
    knee = SKELETON.index("left_knee")
    again = np.array(content["people"][0]["xyz"][knee], float).T
    np.testing.assert_allclose(again, recording.poses.xyz_world[::2, 0, knee], atol=5.1e-4)
    assert content["bones"] == SKELETON.bone_indices.tolist()
    assert [SKELETON.index("right_hip"), SKELETON.index("left_hip")] in content["across"]


def test_several_people_and_no_person(read_page, tmp_path, ring_rig):
    xyz, t_ns = walker(people=2)
    xyz[:, 1] = np.nan
    recording = recording_of(ring_rig, xyz, t_ns)
    page = reported(read_page, tmp_path, recording)
    assert any(heading.startswith("Person 0") for heading in page.headings) and "Person 1" in page.headings
    assert "Not seen in any time step" in page.text
    no_person = recording_of(ring_rig, xyz[:, :0], t_ns)
    assert reported(read_page, tmp_path, no_person).headings == ["Motion report"]


def test_standing_is_not_called_walking(read_page, tmp_path, ring_rig):
    xyz, t_ns = walker()
    recording = recording_of(ring_rig, np.broadcast_to(xyz[:1], xyz.shape), t_ns)
    page = reported(read_page, tmp_path, recording)
    assert "No walking found" in page.text and not any("gait cycle" in heading for heading in page.headings)


def test_joints_of_another_recording_are_refused(tmp_path, ring_rig):
    recording = recording_of(ring_rig, *walker())
    other = recording_of(ring_rig, *walker(times=200))
    with pytest.raises(InputError, match="expected joints of the 240 time steps"):
        write_report(recording, joints_from_poses(other.poses), tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()


def test_quality_counts_what_was_measured(ring_rig):
    xyz, t_ns = walker()
    knee = SKELETON.index("left_knee")
    xyz[60:120, :, knee] = np.nan
    rows = {
        row[0].value: dict(zip(QUALITY_COLUMNS, row, strict=True)) for row in quality_rows(recording_of(ring_rig, xyz, t_ns), 0)
    }
    assert (rows["left knee"]["measured"], rows["left knee"]["longest gap s"]) == ("75 %", "1.02")
    assert longest_gap(t_ns * 1e-9, np.isfinite(xyz[:, 0, knee, 0])) == pytest.approx(61 / 60, abs=1e-6)
    assert (rows["right knee"]["longest gap s"], rows["right knee"]["standard deviation mm"]) == ("0.00", "10.0")
    assert (rows["nose"]["measured"], rows["nose"]["longest gap s"], rows["nose"]["keypoint"].tone) == ("0 %", "3.98", "bad")


@pytest.mark.parametrize(("left_m", "right_m", "stated"), [(0.66, 0.54, "+20"), (0.54, 0.66, "-20"), (0.599, 0.6, "+0")])
def test_a_side_that_takes_longer_steps_is_stated(ring_rig, left_m, right_m, stated):
    xyz, t_ns = walker()
    gait = gait_from_poses(recording_of(ring_rig, xyz, t_ns).poses)
    longer = replace(gait, step_length_m={**gait.step_length_m, "left": Spread(left_m, 0.0, 3), "right": Spread(right_m, 0.0, 3)})
    rows = {row[0]: row for row in parameter_blocks(longer, [])[0].rows}
    assert rows["Asymmetry of the step length"][2] == f"{stated}\N{NO-BREAK SPACE}%"
    unknown = replace(gait, step_length_m={**gait.step_length_m, "left": Spread.of([])})
    assert {row[0]: row for row in parameter_blocks(unknown, [])[0].rows}["Asymmetry of the step length"][2] == MISSING


def test_deviations_of_few_steps_and_strides_are_those_of_a_sample(ring_rig):
    lengths_m = [0.61, 0.64, 0.72]
    assert Spread.of(lengths_m).sd == pytest.approx(statistics.stdev(lengths_m))
    assert spread_text(Spread.of(lengths_m), "m").endswith("m (3)") and "±" not in spread_text(Spread.of(lengths_m[:1]), "m")
    recording = recording_of(ring_rig, *walker())
    for one in gait_cycles(joints_from_poses(recording.poses), 0, gait_from_poses(recording.poses)):
        few = replace(one, angle_rad=np.array([[0.1], [0.2], [0.6]]) + np.zeros(101))
        np.testing.assert_allclose(few.sd_rad, statistics.stdev([0.1, 0.2, 0.6]))


def test_a_person_who_turns_has_no_range_of_pelvis_rotation(read_page, tmp_path, ring_rig):
    xyz, t_ns = walker()
    recording = recording_of(ring_rig, xyz, t_ns, {"config": {"names": ["Anna"]}})
    joints = joints_from_poses(recording.poses)
    q, a = joints.joints.index("pelvis"), joints.angle_names[joints.joints.index("pelvis")].index("rotation_left")
    angle = joints.angle_rad.copy()
    angle[:, 0, q, a] = np.linspace(0, 5.6, len(angle))
    page = read_page(write_report(recording, replace(joints, angle_rad=angle), tmp_path / "r.html", angles="straight"))
    ranges = next(table for table in page.tables if table[0][0] == "angle, degrees")
    titles = [row[0] for row in ranges]
    assert "Pelvis rotation left" not in titles and "Pelvis obliquity right down" in titles
    assert "Pelvis rotation left" not in [plot.title for plot in time_plots(joints, 0, None, 2.0)]
    assert dict(page.tables[0])["people"] == "Anna" and dict(page.tables[0])["joint angles"] == "straight"
