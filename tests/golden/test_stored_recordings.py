"""What an earlier posefuse stored is read by this one. Formats change on purpose only: `recordings/make.py`."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import posefuse as pf
from posefuse.formats.detection_log import LOG_FILE, read_log

GOLDEN = Path(__file__).with_name("recordings")
FACTS = json.loads((GOLDEN / "facts.json").read_text(encoding="utf-8"))


@pytest.fixture
def result(tmp_path: Path) -> Path:
    """A copy, which may be written to."""
    return Path(shutil.copytree(GOLDEN / "result", tmp_path / "result"))


def test_a_stored_result_is_read_and_solves_again_to_the_same_poses(result: Path) -> None:
    recording = pf.read(result)
    assert len(recording.poses) == FACTS["time_steps"]
    np.testing.assert_allclose(1e3 * recording.poses.xyz_world[7, 0], FACTS["xyz_mm"], atol=1e-3)
    again = recording.solve()
    # another processor may round differently
    np.testing.assert_allclose(again.poses.xyz_world, recording.poses.xyz_world, atol=1e-9)
    sigma_m = np.sqrt(np.diagonal(recording.poses.cov_world, axis1=-2, axis2=-1))
    off = (again.poses.cov_world - recording.poses.cov_world) / (sigma_m[..., :, None] * sigma_m[..., None, :])
    np.testing.assert_allclose(off, np.where(np.isnan(sigma_m[..., None]), np.nan, np.zeros_like(off)), atol=1e-6)


def test_stored_edits_are_read(result: Path) -> None:
    pytest.importorskip("nicegui", reason="the extra studio is not installed")
    from posefuse_studio.pages.recording import read_edits

    edits = read_edits(result)
    assert edits.names == ("Ada",) and edits.person == 0
    assert [(one.start_s, one.end_s, one.camera) for one in edits.exclusions] == [(0.1, 0.2, "cam1")]


def test_detections_of_an_interrupted_run_are_read() -> None:
    stored = read_log(GOLDEN / LOG_FILE)
    recording = pf.read(GOLDEN / "result")
    steps, dropped = stored.whole_steps()
    assert len(steps) > 3 and dropped >= 0
    assert [one.camera for one in steps[0].detections] == list(recording.rig.names)


def test_an_exported_mcap_is_read() -> None:
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    poses = pf.read(GOLDEN / "exported.mcap").poses
    np.testing.assert_allclose(1e3 * poses.xyz_world[7, 0], FACTS["xyz_mm"], atol=1e-2)
