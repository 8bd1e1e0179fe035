"""A network may run on any core: one that is pinned shares its core with the networks of all other camera processes."""

import os
import threading
from pathlib import Path

import numpy as np
import openvino as ov
import pytest
from openvino import opset8 as ops

from posefuse.detection.device import CPU
from posefuse.detection.engines import compiled_by_openvino

SHAPE, INFERENCES, SAMPLES = (1, 16, 192, 192), 60, 40


@pytest.fixture
def slow_network() -> ov.Model:
    """A millisecond or more per image, so that a thread can be watched while it infers."""
    image = ops.parameter(SHAPE, np.float32)
    kernel = ops.constant(np.random.default_rng(1).normal(size=(32, 16, 3, 3)).astype(np.float32))
    return ov.Model([ops.convolution(image, kernel, [1, 1], [0, 0], [0, 0], [1, 1])], [image], "slow")


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2, reason="needs Linux and two cores")
def test_no_thread_is_pinned_to_a_core_while_it_infers(slow_network: ov.Model) -> None:
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
