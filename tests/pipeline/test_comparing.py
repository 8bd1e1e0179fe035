"""A live session of a simulator against the truth, by simulation time: slower than real time, over several loops."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import built
import numpy as np
import pytest
from checks import refusal

pytest.importorskip("rosbags", reason="the extra `ros` is not installed")

import posefuse
from posefuse.cli.main import main
from posefuse.core import SE3, ConfigError, InputError, LivePose, LiveStart, Pose3D, Recording, Rig
from posefuse.core.observations import observations_from_frames
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.evaluation.tracks import looped
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.outputs import notes_of
from posefuse_ros.bags import read_clock
from posefuse_ros.mcap_output import RecordConfig, keep_clock
from posefuse_ros.sim_time import SimulatedClock
from posefuse_sim.files import write_loop, write_truth

BEGIN_NS = 1_750_000_000 * 10**9
LOOP_S, RATE, OFFSET_M = 2.0, 0.5, np.array([0.012, 0.0, 0.005])
K = len(ANATOMICAL23)
REST = np.random.default_rng(4).uniform(-0.8, 0.8, (K, 3)) + [0, 0, 1]


def person_at(sim_s: np.ndarray, which: int = 0) -> np.ndarray:
    """(T, K, 3) of one of two people who go round, and are somewhere else at the end of the loop than at its beginning."""
    t = looped(np.asarray(sim_s), LOOP_S)[:, None]
    place = np.concatenate([np.sin(1.3 * t) + 3 * which, 0.4 * t, 0.05 * np.cos(9 * t)], axis=-1)
    return REST + place[:, None]


@pytest.fixture
def world(tmp_path: Path, ring_rig: Callable[..., Rig]) -> Path:
    """What `posefuse simulate --gazebo` writes of its truth."""
    rig, t_ns = ring_rig(3), np.arange(0, round(LOOP_S * 1e9), 4_166_667)
    xyz = np.stack([person_at(t_ns / 1e9, 1), person_at(t_ns / 1e9, 0)], axis=1)
    folder = tmp_path / "world"
    (folder / "truth").mkdir(parents=True)
    write_truth(folder / "truth" / "truth.npz", built.truth(rig, xyz, t_ns, ANATOMICAL23))
    write_loop(folder / "truth", round(LOOP_S * 1e9))
    return folder


def record(path: Path, rig: Rig, seconds: float, clock: SimulatedClock | None) -> None:
    """What `posefuse live --record` writes: a pose every 10 ms of real time, 13 mm off the truth."""
    output = RecordConfig(path=path).build()
    output.take(LiveStart(t_ns=BEGIN_NS, rig=rig, rate_hz=100.0, clock_offset_ns=0, notes=notes_of(rig, LiveConfig()), part=1))
    for t_ns in BEGIN_NS + np.arange(0, round(seconds * 1e9), 10_000_000):
        sim_ns = round((int(t_ns) - BEGIN_NS) * RATE) + 700_000_000
        pose = built.pose(person_at(np.array([sim_ns / 1e9])) + OFFSET_M, [5], int(t_ns), skeleton=ANATOMICAL23)
        if clock is not None:
            clock.add(sim_ns, int(t_ns))
            keep_clock(output._recorder, clock, int(t_ns))
        output.take(LivePose(pose=pose))
    output.close()


def test_the_error_is_found_by_simulation_time(tmp_path: Path, world: Path, ring_rig: Callable[..., Rig]) -> None:
    record(tmp_path / "a.mcap", ring_rig(3), 8.0, SimulatedClock())
    t_ns, sim_ns = read_clock(tmp_path / "a.mcap")
    np.testing.assert_allclose(sim_ns, 700_000_000 + (t_ns - BEGIN_NS) * RATE, atol=1000)
    found = posefuse.compare(world, tmp_path / "a.mcap")
    # 8 s at half speed: two loops, and the other person is 3 m away
    assert found.t_s[0] == pytest.approx(0.7) and found.t_s[-1] == pytest.approx(4.7, abs=0.01)
    np.testing.assert_array_equal(found.alignment.rotation, np.eye(3))
    assert found.alignment.offset_s == 0
    # the truth is straight between two of its time_steps
    assert found.errors.mpjpe_mm == pytest.approx(13.0, abs=0.5)
    assert np.nanmedian(np.linalg.norm(found.a_m - found.b_m, axis=-1)) == pytest.approx(0.013, abs=1e-5)


@pytest.mark.parametrize("live_first", [False, True])
def test_a_recording_without_people_is_one_line(tmp_path, world, ring_rig, capsys, live_first: bool) -> None:
    output = RecordConfig(path=tmp_path / "a.mcap").build()
    rig = ring_rig(3)
    output.take(LiveStart(t_ns=BEGIN_NS, rig=rig, rate_hz=100.0, clock_offset_ns=0, notes=notes_of(rig, LiveConfig()), part=1))
    for i in range(20):
        output.take(LivePose(pose=Pose3D.empty(BEGIN_NS + i * 10_000_000, ANATOMICAL23)))
    output.close()
    pair = (tmp_path / "a.mcap", tmp_path / "a.mcap") if live_first else (world, tmp_path / "a.mcap")
    assert main(["compare", *map(str, pair)]) == 1
    assert "a.mcap: no person was found in this recording" in capsys.readouterr().err.splitlines()[-1]


def test_without_the_clock_it_would_be_another_moment(tmp_path: Path, world: Path, ring_rig: Callable[..., Rig]) -> None:
    record(tmp_path / "a.mcap", ring_rig(3), 3.0, None)
    assert posefuse.compare(world, tmp_path / "a.mcap").errors.mpjpe_mm > 50


def test_a_recording_of_other_times_is_refused(tmp_path: Path, world: Path, ring_rig: Callable[..., Rig]) -> None:
    record(tmp_path / "a.mcap", ring_rig(3), 0.5, SimulatedClock())
    (world / "truth" / "loop.json").unlink()
    assert "nothing is aligned, times" in posefuse.compare(world, tmp_path / "a.mcap").notes[0]
    asked = posefuse.compare(world, tmp_path / "a.mcap", scale=True)
    assert "simulation: times are its own" in asked.notes[0] and not np.array_equal(asked.alignment.rotation, np.eye(3))
    (world / "truth" / "loop.json").write_text('{"loop_ns": -1}')
    refusal(InputError, "nanoseconds > 0", posefuse.compare, world, tmp_path / "a.mcap")


@pytest.mark.parametrize(("t_s", "expected"), [(0, 0), (0.5, 0.5), (2.0, 2.0), (2.25, 0.25), (4.0, 2.0), (-1, -1)])
def test_a_loop_ends_with_its_last_pose_as_gazebo_plays_it(t_s: float, expected: float) -> None:
    assert looped(np.array([float(t_s)]), 2.0)[0] == pytest.approx(expected)


def to_and_fro(rig: Rig, start_s: float, rate_hz: float, off_m: np.ndarray) -> Recording:
    """A person who walks along a line through the origin, turns and walks back: nearly the same after half a turn."""
    t_s = np.arange(start_s, 6.0, 1 / rate_hz)
    phase = 2 * np.pi * t_s / 4.0
    turned = np.where(np.cos(phase) > 0, 0.0, np.pi)
    steps = 0.15 * np.sin(4 * phase)[:, None] * np.where(np.arange(K) % 2, 1, -1)
    c, s = np.cos(turned)[:, None], np.sin(turned)[:, None]
    local = np.stack([0.05 * REST[:, 0] + steps, np.broadcast_to(0.3 * REST[:, 1], (len(t_s), K))], axis=-1)
    x, y = local[..., 0], local[..., 1]
    xy = np.stack([c * x - s * y + np.sin(phase)[:, None], s * x + c * y], axis=-1)
    xyz = np.concatenate([xy, np.broadcast_to(REST[:, 2:], (len(t_s), K, 1))], axis=-1) + off_m
    t_ns = np.round((t_s - start_s) * 1e9).astype(np.int64)
    poses = built.poses(xyz[:, None], skeleton=ANATOMICAL23, t_ns=t_ns)
    return Recording(rig=rig, poses=poses, observations=observations_from_frames(ANATOMICAL23, rig.names, []), provenance={})


def test_recordings_of_one_calibration_are_not_turned_onto_each_other(ring_rig: Callable[..., Rig]) -> None:
    rig, off_m = ring_rig(3), np.array([0.01, 0.02, 0.0])
    a, b = to_and_fro(rig, 0.0, 30.0, np.zeros(3)), to_and_fro(rig.only(rig.names[:2]), 0.4, 100.0, off_m)
    found = posefuse.compare(a, b)
    np.testing.assert_array_equal(found.alignment.rotation, np.eye(3))
    np.testing.assert_array_equal(found.alignment.shift_m, np.zeros(3))
    assert found.alignment.offset_s == pytest.approx(0.4, abs=0.02)
    assert np.linalg.norm(posefuse.compare(a, b, align_first_s=100.0).alignment.shift_m) == pytest.approx(0.022, abs=0.005)
    moved = replace(b, rig=b.rig.moved(SE3.from_rotvec([0.0, 0.0, 0.1], [0.0, 0.0, 0.0])))
    assert "one calibration" in posefuse.compare(a, b).notes[0]
    assert not posefuse.compare(a, moved).notes
    for asked in ({"scale": True}, {"align_first_s": 100.0}):
        refusal(ConfigError, "leave out `align_space=False`", posefuse.compare, a, b, align_space=False, **asked)


def test_of_several_people_in_the_reference_the_one_that_both_have_is_compared(ring_rig: Callable[..., Rig]) -> None:
    """A result and the second solve of it that kept one person, the one seen less: it was compared with the other one."""
    alone = to_and_fro(ring_rig(3), 0.0, 30.0, np.zeros(3))
    late = (np.arange(len(alone.poses)) > 150)[:, None, None]
    kept = np.where(late, np.nan, alone.poses.xyz_world[:, 0])
    both = np.stack([alone.poses.xyz_world[:, 0, ::-1] + [0.0, 0.9, 0.0], kept], axis=1)
    two, one = (
        replace(alone, poses=built.poses(xyz, skeleton=ANATOMICAL23, t_ns=alone.poses.t_ns)) for xyz in (both, kept[:, None])
    )
    for pair in ((two, one), (one, two)):
        assert posefuse.compare(*pair, align_time=False).errors.mpjpe_mm == 0


def test_of_several_people_the_same_one_is_compared_whatever_their_order(ring_rig: Callable[..., Rig]) -> None:
    walk = to_and_fro(ring_rig(3), 0.0, 30.0, np.zeros(3))
    both = np.stack([walk.poses.xyz_world[:, 0], walk.poses.xyz_world[:, 0, ::-1] + [0.0, 0.9, 0.0]], axis=1)
    # one leaves early, and in the other recording it is the other one
    late, which = (np.arange(len(both)) > 150)[:, None, None, None], np.arange(2)[:, None, None]
    gone = [np.where(late & (which == n), np.nan, both) for n in (0, 1)]
    a, b = (replace(walk, poses=built.poses(xyz, skeleton=ANATOMICAL23, t_ns=walk.poses.t_ns, ids=(4, 7))) for xyz in gone)
    b = replace(b, poses=replace(b.poses.people(np.array([1, 0])), person_id=np.array([4, 7])))
    found = posefuse.compare(a, b)
    assert (found.a.name, found.b.name) == ("a, person 7", "b, person 4") and found.errors.mpjpe_mm < 1e-6
    refusal(ConfigError, "`person=7`: neither recording has people by id", posefuse.compare, "a.trc", "b.C3D", person=7)
