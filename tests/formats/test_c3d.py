"""C3D: against ezc3d itself, a file of a gait lab, and round trips."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import pytest
from checks import assert_same, refusal

from posefuse.core import DiskFullError, InputError, ShapeError
from posefuse.formats import c3d
from posefuse.formats.c3d import C3dData, C3dEvent, read_c3d, write_c3d
from posefuse.formats.c3d_blocks import data_start, read_blocks


def some_points() -> C3dData:
    rng = np.random.default_rng(1)
    xyz = rng.normal(size=(7, 5, 3)) * [1, 2, 3]
    xyz[2, 3] = np.nan
    sigma = rng.uniform(0.001, 0.02, size=(7, 5))
    angles = rng.normal(size=(7, 2, 3))
    angles[4, 1] = np.nan
    named = {"names": ("left_hip", "right_hip", "left_knee", "right_knee", "nose"), "angle_names": ("left_hip_a", "left_knee_a")}
    return C3dData(**named, xyz_world=xyz, sigma_m=sigma, rate_hz=29.97, angle_rad=angles, begin_s=0.25)


def test_a_file_that_states_y_up_is_turned_as_trc_is(tmp_path: Path) -> None:
    data = some_points()
    write_c3d(tmp_path / "z_up.c3d", data)
    other: Any = ezc3d.c3d(str(tmp_path / "z_up.c3d"))
    points = other["data"]["points"]
    points[:3, :5] = points[[1, 2, 0], :5]
    other["parameters"]["POINT"]["Y_SCREEN"]["value"] = ["+Y"]
    other.write(str(tmp_path / "y_up.c3d"))
    read = read_c3d(tmp_path / "y_up.c3d")
    np.testing.assert_allclose(read.xyz_world, data.xyz_world, atol=1e-6)
    np.testing.assert_allclose(read.angle_rad, data.angle_rad, atol=1e-6)


def test_round_trip(tmp_path: Path) -> None:
    data = some_points()
    write_c3d(tmp_path / "a.c3d", data)
    back = read_c3d(tmp_path / "a.c3d")
    np.testing.assert_allclose(back.sigma_m, np.where(np.isfinite(data.xyz_world[..., 0]), data.sigma_m, np.nan), atol=1.01e-4)
    assert_same(replace(back, sigma_m=data.sigma_m), data, atol=1e-6)


def test_what_ezc3d_sees(tmp_path: Path) -> None:
    data = some_points()
    write_c3d(tmp_path / "a.c3d", data)
    blocks_like_the_library(tmp_path / "a.c3d")
    file = ezc3d.c3d(str(tmp_path / "a.c3d"))
    point = file["parameters"]["POINT"]
    assert point["LABELS"]["value"] == [*data.names, *data.angle_names]
    assert point["UNITS"]["value"] == ["mm"]
    assert (point["X_SCREEN"]["value"], point["Y_SCREEN"]["value"]) == (["+X"], ["+Z"])
    assert point["ANGLES"]["value"] == list(data.angle_names)
    assert file["parameters"]["MANUFACTURER"]["SOFTWARE"]["value"] == ["posefuse"]
    assert file["data"]["analogs"].shape[1] == 0
    np.testing.assert_allclose(file["data"]["points"][:3, 1, 0], data.xyz_world[0, 1] * 1000, rtol=1e-6)
    np.testing.assert_allclose(file["data"]["points"][:3, 5, 0], np.degrees(data.angle_rad[0, 0]), rtol=1e-6)
    assert file["data"]["meta_points"]["residuals"][0, 3, 2] == -1
    assert (np.delete(file["data"]["meta_points"]["residuals"][0, 3], 2) >= 0).all()


@pytest.mark.parametrize("worst_m", [0.02, 0.3])
def test_no_reader_takes_a_known_point_for_a_missing_one(tmp_path: Path, worst_m: float) -> None:
    """The C3D standard: a point's fourth word has the residual in its low byte; as 16 bits it is negative where the point is
    missing. Points whose deviation was more than half of the largest were missing in BTK, Mokka and the package c3d; some readers
    take the low byte as signed.
    """
    data = some_points()
    sigma_m = data.sigma_m * worst_m / data.sigma_m.max()
    write_c3d(tmp_path / "a.c3d", replace(data, sigma_m=sigma_m))
    content = (tmp_path / "a.c3d").read_bytes()
    table = np.frombuffer(content, "<f4", 7 * 7 * 4, data_start(content)).reshape(7, 7, 4)
    words, step_mm = table[:, :5, 3].astype(np.int16), -np.frombuffer(content, "<f4", 1, 12)[0]
    missing = ~np.isfinite(data.xyz_world[..., 0])
    np.testing.assert_array_equal(words == -1, missing)
    assert ((words[~missing] >= 0) & (words[~missing] < 128)).all()
    np.testing.assert_allclose(words[~missing] * step_mm, 1000 * sigma_m[~missing], atol=1.01 * step_mm)


@pytest.mark.parametrize("frames", [1, 6, 7, 8, 66_000])
def test_a_file_written_in_parts_is_the_same(tmp_path: Path, frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    xyz = np.where(rng.random((frames, 2, 1)) < 0.1, np.nan, rng.normal(size=(frames, 2, 3)))
    data = C3dData(
        names=("a", "b"), xyz_world=xyz, sigma_m=rng.uniform(0, 0.1, (frames, 2)), rate_hz=30.0, angle_names=("c",),
        angle_rad=rng.normal(size=(frames, 1, 3)), subject="Ada", events=(C3dEvent(0.1, "left", "strike"),),
    )  # fmt: skip
    for name, most in (("parts.c3d", 7 if frames < 10 else 10_000), ("once.c3d", 100_000)):
        monkeypatch.setattr(c3d, "_PART_FRAMES", most)
        write_c3d(tmp_path / name, data)
    assert (tmp_path / "parts.c3d").read_bytes() == (tmp_path / "once.c3d").read_bytes()
    # with the frames counted and written by us, it is the file that the library writes; it reads 65,535 frames and no more
    step_mm = max(0.1, 1000 * float(data.sigma_m.max()) / 127)
    file = c3d._described(data, ["a", "b", "c"], step_mm)
    values = np.concatenate([1000 * xyz, np.degrees(data.angle_rad)], axis=1)
    steps = np.concatenate([np.rint(1000 * data.sigma_m / step_mm), np.zeros((frames, 1))], axis=1).astype(np.uint8)
    missing = ~np.isfinite(values).all(axis=-1)
    file["data"]["points"] = np.concatenate([values.transpose(2, 1, 0), np.ones((1, 3, frames))])
    # the library has the cameras in the low byte, where the standard has the residual
    masks = np.unpackbits(steps.T[None], axis=0, bitorder="little")[:7].astype(bool)
    file["data"]["meta_points"] = {"residuals": np.where(missing, -1.0, 0.0).T[None], "camera_masks": masks}
    file.write(str(tmp_path / "library.c3d"))
    library = (tmp_path / "library.c3d").read_bytes()
    # whose header has another scale than its parameters: the package c3d refuses such a file
    header_scale = np.float32(-step_mm).tobytes()
    assert (tmp_path / "once.c3d").read_bytes() == library[:12] + header_scale + library[16:]


@pytest.mark.parametrize("frames", [65_535, 65_536, 100_000])
def test_a_long_recording_has_all_its_frames(tmp_path: Path, frames: int) -> None:
    """The header's 16 bits are full after 11 minutes at 100 Hz: every reader, ours too, stopped there."""
    xyz = np.arange(3.0 * frames).reshape(frames, 1, 3) / frames
    write_c3d(tmp_path / "a.c3d", C3dData(names=("a",), xyz_world=xyz, sigma_m=np.zeros((frames, 1)), rate_hz=100.0))
    np.testing.assert_allclose(read_c3d(tmp_path / "a.c3d").xyz_world, xyz, atol=1e-6)
    if frames <= 65_535:
        return
    groups = read_blocks(tmp_path / "a.c3d").parameters
    words = groups["TRIAL"]["ACTUAL_END_FIELD"]
    assert all(isinstance(word, int) for word in words)
    assert words[0] % 65_536 + 65_536 * words[1] == groups["POINT"]["LONG_FRAMES"][0] == frames
    assert groups["TRIAL"]["ACTUAL_START_FIELD"] == [1, 0]


