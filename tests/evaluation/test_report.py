"""The report page: whole in itself, truthful about gaps, harmless text, clear errors."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest

from posefuse.core import SKELETONS, InputError, PoseSequence, Recording
from posefuse.evaluation.report import write_report
from posefuse.evaluation.report.quality import keypoint_quality
from posefuse.evaluation.report.svg import Curve, chart
from posefuse.kinematics import joints_from_poses

SKELETON = SKELETONS["anatomical23"]
VOID = {"meta", "img", "line", "path", "polygon"}


class Balance(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.links = [], []

    def handle_starttag(self, tag, attrs):
        self.links += [value for key, value in attrs if key in ("src", "href")]
        if tag not in VOID or (self.get_starttag_text().endswith(">") and tag == "path"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.links += [value for key, value in attrs if key in ("src", "href")]

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag, tag


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
    seen = np.isfinite(xyz[..., 0])
    cov = np.where(seen[..., None, None], np.eye(3) * 1e-4, np.nan)
    people = xyz.shape[1]
    poses = PoseSequence(
        t_ns=t_ns,
        skeleton=SKELETON,
        person_id=range(people),
        xyz_world=xyz,
        cov_world=cov,
        reproj_px=np.where(seen, 1.5, np.nan),
        n_views=seen * 3,
        kind=seen * 1,
    )
    rig = ring_rig(4)
    shape = (len(t_ns), people, 4, len(SKELETON))
    return Recording.from_views(
        rig, poses, np.full((*shape, 2), np.nan), np.zeros(shape), np.full(shape, np.nan), provenance or {}
    )


def test_the_page_needs_nothing_else_and_is_well_formed(tmp_path, ring_rig):
    recording = recording_of(ring_rig, *walker(), {"version": "1 & <2>"})
    out = write_report(recording, joints_from_poses(recording.poses), tmp_path / "r.html", {"cam <1>": b"\xff\xd8jpeg"})
    page = out.read_text()
    balance = Balance()
    balance.feed(page)
    assert balance.open == []
    assert balance.links and all(link.startswith("data:") for link in balance.links)
    assert "http" not in page and "<script" not in page
    assert "1 &amp; &lt;2&gt;" in page and "cam &lt;1&gt;" in page
    assert "Knee flexion" in page and "Speed" in page
    assert re.search(r"1\.\d\d m/s", page)


def test_several_people_and_nobody(tmp_path, ring_rig):
    xyz, t_ns = walker(people=2)
    xyz[:, 1] = np.nan
    recording = recording_of(ring_rig, xyz, t_ns)
    page = write_report(recording, joints_from_poses(recording.poses), tmp_path / "r.html").read_text()
    assert "Person 0" in page and "Person 1" in page and "Not seen in any instant" in page
    nobody = recording_of(ring_rig, xyz[:, :0], t_ns)
    assert "Person" not in write_report(nobody, joints_from_poses(nobody.poses), tmp_path / "n.html").read_text()


def test_standing_is_not_called_walking(tmp_path, ring_rig):
    xyz, t_ns = walker()
    recording = recording_of(ring_rig, np.broadcast_to(xyz[:1], xyz.shape), t_ns)
    assert "No walking found" in write_report(recording, joints_from_poses(recording.poses), tmp_path / "r.html").read_text()


def test_joints_of_another_recording_are_refused(tmp_path, ring_rig):
    recording = recording_of(ring_rig, *walker())
    other = recording_of(ring_rig, *walker(times=200))
    with pytest.raises(InputError, match="expected joints of the 240 instants"):
        write_report(recording, joints_from_poses(other.poses), tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()


def test_quality_counts_what_was_measured(ring_rig):
    xyz, t_ns = walker()
    knee = SKELETON.index("left_knee")
    xyz[60:120, :, knee] = np.nan
    rows = {row.keypoint: row for row in keypoint_quality(recording_of(ring_rig, xyz, t_ns), 0)}
    assert rows["left_knee"].found == pytest.approx(0.75)
    assert rows["left_knee"].longest_gap_s == pytest.approx(61 / 60, abs=1e-6)
    assert rows["right_knee"].longest_gap_s == 0
    assert rows["right_knee"].sigma_mm == pytest.approx(10)
    assert rows["nose"].found == 0 and rows["nose"].longest_gap_s == pytest.approx(239 / 60, abs=1e-6)


def test_a_gap_breaks_the_line():
    values = np.array([1.0, 2, np.nan, np.nan, 3, 4, 5])
    drawn = chart("a", "°", np.arange(7) * 0.1, [Curve(values, values * 0 + 1, "left", "n")])
    assert re.search(r'd="([^"]*)"', drawn)[1].count("M") == 2
    assert drawn.count("<polygon") == 2
