"""A live session read as a recording, and solved a second time over all of time."""

import functools
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import built
import numpy as np
import pytest
from checks import assert_same, refusal
from made_up_session import made_up_messages, made_up_start
from mcap import reader
from mcap_ros2.decoder import DecoderFactory

from posefuse.cli.main import main
from posefuse.core import (
    Detections2D,
    InputError,
    LiveDetections,
    LiveJointCentres,
    LiveMessage,
    LiveNames,
    LivePose,
    LiveStart,
    Pose3D,
    Rig,
    ShapeError,
    SourceError,
)
from posefuse.core.observations import LIVE_STEP, NOT_KEPT, observations_from_frames, on_time_steps
from posefuse.core.skeleton import BLAZEPOSE33, COCO17
from posefuse.detection import read_card
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.formats.recording import read_recording, write_recording
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.reading import read_result
from posefuse.pipeline.solve import solve_again
from posefuse.pipeline.time_steps import frame_period_ns
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.outputs import notes_of
from posefuse_ros import bags, live_recording
from posefuse_ros.bags import Recorder, read_detections, read_mcap, read_poses
from posefuse_ros.mcap_output import McapSink, RecordConfig

pytest.importorskip("rosbags", reason="the extra `ros` is not installed")

K, BEGIN_NS, PERIOD_NS = len(BLAZEPOSE33), 1_700_000_000_000_000_000, 33_366_700
BODY = built.standing(-0.6, 0.2, skeleton=BLAZEPOSE33)
OTHER = np.array([1.1, -0.7, 0.0])
VELOCITY = np.array([0.8, -0.5, 0.05])
LATE_NS = (0, 11_000_000, 19_000_000, 27_000_000)
CONFIG = LiveConfig(joint_centres=False)


def body(t_ns: float) -> np.ndarray:
    """(K, 3) of a person who glides along."""
    return BODY + VELOCITY * (t_ns - BEGIN_NS) * 1e-9


def frames_of(rig: Rig, count: int, lost: float = 0.0, people: int = 1) -> list[Detections2D]:
    """Exact views of unsynchronised cameras that run freely, some frames lost, in the order of their times."""
    rng, found = np.random.default_rng(1), []
    for i in range(count):
        for camera, late_ns in zip(rig, LATE_NS, strict=True):
            t_ns = BEGIN_NS + i * PERIOD_NS + late_ns
            if rng.random() < lost:
                continue
            xyz = np.stack([body(t_ns) + n * OTHER for n in rng.permutation(people)])
            found.append(built.detections(camera.name, camera.project(xyz), t_ns, sigma_px=1.5, skeleton=BLAZEPOSE33))
    return found


def poses_of(count: int, people: int = 1, absent: Sequence[int] = ()) -> list[Pose3D]:
    """Output ticks at 100 Hz, 40 ms after the truth; at ticks `absent` no person is there."""
    rng, made = np.random.default_rng(2), []
    for i in range(count):
        t_ns, n = BEGIN_NS + i * 10_000_000, 0 if i in absent else people
        xyz = np.stack([body(t_ns - 40_000_000) + j * OTHER for j in range(n)]) if n else np.zeros((0, K, 3))
        cov = np.einsum("nkij,nklj->nkil", *[rng.normal(size=(n, K, 3, 3)) * 0.01] * 2)
        known = {"reproj_px": rng.normal(size=(n, K)) ** 2, **{name: rng.integers(2, 5, (n, K)) for name in ("n_views", "kind")}}
        cov = (cov + cov.swapaxes(-1, -2)) / 2
        made.append(built.pose(xyz, np.arange(n) + 4, t_ns, skeleton=BLAZEPOSE33, cov=cov, **known))
    return made


def record(
    path: Path,
    rig: Rig,
    frames: Sequence[Detections2D],
    poses: Sequence[Pose3D],
    config: LiveConfig = CONFIG,
    part: int = 1,
    first: Sequence[LiveMessage] = (),
) -> None:
    """What `posefuse live --record` writes of such a session; `first`: what comes before its views and poses."""
    output = RecordConfig(path=path).build()
    output.take(LiveStart(t_ns=BEGIN_NS, rig=rig, rate_hz=100.0, clock_offset_ns=0, notes=notes_of(rig, config), part=part))
    for message in first:
        output.take(message)
    for message in sorted([*frames, *poses], key=lambda one: one.t_ns):
        shown = LivePose(pose=message) if isinstance(message, Pose3D) else LiveDetections(detections=message)
        output.take(shown)
    output.close()


