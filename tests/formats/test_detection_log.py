"""The log of detections gives all whole records back, wherever it was cut or damaged."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from built import random_detections
from checks import assert_same, refusal

from posefuse.core import DetectionBatch, InputError, LookKind
from posefuse.core.skeleton import COCO17
from posefuse.formats.detection_log import ObservationLog, is_in_use, read_log

NAMES = ("cam00", "cam01")


def batch(step: int, kind: LookKind = LookKind.EXPECTED) -> DetectionBatch:
    rng = np.random.default_rng(step)
    found = tuple(random_detections(rng, name, step * 100 + c, c + 1) for c, name in enumerate(NAMES[: step % 3]))
    return DetectionBatch(step=step, t_ns=step * 100, kind=kind, detections=found)


def opened(path: Path, keep: int = 0) -> ObservationLog:
    return ObservationLog(path, skeleton=COCO17, camera_names=NAMES, made_with={"rig": "abc"}, keep=keep)


def written(path: Path, *batches: DetectionBatch, keep: int = 0) -> Path:
    writer = opened(path, keep)
    for one in batches:
        writer.append(one)
    writer.close()
    return path


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return written(tmp_path / "detections.log", *map(batch, range(6)), batch(5, LookKind.SEARCH))


def test_every_record_comes_back(log: Path) -> None:
    got = read_log(log)
    assert got.made_with == {"rig": "abc"} and got.ends[-1] == len(log.read_bytes())
    assert [(one.step, one.kind) for one in got.batches] == [*((i, 0) for i in range(6)), (5, 1)]
    assert_same(got.batches[:6], tuple(batch(i) for i in range(6)))


def test_depth_of_some_cameras_comes_back_and_the_others_cost_nothing(tmp_path: Path, log: Path) -> None:
    plain = batch(5)
    depth = np.random.default_rng(3).uniform(1, 4, (*plain.detections[1].score.shape, 2))
    depth[0, :4] = np.nan
    deep = replace(plain.detections[1], depth_m=depth)
    path = written(tmp_path / "deep.log", *map(batch, range(5)), replace(plain, detections=(plain.detections[0], deep)))
    got = read_log(path)
    assert got.batches[5].detections[0].depth_m is None
    np.testing.assert_array_equal(got.batches[5].detections[1].depth_m, deep.depth_m)
    # up to the first record with depth, the file is what it is without
    assert path.read_bytes()[: got.ends[4]] == log.read_bytes()[: got.ends[4]]
    assert got.ends[5] - read_log(log).ends[5] == deep.depth_m.nbytes


def test_a_cut_tail_is_left_out_wherever_it_was_cut(log: Path) -> None:
    whole = log.read_bytes()
    ends = [read_log(log).begin, *read_log(log).ends]
    for size in range(ends[0], len(whole), 61):
        log.write_bytes(whole[:size])
        got = read_log(log)
        count = sum(end <= size for end in ends[1:])
        assert (len(got.batches), got.ends) == (count, tuple(ends[1 : count + 1]))


def test_a_damaged_record_ends_the_log(log: Path) -> None:
    ends = read_log(log).ends
    content = bytearray(log.read_bytes())
    content[ends[2] + 20] ^= 1
    log.write_bytes(content)
    assert len(read_log(log).batches) == 3


def test_writing_continues_after_the_whole_time_steps(log: Path) -> None:
    before = log.read_bytes()
    batches, keep = read_log(log).whole_steps()
    assert [one.step for one in batches] == [0, 1, 2, 3, 4]
    written(log, batch(5), batch(5, LookKind.SEARCH), keep=keep)
    assert log.read_bytes() == before


def test_two_writers_do_not_share_a_log(log: Path) -> None:
    pytest.importorskip("fcntl")
    writer = opened(log, len(log.read_bytes()))
    assert is_in_use(log)
    refusal(InputError, "another posefuse is writing to it", opened, log, 10)
    writer.close()
    assert not is_in_use(log)


def test_what_is_no_log_is_reported(tmp_path: Path, log: Path) -> None:
    other = tmp_path / "other.log"
    refusal(InputError, "cannot be read", read_log, other)
    other.write_bytes(b"something else")
    refusal(InputError, "not a log of detections", read_log, other)
    other.write_bytes(log.read_bytes()[:40])
    refusal(InputError, "header is cut off", read_log, other)
    refusal(InputError, r"detections cannot be stored \(File exists\)", opened, log)