@pytest.mark.parametrize("count", [3, 300])
def test_subject_and_events_as_the_library_reads_them(tmp_path: Path, count: int) -> None:
    events = tuple(C3dEvent(0.1 * i, ("left", "right")[i % 2], ("strike", "off")[i // 2 % 2]) for i in range(count))
    write_c3d(tmp_path / "a.c3d", replace(some_points(), subject="José", events=events))
    groups = ezc3d.c3d(str(tmp_path / "a.c3d"))["parameters"]
    assert groups["SUBJECTS"]["NAMES"]["value"] == ["José"]
    event, kept = groups["EVENT"], min(count, 255)
    assert event["USED"]["value"] == [kept] and event["SUBJECTS"]["value"] == ["José"] * kept
    assert event["CONTEXTS"]["value"][:3] == ["Left", "Right", "Left"]
    assert event["LABELS"]["value"][:3] == ["Foot Strike", "Foot Strike", "Foot Off"]
    np.testing.assert_allclose(event["TIMES"]["value"], [np.zeros(kept), 0.1 * np.arange(kept)], rtol=1e-6)
    read_c3d(tmp_path / "a.c3d")


@pytest.mark.parametrize("subject", ["李" * 64, "Ä" * 64])
def test_a_long_name_is_cut_at_a_whole_character(tmp_path: Path, subject: str) -> None:
    """127 bytes are all that a string may have; ezc3d refuses a file with a longer one."""
    write_c3d(tmp_path / "a.c3d", replace(some_points(), subject=subject, events=(C3dEvent(0.0, "left", "strike"),)))
    groups = ezc3d.c3d(str(tmp_path / "a.c3d"))["parameters"]
    [kept] = groups["SUBJECTS"]["NAMES"]["value"]
    assert subject.startswith(kept) and 124 < len(kept.encode()) <= 127
    assert groups["EVENT"]["SUBJECTS"]["value"] == [kept]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no largest size of a file")
@pytest.mark.parametrize("most_bytes", [0, 1000, 2000])
def test_no_room_for_the_header_is_one_line(tmp_path: Path, most_bytes: int) -> None:
    """ezc3d does not report that its disk is full: `IndexError: index out of range` was the reason given."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, before[1]))
        refusal(DiskFullError, "a.c3d: cannot be written, .*no room", write_c3d, tmp_path / "a.c3d", some_points())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


def test_a_gait_labs_file(shared_data: Path) -> None:
    blocks_like_the_library(shared_data / "btk" / "FunctionalWalk.c3d")
    data = read_c3d(shared_data / "btk" / "FunctionalWalk.c3d")
    assert data.rate_hz == 120
    assert len(data.xyz_world) == 438
    # it was cut: its first frame is number 480 of what was recorded
    assert data.t_s[0] == pytest.approx(479 / 120) and data.t_s[-1] == pytest.approx(916 / 120)
    assert "LKneeAngles" in data.angle_names
    assert not {"LKneePower", "LKneeMoment", "LKneeAngles"} & set(data.names)
    pelvis = data.xyz_world[:, data.names.index("LASI"), 2]
    assert 0.7 < np.nanmedian(pelvis) < 1.2
    knee = data.angle_rad[:, data.angle_names.index("LKneeAngles"), 0]
    assert 0.5 < np.nanmax(knee) < 1.6


@pytest.mark.parametrize("begin_s", [1.5, -0.25, 0.0])
def test_times_of_ours_are_those_of_the_session(tmp_path: Path, begin_s: float) -> None:
    """They began at 0, so `posefuse compare --no-time` put the files of one result apart that began later."""
    write_c3d(tmp_path / "a.c3d", points("a", begin_s=begin_s))
    np.testing.assert_allclose(read_c3d(tmp_path / "a.c3d").t_s, [begin_s, begin_s + 0.02])


def points(names: str, count: int = 1, rate_hz: float = 50.0, **others: Any) -> C3dData:
    """Two frames of `count` points at (1, 1, 1) m."""
    xyz, sigma = np.ones((2, count, 3)), np.ones((2, count))
    return C3dData(names=tuple(names), xyz_world=xyz, sigma_m=sigma, rate_hz=rate_hz, **others)


def test_bad_input(tmp_path: Path) -> None:
    (tmp_path / "a.c3d").write_bytes(b"not a c3d file" * 100)
    refusal(InputError, r"a\.c3d: cannot be read as C3D", read_c3d, tmp_path / "a.c3d")
    refusal(InputError, r"none\.c3d: cannot be read", read_c3d, tmp_path / "none.c3d")
    refusal(InputError, "must be unique", write_c3d, tmp_path / "b.c3d", points("aa", 2))
    refusal(ShapeError, "1 names", points, "a", 2)
    refusal(ShapeError, "rate_hz: expected > 0", points, "a", rate_hz=0.0)
    assert not (tmp_path / "b.c3d").exists()
    file = ezc3d.c3d()
    about = {"RATE": [100], "LABELS": ["a"], "UNITS": ["inch"]}
    for name, value in about.items():
        file["parameters"]["POINT"][name]["value"] = value
    file["data"]["points"] = np.ones((4, 1, 3))
    file.write(str(tmp_path / "inch.c3d"))
    refusal(InputError, "POINT:UNITS: expected one of mm, cm, m, got 'inch'", read_c3d, tmp_path / "inch.c3d")


def blocks_like_the_library(path: Path) -> None:
    """Our parser and ezc3d read the same points and residuals; the library takes these for the cameras."""
    blocks, file = read_blocks(path), ezc3d.c3d(str(path))
    meta = file["data"]["meta_points"]
    seen = meta["residuals"][0].T >= 0
    low_byte = np.packbits(meta["camera_masks"].astype(bool), axis=0, bitorder="little")[0].T
    theirs = low_byte * abs(file["parameters"]["POINT"]["SCALE"]["value"][0])
    np.testing.assert_array_equal(blocks.residual >= 0, seen)
    np.testing.assert_array_equal(blocks.xyz[seen], file["data"]["points"][:3].transpose(2, 1, 0)[seen])
    np.testing.assert_allclose(blocks.residual[seen], theirs[seen])


@pytest.mark.parametrize(
    ("place", "value", "problem"),
    [
        (0, b"\xff", "parameters begin in block 255"),
        (1, b"\x00", "second byte is 80"),
        (2, b"\xff\xff", "the file has"),
        (4, b"\xff\xff", "the file has"),
        (8, b"\xf0\xff", "the file has"),
        (8, b"\x00\x00", "expected at least one"),
        (12, b"\x00\x00\x00\x00", "expected a scale other than 0"),
        (16, b"\xff\xff", "data begin in block 65535"),
        (512 + 3, b"\x55", "numbers of a DEC processor: .*write it again"),
        (512 + 4, b"\x7f", "the file has|unknown type|expected"),
    ],
)
def test_a_damaged_header_is_one_line(tmp_path: Path, place: int, value: bytes, problem: str) -> None:
    path = tmp_path / "a.c3d"
    write_c3d(path, some_points())
    content = path.read_bytes()
    path.write_bytes(content[:place] + value + content[place + len(value) :])
    refusal(InputError, problem, read_c3d, path)
