"""The Rerun recording, read back by Rerun's own tools; the viewer without a display."""

import importlib.util
import itertools
import re
import shutil
import sys
from collections import namedtuple
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from checks import refusal
from running import python
from scipy.spatial.transform import Rotation

import posefuse as pf
from posefuse.core import DependencyError, InputError, Recording
from posefuse.formats.recording import write_recording
from posefuse.outputs import write_outputs
from posefuse.outputs.data_files import CsvSink
from posefuse.outputs.frames import write_each
from posefuse.outputs.rerun import RerunSink, ellipsoid_axes, open_in_viewer, opened_stream

Make = Callable[..., Recording]
needs_rerun = pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="needs the extra `viewer`")


@needs_rerun
def test_reruns_own_tools_read_it(tmp_path: Path, make_recording: Make, grey_frames: Callable[[Recording], Iterator]) -> None:
    recording = make_recording(people=(4, 9), cameras=3)
    [path] = write_outputs([RerunSink().build()], recording, tmp_path, grey_frames(recording))
    assert list(tmp_path.iterdir()) == [path]
    verified = python("-m", "rerun", "rrd", "verify", str(path))
    assert "verified without error" in verified.stdout + verified.stderr
    listing = python("-m", "rerun", "rrd", "print", str(path)).stdout
    cameras = [f"/world/cameras/{view}" for view in ("cam02/image", "cam00/detections", "cam01/skeleton")]
    others = ("/world/people/9/bones", "/world/people/4/uncertainty", "/world/people/9/name")
    assert [name for name in (*cameras, *others) if name not in listing] == []


@needs_rerun
def test_a_disk_that_fills_up_ends_the_file_and_no_other(
    tmp_path: Path, make_recording: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rerun never comes back from a write that failed: the command hung, with the result unfinished."""
    looks = itertools.count()
    usage = namedtuple("usage", "free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(1_000_000_000 if next(looks) < 3 else 2_000_000))
    outcome = write_each([RerunSink(), CsvSink()], make_recording(), tmp_path)
    assert re.search("about 64 MB will be written, 2 MB are free", str(outcome.failed["rerun"]))
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".csv"]
    live = tmp_path / "live.rrd"
    refusal(InputError, "about 64 MB will be written, 2 MB are free", opened_stream, "live", str(live), lambda: None)
    assert not live.exists()


def test_ellipsoids_are_the_covariance() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 3, 3))
    cov = root @ root.swapaxes(1, 2)
    half, xyzw = ellipsoid_axes(cov)
    axes = Rotation.from_quat(xyzw).as_matrix() * half[:, None] / 3
    np.testing.assert_allclose(axes @ axes.swapaxes(1, 2), cov, atol=1e-12)


@needs_rerun
def test_viewing_shows_the_recording_or_makes_one(tmp_path: Path, make_recording: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = make_recording()
    write_recording(tmp_path, recording)
    shown: list[tuple[Path, bool]] = []
    monkeypatch.setattr("posefuse.outputs.rerun.open_in_viewer", lambda path: shown.append((path, path.is_file())))
    assert pf.read(tmp_path).view() == tmp_path
    made, was_there = shown[0]
    assert was_there and not made.exists()
    [path] = RerunSink().write(recording, tmp_path)
    assert pf.read(tmp_path).view() == path
    assert shown[1] == (path, True)


@needs_rerun
@pytest.mark.skipif(sys.platform != "linux", reason="displays are named by the environment on Linux only")
def test_without_a_display(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(DependencyError, match=r"posefuse\[viewer\].* needs a display .*rerun --web-viewer recording\.rrd"):
        open_in_viewer(tmp_path / "a.rrd")


def test_without_rerun_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    refusal(DependencyError, r"pip install 'posefuse\[viewer\]'", RerunSink().build)