@pytest.fixture
def rig(ring_rig: Callable[..., Rig]) -> Rig:
    """With numbers that no text format keeps to the last bit."""
    made = ring_rig(4, distortion=(0.01 / 3, -0.002 / 7, 1e-4 / 3, 0.0, 0.0))
    return replace(made, cameras=tuple(replace(one, readout_s=0.01 / 3) for one in made), residual_px=1 / 3)


def test_reading_is_lossless(tmp_path: Path, rig: Rig) -> None:
    frames, poses = frames_of(rig, 20, lost=0.2), poses_of(60, absent=(0, 1, 30))
    record(tmp_path / "a.mcap", rig, frames, poses)
    found = read_result(tmp_path / "a.mcap", pytest.fail)
    start_ns = found.provenance["start_ns"]
    assert_same(found.rig, rig)
    assert len(found.observations.frame_t_ns) == len(frames)
    for i, one in enumerate(sorted(frames, key=lambda one: one.t_ns)):
        got = found.observations.detections(i)
        assert_same(replace(got, t_ns=got.t_ns + start_ns), one)
    for i, one in enumerate(poses):
        assert found.poses.t_ns[i] + start_ns == one.t_ns
        for name in ("xyz_world", "cov_world", "reproj_px", "n_views", "kind"):
            got = getattr(found.poses, name)[i, : len(one.person_id)]
            np.testing.assert_allclose(got, getattr(one, name), rtol=1e-6 if name in ("cov_world", "reproj_px") else 0)
    assert np.isnan(found.poses.xyz_world[[0, 1, 30]]).all()
    # and it is kept like any result
    write_recording(tmp_path, found)
    back = read_recording(tmp_path)
    assert back.is_live
    assert_same((back.poses, back.provenance), (found.poses, found.provenance))


@pytest.mark.parametrize("lost", [0.0, 0.15])
def test_exact_views_of_unsynchronised_cameras_solve_to_the_truth(tmp_path: Path, rig: Rig, lost: float) -> None:
    record(tmp_path / "a.mcap", rig, frames_of(rig, 60, lost), poses_of(200))
    live = live_recording.read(tmp_path / "a.mcap")
    solved = solve_again(live)
    assert np.median(np.diff(solved.poses.t_ns)) == pytest.approx(PERIOD_NS, rel=1e-4)
    true = np.stack([body(t_ns + live.provenance["start_ns"]) for t_ns in solved.poses.t_ns.tolist()])
    off_m = np.linalg.norm(solved.poses.xyz_world[:, 0] - true, axis=-1)[5:-5]
    before = np.stack([body(t_ns + live.provenance["start_ns"]) for t_ns in live.poses.t_ns.tolist()])
    assert np.isfinite(off_m).all()
    assert np.quantile(off_m, 0.95) < 0.002
    assert np.linalg.norm(live.poses.xyz_world[:, 0] - before, axis=-1).mean() > 0.03
    # and what was kept of it solves again to the last bit
    write_recording(tmp_path, solved)
    again = solve_again(read_recording(tmp_path))
    assert_same((again.observations, again.poses), (solved.observations, solved.poses))


@pytest.mark.parametrize("offset_ns", [None, 0])
def test_an_exported_session_is_the_session(tmp_path: Path, rig: Rig, offset_ns: int | None) -> None:
    """Every frame has its own time; interpolated to the output ticks, views had been solved to other poses."""
    record(tmp_path / "a.mcap", rig, frames_of(rig, 30, lost=0.2), poses_of(90))
    live = live_recording.read(tmp_path / "a.mcap")
    # as where the first frame was exposed before the first output tick
    live = replace(live, observations=replace(live.observations, frame_t_ns=live.observations.frame_t_ns - 1_000_000))
    (path,) = McapSink(epoch_offset_ns=offset_ns).build().write(live, tmp_path)
    back = live_recording.read(path, pytest.fail)
    assert_same((back.observations, back.poses.xyz_world), (live.observations, live.poses.xyz_world))
    assert_same(solve_again(back).poses, solve_again(live).poses)


