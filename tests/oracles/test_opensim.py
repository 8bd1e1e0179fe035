"""Our files and angles before OpenSim: it reads them without a warning, and its own inverse kinematics agrees."""

import sys
from pathlib import Path

import numpy as np
import pytest
from built import unseen
from checks import refusal
from figure import sequence_of, walking
from motions import columns_of

from posefuse.core import DependencyError, InputError, PoseSequence
from posefuse.formats.mot import motion_from_joints, write_mot
from posefuse.formats.trc import TrcData, write_trc
from posefuse.kinematics import joints_from_poses
from posefuse.kinematics.body import bodies_from_poses
from posefuse.kinematics.opensim_scale import (
    FACTORS_FILE,
    LOG_FILE,
    SCALED_FILE,
    SCALED_MOTION_FILE,
    logged_opensim,
    scale_factors,
    scaled_motion,
    write_scaled_model,
)

# 15 bodies with the usual coordinates and markers of its own; limbs are longer by a fifth than those of the figure. Pelvis and
# spine bend both, so that hips and shoulders leave one of them open
MODEL = Path(__file__).with_name("other.osim")
OURS = {
    "hip_flexion_r": ("right_hip", 0), "hip_adduction_l": ("left_hip", 1), "knee_angle_l": ("left_knee", 0),
    "elbow_flex_r": ("right_elbow", 0), "ankle_angle_r": ("right_ankle", 0), "arm_flex_l": ("left_arm", 0),
    "lumbar_bending": ("trunk", 1), "subtalar_angle_r": ("right_ankle", 1), "neck_bending": ("neck", 1),
}  # fmt: skip


def figures() -> PoseSequence:
    return sequence_of([walking(t_s) for t_s in np.arange(0, 0.8, 0.02)], rate_hz=50.0)


@pytest.fixture(scope="module")
def osim():
    return pytest.importorskip("opensim", reason="the extra biomech is not installed")


@pytest.fixture(scope="module")
def solved(osim, tmp_path_factory):
    folder = tmp_path_factory.mktemp("opensim")
    sequence = figures()
    scaled_motion(MODEL, unseen(sequence, "left_ear", steps=slice(10, 14)), folder, 0, bodies_from_poses(sequence)[0])
    return folder, sequence, columns_of(folder / SCALED_MOTION_FILE)


def test_its_inverse_kinematics_agrees_with_our_angles(solved):
    """On a model of other lengths, with markers of its own in other places: its angles become those of the person."""
    folder, sequence, motion = solved
    joints = joints_from_poses(sequence)
    np.testing.assert_allclose(motion["time"], sequence.t_ns * 1e-9, atol=1e-6)
    for coordinate, (joint, axis) in OURS.items():
        ours = np.degrees(joints.angle_rad[:, 0, joints.joints.index(joint), axis])
        np.testing.assert_allclose(motion[coordinate], ours, atol=1.5, err_msg=coordinate)
    assert np.ptp(motion["ankle_angle_r"]) > 15
    assert {path.name for path in folder.iterdir()} == {
        "scaled.osim", "scale_factors.xml", "scaled.trc", "scaled.mot", "opensim.log"
    }  # fmt: skip


def test_what_hips_and_shoulders_leave_open_stays_at_its_default(solved):
    """The tilt of the pelvis and the bend of the spine move hips and shoulders alike: one of them has to be held."""
    _, sequence, motion = solved
    ours = columns_of(motion_from_joints(joints_from_poses(sequence)).table)
    np.testing.assert_allclose(motion["pelvis_tilt"], ours["pelvis_tilt"], atol=1.0)
    np.testing.assert_allclose(motion["lumbar_extension"], 0.0, atol=0.5)


def test_nothing_was_warned_about(solved, osim):
    folder = solved[0]
    complaints = [line for line in (folder / LOG_FILE).read_text().splitlines() if "[warn" in line or "[err" in line]
    assert complaints == []
    osim.Logger.addFileSink(str(folder / "guard.log"))
    tool = osim.InverseKinematicsTool()
    tool.set_model_file(str(folder / SCALED_FILE))
    tool.setMarkerDataFileName(str(folder / "not_there.trc"))
    with pytest.raises(RuntimeError):
        tool.run()
    osim.Logger.removeFileSink()
    assert "[error]" in (folder / "guard.log").read_text()


def test_it_opens_the_model_and_our_motions(solved, osim, tmp_path):
    folder, sequence, _ = solved
    model = osim.Model(str(folder / SCALED_FILE))
    model.initSystem()
    assert model.getMarkerSet().getSize() == 23
    ours, note = motion_from_joints(joints_from_poses(unseen(sequence, "left_elbow", steps=slice(10, 14))))
    assert "bridged" in note
    write_mot(tmp_path / "angles.mot", ours)
    table = osim.TimeSeriesTable(str(tmp_path / "angles.mot"))
    assert tuple(table.getColumnLabels()) == ours.columns
    assert table.getTableMetaDataString("inDegrees") == "yes"
    np.testing.assert_allclose(table.getMatrix().to_numpy(), ours.values, rtol=1e-8)
    # the reader of its tools and of its window, which ends without a word at the first value that is no number
    assert osim.Storage(str(tmp_path / "angles.mot")).getSize() == len(sequence)


