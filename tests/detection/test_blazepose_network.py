"""Crops through a network: each answer belongs to its crop, however many threads work, on any core."""

import os
import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import openvino as ov
import pytest
from openvino import opset8 as ops

from posefuse.core import Region
from posefuse.detection.card import NetworkInput
from posefuse.detection.crops import Crops, square_crop
from posefuse.detection.device import CPU
from posefuse.detection.engines import BlazePoseNetwork, compiled_by_openvino

SIDE = 16


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network that gives the mean of each colour, and the crop back."""
    image = ops.parameter((1, SIDE, SIDE, 3), np.float32, name="image")
    mean, back = ops.reduce_mean(image, ops.constant([1, 2])), ops.add(image, ops.constant(np.float32(1)))
    for node, name in ((mean, "mean"), (back, "back")):
        node.output(0).set_names({name})
    path = tmp_path_factory.mktemp("network") / "mean.xml"
    ov.save_model(ov.Model([mean, back], [image], "mean"), path, compress_to_fp16=False)
    return path


def network(file: Path, streams: int) -> BlazePoseNetwork:
    return BlazePoseNetwork(file, ("mean", "back"), NetworkInput(size_wh=(SIDE, SIDE)), "f32", streams)


def crops(count: int) -> list[np.ndarray]:
    return list(np.random.default_rng(count).integers(0, 256, (count, SIDE, SIDE, 3), np.uint8))


@pytest.mark.parametrize("streams", [1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 3, 4, 13])
def test_every_answer_is_that_of_its_crop(file: Path, streams: int, count: int) -> None:
    built, given = network(file, streams), crops(count)
    for _ in range(2):
        mean, back = built(given)
        assert mean.shape == (count, 3)
        assert back.shape == (count, SIDE, SIDE, 3)
        for i, crop in enumerate(given):
            np.testing.assert_allclose(mean[i], crop.mean(axis=(0, 1)), rtol=1e-5)
            np.testing.assert_allclose(back[i], crop.astype(float) + 1, rtol=1e-5)


class Broken(Sequence[np.ndarray]):
    """Crops of which the last cannot be cut."""

    def __len__(self) -> int:
        return 3

    def __getitem__(self, i):
        if i == 2:
            raise KeyboardInterrupt
        return crops(3)[i]


@pytest.mark.parametrize("streams", [1, 2])
def test_a_call_after_one_that_was_stopped_gives_its_own_answers(file: Path, streams: int) -> None:
    built = network(file, streams)
    for count in (1, 3):
        with pytest.raises(KeyboardInterrupt):
            built(Broken())
        mean, _ = built(crops(count))
        np.testing.assert_allclose(mean, [crop.mean(axis=(0, 1)) for crop in crops(count)], rtol=1e-5)


class Asked(Sequence[np.ndarray]):
    """Crops that keep how many answers of the network were there when each was asked for."""

    def __init__(self, count: int) -> None:
        self.made, self.order = crops(count), []

    def __len__(self) -> int:
        return len(self.made)

    def __getitem__(self, i):
        self.order.append(i)
        return self.made[i]


def test_a_crop_is_asked_for_after_those_before_it_were_given_to_the_network(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given, started = Asked(5), []
    start = ov.InferRequest.start_async
    monkeypatch.setattr(ov.InferRequest, "start_async", lambda *args: (started.append(len(given.order)), start(*args)))
    network(file, 2)(given)
    assert started == [1, 2, 3, 4, 5]


def test_crops_are_cut_once_and_when_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    image = np.random.default_rng(1).integers(0, 256, (90, 120, 3), np.uint8)
    regions = [Region(centre_img=np.array([60.0, 10.0 * i]), side_px=40.0 + i, angle_rad=0.1 * i) for i in range(4)]
    cuts: list[Region] = []
    monkeypatch.setattr("posefuse.detection.crops.square_crop", lambda *args: (cuts.append(args[1]), square_crop(*args))[1])
    lazy = Crops([(image, region) for region in regions], SIDE)
    assert len(lazy) == 4
    assert not cuts
    np.testing.assert_array_equal(lazy[2], square_crop(image, regions[2], SIDE))
    assert cuts == [regions[2]]
    for _ in range(2):
        np.testing.assert_array_equal(list(lazy), [square_crop(image, region, SIDE) for region in regions])
    assert len(cuts) == 4


SHAPE, INFERENCES, SAMPLES = (1, 16, 192, 192), 60, 40


@pytest.fixture
def slow_network() -> ov.Model:
    """A millisecond or more per image, so that a thread can be watched while it infers."""
    image = ops.parameter(SHAPE, np.float32)
    kernel = ops.constant(np.random.default_rng(1).normal(size=(32, 16, 3, 3)).astype(np.float32))
    return ov.Model([ops.convolution(image, kernel, [1, 1], [0, 0], [0, 0], [1, 1])], [image], "slow")


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2, reason="needs Linux and two cores")
def test_no_thread_is_pinned_to_a_core_while_it_infers(slow_network: ov.Model) -> None:
    """One that is pinned shares its core with the networks of all other camera processes."""
    allowed = os.sched_getaffinity(0)
    request = compiled_by_openvino(slow_network, CPU, "f32", 1).create_infer_request()
    image = np.ones(SHAPE, np.float32)
    ended = threading.Event()

    def infer() -> None:
        for _ in range(INFERENCES):
            request.infer({0: image})
        ended.set()

    thread = threading.Thread(target=infer)
    thread.start()
    samples = 0
    while not ended.is_set() or samples < SAMPLES:
        samples += 1
        for task in Path("/proc/self/task").iterdir():
            try:
                assert os.sched_getaffinity(int(task.name)) == allowed
            except ProcessLookupError:
                continue
    thread.join(60.0)