def test_every_detection_finds_its_person(tmp_path: Path, rig: Rig) -> None:
    frames = frames_of(rig, 10, people=2)
    stray = replace(frames[0], xy_img=frames[0].xy_img * 0 + 5, t_ns=frames[0].t_ns + 1)
    record(tmp_path / "a.mcap", rig, [*frames, stray], poses_of(40, people=2))
    found = live_recording.read(tmp_path / "a.mcap")
    log = found.observations
    for i in range(len(log.frame_t_ns)):
        seen, people = log.detections(i), log.person_id[log.frame_begin[i] : log.frame_begin[i + 1]]
        if (seen.xy_img == 5).all():
            assert (people == NOT_KEPT).all()
            continue
        t_ns = seen.t_ns + found.provenance["start_ns"]
        for person, xy in zip(people, seen.xy_img, strict=True):
            expected = found.rig[seen.camera].project(body(t_ns) + (person - 4) * OTHER)
            np.testing.assert_allclose(xy, expected, atol=0.01)
    assert (found.views.score > 0).any(axis=-1).mean() > 0.7


@pytest.mark.parametrize("damage", ["the recording was cut off", "damaged at byte"])
def test_a_file_that_was_cut_off_or_damaged_is_read_up_to_there_with_one_warning(tmp_path: Path, rig: Rig, damage: str) -> None:
    """A bad sector in the last minute must not cost the hour before it."""
    record(tmp_path / "a.mcap", rig, frames_of(rig, 150), poses_of(500))
    whole = live_recording.read(tmp_path / "a.mcap", pytest.fail)
    raw = bytearray((tmp_path / "a.mcap").read_bytes())
    if "cut" in damage:
        del raw[len(raw) * 6 // 10 :]
    else:
        with (tmp_path / "a.mcap").open("rb") as file:
            chunks = reader.make_reader(file).get_summary().chunk_indexes
        middle = chunks[len(chunks) * 6 // 10]
        place = middle.chunk_start_offset + middle.chunk_length // 2
        raw[place : place + 64] = bytes(64)
    (tmp_path / "b.mcap").write_bytes(raw)
    lines: list[str] = []
    found = live_recording.read(tmp_path / "b.mcap", lines.append)
    [line] = lines
    assert f"b.mcap: {damage}" in line and ("what follows in this part is missing" in line) == ("byte" in damage)
    assert 0 < len(found.poses) < len(whole.poses)
    np.testing.assert_array_equal(found.poses.xyz_world, whole.poses.xyz_world[: len(found.poses)])
    with pytest.warns(UserWarning, match=damage):
        read_result(tmp_path / "b.mcap")
    # before the first pose there is nothing to keep
    raw[:8] = bytes(8)
    (tmp_path / "b.mcap").write_bytes(raw)
    refusal(SourceError, r"b\.mcap: ", live_recording.read, tmp_path / "b.mcap", lines.append)


def test_parts_are_joined_in_order_without_overlap(tmp_path: Path, rig: Rig) -> None:
    frames, poses = frames_of(rig, 12), poses_of(40)
    record(tmp_path / "whole.mcap", rig, frames, poses)
    record(tmp_path / "a.mcap", rig, frames[:20], poses[:15])

    def record_part(number: int, *seen: Sequence, config: LiveConfig = CONFIG) -> None:
        record(tmp_path / "later.mcap", rig, *seen, config, part=2)
        (tmp_path / "later.2.mcap").rename(tmp_path / f"a.{number}.mcap")

    record_part(10, frames[18:30], poses[14:25])
    record_part(11, frames[30:], poses[25:])
    (tmp_path / "a.12.mcap").write_bytes(b"")
    lines: list[str] = []
    whole, joined = (live_recording.read(tmp_path / f"{name}.mcap", lines.append) for name in ("whole", "a"))
    assert [line.split(":")[0] for line in lines] == [str(tmp_path / "a.12.mcap")]
    np.testing.assert_array_equal(whole.poses.xyz_world, joined.poses.xyz_world)
    times = [np.sort(one.observations.frame_t_ns) for one in (whole, joined)]
    np.testing.assert_array_equal(*times)
    record_part(13, frames, poses, config=replace(CONFIG, rate_hz=50.0))
    refusal(InputError, r"a\.13\.mcap: is a part of another session", live_recording.read, tmp_path / "a.mcap", lines.append)


def test_a_session_of_its_own_with_the_name_of_a_part_is_none(tmp_path: Path, rig: Rig) -> None:
    frames, poses = frames_of(rig, 24), poses_of(60)
    record(tmp_path / "a.mcap", rig, frames[:20], poses[:15])
    alone = live_recording.read(tmp_path / "a.mcap", pytest.fail)
    record(tmp_path / "a.2.mcap", rig, frames[40:], poses[30:])
    first = live_recording.read(tmp_path / "a.mcap", pytest.fail)
    assert first.provenance["parts"] == ["a.mcap"]
    assert_same(first.poses, alone.poses)
    assert len(live_recording.read(tmp_path / "a.2.mcap", pytest.fail).poses) == 30


def test_the_table_of_joint_centres_is_that_of_the_session(tmp_path: Path, rig: Rig) -> None:
    table = read_joint_centres(read_card("blazepose_full").joint_centres_file)
    centres = LiveJointCentres(t_ns=BEGIN_NS, cameras=rig.names[2:], table=table)
    record(tmp_path / "a.mcap", rig, frames_of(rig, 12), poses_of(40), LiveConfig(), first=[centres])
    found = live_recording.read(tmp_path / "a.mcap")
    assert found.provenance["joint_centres"] == asdict(table)
    moved = solve_again(found).poses.xyz_world
    plain = solve_again(found, replace(TrackConfig(), joint_centres=False)).poses.xyz_world
    assert np.nanmax(np.linalg.norm(moved - plain, axis=-1)) > 0.003


def test_names_given_in_the_session_are_those_of_the_recording(tmp_path: Path, rig: Rig) -> None:
    lines: list[str] = []
    given = ({0: "Eva"}, {0: "Eva", 4: 'Äda "x"', 900: "late"}, {0: "", 4: "Ada", 900: "late"})
    named = [LiveNames(t_ns=BEGIN_NS, names=names) for names in given]
    record(tmp_path / "a.mcap", rig, [], poses_of(3), LiveConfig(names=("first", "second")), first=named)
    found = live_recording.read(tmp_path / "a.mcap", lines.append)
    assert list(found.provenance["config"]["names"]) == ["person 0", "second", "person 2", "person 3", "Ada"]
    assert found.person_names == ("Ada",)
    assert len(lines) == 1 and "900" in lines[0]


def test_what_is_no_live_recording_is_refused(tmp_path: Path, rig: Rig) -> None:
    (tmp_path / "text.mcap").write_text("no")
    refusal(SourceError, "cannot be read as MCAP", read_result, tmp_path / "text.mcap")
    Recorder(tmp_path / "empty.mcap").close()
    refusal(InputError, "holds no pose", read_result, tmp_path / "empty.mcap")
    (tmp_path / "a.trc").write_text("no")
    refusal(InputError, "expected a result folder", read_result, tmp_path / "a.trc")
    record(tmp_path / "blind.mcap", rig, [], poses_of(3))
    refusal(InputError, "no detections", lambda: solve_again(read_result(tmp_path / "blind.mcap")))


@pytest.mark.parametrize(("lost", "jitter_ns"), [(0.0, 0), (0.4, 0), (0.7, 0), (0.5, 3e6)])
def test_the_frame_period_is_found_although_frames_are_missing(lost: float, jitter_ns: float) -> None:
    rng = np.random.default_rng(0)
    t_ns = np.arange(400) * PERIOD_NS + rng.normal(size=400) * jitter_ns
    found = frame_period_ns(np.sort(t_ns[rng.random(400) >= lost]).astype(np.int64))
    assert found == pytest.approx(PERIOD_NS, rel=1e-9 if not jitter_ns else 2e-4)


def test_each_time_step_has_the_nearest_frame_and_no_frame_is_at_two(rig: Rig) -> None:
    rng = np.random.default_rng(4)
    frames = [
        built.detections(name, np.zeros((1, 17, 2)), int(t_ns))
        for name in rig.names
        for t_ns in rng.permutation(rng.integers(0, 2_000, 40))
    ]
    log = on_time_steps(observations_from_frames(COCO17, rig.names, frames), np.arange(100, 1900, 50))
    for c in range(4):
        mine = log.frame_camera == c
        for step, t_ns in enumerate(log.step_t_ns):
            late_ns = np.abs(log.frame_t_ns[mine] - t_ns)
            [chosen] = np.flatnonzero(log.frame_step[mine] == step) if late_ns.min() < 25 else [None]
            assert chosen is None or late_ns[chosen] == late_ns.min()
    assert (np.abs(log.frame_t_ns - log.step_t_ns[log.frame_step])[log.frame_step != LIVE_STEP] <= 25).all()
    refusal(ShapeError, "no camera cam00; there are: x", observations_from_frames, COCO17, ("x",), frames[:1])


def test_commands_take_a_live_recording(tmp_path: Path, rig: Rig, capsys: pytest.CaptureFixture) -> None:
    record(tmp_path / "a.mcap", rig, frames_of(rig, 40), poses_of(130))
    assert main(["solve", str(tmp_path / "a.mcap"), "--out", str(tmp_path / "r"), "--outputs", "trc"]) == 0
    assert read_result(tmp_path / "r").provenance["second_solve"]
    assert (tmp_path / "r" / "pose.trc").is_file()
    assert main(["report", str(tmp_path / "a.mcap"), "--fit", "none"]) == 0
    assert (tmp_path / "a_biomechanics" / "report.html").is_file()
    assert main(["compare", str(tmp_path / "r"), str(tmp_path / "a.mcap"), "--no-space"]) == 0
    assert main(["track", str(tmp_path / "a.mcap"), "--out", str(tmp_path / "x"), "--resume"]) != 0
    assert "is a recording, not a session; `posefuse solve` solves it again" in capsys.readouterr().err


def test_a_section_is_solved_as_from_the_whole_file_without_decoding_the_rest(
    tmp_path: Path, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, config = tmp_path / "a.mcap", replace(TrackConfig(), start_s=2.6, end_s=3.2, body="off")
    record(path, rig, frames_of(rig, 120, lost=0.1), poses_of(400))
    monkeypatch.setattr(live_recording, "_SECTION_MARGIN_S", 0.5)
    decoded: list[str] = []
    whole_decode = bags.decode
    monkeypatch.setattr(bags, "decode", lambda raw, name, most: decoded.append(name) or whole_decode(raw, name, most))
    whole, all_messages = read_result(path, pytest.fail), len(decoded)
    decoded.clear()
    section = read_result(path, pytest.fail, start_s=2.6, end_s=3.2)
    assert len(decoded) < 0.55 * all_messages
    assert section.provenance == whole.provenance
    one, other = (solve_again(recording, config).poses for recording in (section, whole))
    np.testing.assert_array_equal(one.t_ns, other.t_ns)
    np.testing.assert_array_equal(one.xyz_world, other.xyz_world)


# --- what a live recording holds: enough for a replay, and for viewers to draw the people unasked


@functools.cache
def messages() -> tuple[LiveMessage, ...]:
    """Not made while tests are collected: the kernels of joint angles take every worker of a new machine 20 s to compile."""
    return tuple(made_up_messages())


def recorded(path: Path) -> tuple[Path, list]:
    """A second of poses at 100 Hz, and everything else once."""
    config = RecordConfig(path=path)
    output = config.build()
    output.take(made_up_start(1))
    given = [message for message in messages() if isinstance(message, config.takes)]
    for message in given:
        output.take(message)
    pose = next(message for message in messages() if isinstance(message, LivePose) and len(message.pose.person_id) == 2)
    for i in range(100):
        output.take(replace(pose, pose=replace(pose.pose, t_ns=BEGIN_NS + i * 10_000_000)))
    output.close()
    output.close()
    return path, given


def test_people_are_drawn_by_two_readers_unasked(tmp_path: Path) -> None:
    path, given = recorded(tmp_path / "a.mcap")
    count = Counter(one.topic for one in read_mcap(path))
    with path.open("rb") as file:
        theirs = reader.make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        assert count == Counter(channel.topic for _, channel, _, _ in theirs)
    assert {"/tf", "/tf_static", "/posefuse/markers", "/posefuse/cameras", "/diagnostics", "/humans/bodies/tracked"} <= set(count)
    poses = sum(isinstance(message, LivePose) for message in given) + 100
    assert count["/posefuse/pose"] == poses == len(list(read_poses(path)))
    assert len(list(read_detections(path))) == sum(isinstance(message, LiveDetections) for message in given)
    assert count["/posefuse/markers"] == pytest.approx(30, abs=4)
    assert count["/posefuse/markers"] < 40 and not any(name.endswith("/pose_with_covariance") for name in count)


def test_a_session_that_did_not_start_leaves_no_file(tmp_path: Path) -> None:
    output = RecordConfig(path=tmp_path / "a.mcap").build()
    output.take(made_up_start(1))
    assert (tmp_path / "a.mcap").exists()
    output.close()
    assert list(tmp_path.iterdir()) == []