def test_a_motion_moves_a_model_to_the_points(solved, osim):
    """The coordinates of angles.mot, put into a model with the usual names, bring its limbs to where the keypoints are.

    The person faces away from the ground's X, so that the sequence of the pelvis' turns counts.
    """
    folder, sequence, _ = solved
    motion = columns_of(motion_from_joints(joints_from_poses(sequence)).table)
    model = osim.Model(str(folder / SCALED_FILE))
    state = model.initSystem()
    coordinates = {one.getName(): one for one in model.getCoordinateSet()}
    moved = [name for name in motion if name in coordinates]
    assert len(moved) >= 30
    for i in (0, 12, 30):
        for name in moved:
            value = motion[name][i]
            metres = name in ("pelvis_tx", "pelvis_ty", "pelvis_tz")
            coordinates[name].setValue(state, value if metres else np.radians(value), False)
        model.realizePosition(state)
        for marker in model.getMarkerSet():
            name, found_m = marker.getName(), marker.getLocationInGround(state).to_numpy()
            if name.split("_")[-1] in ("hip", "ankle", "shoulder", "wrist"):
                wanted_m = sequence.xyz_world[i, 0, sequence.skeleton.index(name)][[1, 2, 0]]
                np.testing.assert_allclose(found_m, wanted_m, atol=0.005, err_msg=name)


def test_it_opens_points_of_which_some_are_missing(osim, tmp_path):
    """The last marker, a whole time step, and single ones: its reader counts cells."""
    xyz = np.random.default_rng(3).normal(size=(5, 3, 3)) * [1, 2, 3]
    xyz[0, -1], xyz[2], xyz[3, 0] = np.nan, np.nan, np.nan
    write_trc(tmp_path / "a.trc", TrcData(names=("a", "b", "c"), t_s=np.arange(5) / 30, xyz_world=xyz, rate_hz=30.0))
    table = osim.TimeSeriesTableVec3(str(tmp_path / "a.trc"))
    read = np.array([[table.getRowAtIndex(i)[k].to_numpy() for k in range(3)] for i in range(5)])
    np.testing.assert_allclose(read, xyz[..., [1, 2, 0]], atol=1e-6)


def test_a_person_who_comes_late_hides_and_leaves_early_moves_while_seen(solved, osim, tmp_path):
    _, sequence, whole = solved
    hidden = sequence
    for steps in (slice(0, 5), slice(18, 22), slice(35, None)):
        hidden = unseen(hidden, *sequence.skeleton.keypoints, steps=steps)
    hidden = unseen(hidden, *sequence.skeleton.keypoints[3:], steps=slice(10, 12))
    scaled_motion(MODEL, hidden, tmp_path, 0, bodies_from_poses(sequence)[0])
    motion, seen = columns_of(tmp_path / SCALED_MOTION_FILE), np.r_[5:10, 12:18, 22:35]
    np.testing.assert_allclose(motion["time"], sequence.t_ns[seen] * 1e-9, atol=1e-6)
    for coordinate in OURS:
        np.testing.assert_allclose(motion[coordinate], whole[coordinate][seen], atol=1.0, err_msg=coordinate)


def test_what_fails_in_it_is_named_with_its_reason(solved, tmp_path):
    def without_markers():
        with logged_opensim(tmp_path) as library:
            tool = library.InverseKinematicsTool()
            tool.set_model_file(str(solved[0] / SCALED_FILE))
            tool.setMarkerDataFileName(str(tmp_path / "none.trc"))
            tool.run()

    refusal(InputError, r"OpenSim failed \(InverseKinematicsTool Failed: .*none\.trc", without_markers)


def test_a_users_own_model_gets_the_persons_lengths(osim, tmp_path):
    """Somebody else's model, scaled to a person: OpenSim itself then measures the person's lengths, and joints where we say."""
    person = bodies_from_poses(figures())[0]
    before = MODEL.read_bytes()
    names = write_scaled_model(MODEL, tmp_path, person)
    assert MODEL.read_bytes() == before
    found = scale_factors(MODEL, person)
    np.testing.assert_allclose(found["femur_r"], 1 / 1.2, rtol=1e-6)
    np.testing.assert_allclose(found["pelvis"], 1.0, rtol=1e-6)
    for name, factors in scale_factors(tmp_path / SCALED_FILE, person).items():
        np.testing.assert_allclose(factors, 1.0, rtol=1e-5, err_msg=name)
    scales = osim.ScaleSet(str(tmp_path / FACTORS_FILE))
    assert {scales.get(i).getSegmentName() for i in range(scales.getSize())} == set(found)
    model = osim.Model(str(tmp_path / SCALED_FILE))
    state = model.initSystem()
    assert {"left_heel", "right_heel", "nose", "left_ear", "left_knee"} <= set(names)
    knee = model.getJointSet().get("tibia_l_joint").getChildFrame().getPositionInGround(state).to_numpy()
    marker = model.getMarkerSet().get("left_knee").getLocationInGround(state).to_numpy()
    np.testing.assert_allclose(marker, knee, atol=1e-9)


def test_opensim_prints_nothing_among_the_figures(osim, tmp_path, capfd):
    scaled_motion(MODEL, figures(), tmp_path, 0, bodies_from_poses(figures())[0])
    assert capfd.readouterr().out == ""


def test_what_is_no_model_is_refused_in_a_line(osim, tmp_path):
    person = bodies_from_poses(figures())[0]
    (tmp_path / "no.osim").write_text("<nothing/>")
    refusal(InputError, r"no\.osim: expected", scale_factors, tmp_path / "no.osim", person)
    with pytest.raises(InputError, match="expected an existing folder"):
        scaled_motion(tmp_path / "no.osim", figures(), tmp_path / "none", 0, person)


def test_without_the_package_it_names_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "opensim", None)
    person = bodies_from_poses(figures())[0]
    refusal(DependencyError, r"posefuse\[biomech\]", lambda: scaled_motion(MODEL, figures(), tmp_path, 0, person))
