"""Random but valid values, every axis a different size; cameras of another process, and two machines on one."""

import pickle
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from built import detections
from own_domain import own_domain
from ros1_master import alone, ros1_python  # noqa: F401
from running import Running

from posefuse.core import SKELETONS, Camera, Detections2D, Skeleton


@pytest.fixture
def some_detections() -> Callable[..., Detections2D]:
    def make(
        people: int = 3, skeleton: Skeleton = SKELETONS["blazepose33"], seed: int = 0, t_ns: int = 1_700_000_000_123_456_789
    ):
        rng = np.random.default_rng(seed)
        shape = (people, len(skeleton))
        xy = rng.uniform(0, 600, (*shape, 2))
        known = {"score": rng.uniform(0, 1, shape), "sigma_px": rng.uniform(1, 9, shape)}
        lost = rng.random(shape) < 0.2
        xy[lost], known["score"][lost], known["sigma_px"][lost] = np.nan, 0, np.nan
        known["box_img"] = rng.uniform(0, 600, (people, 4))
        clothing_lab = np.where(rng.random((people, 3, 3)) < 0.2, np.nan, rng.uniform(-50, 99, (people, 3, 3)))
        return detections("cam 3/left", xy, t_ns, skeleton=skeleton, clothing_lab=clothing_lab, **known)

    return make


class Kept:
    """An outlet that keeps what it is given."""

    def __init__(self) -> None:
        self.sent = []
        self.unwanted = set()
        self.forgotten = []

    def publish(self, topic, msg, t_ns):
        assert msg.__msgtype__ == topic.type_name
        self.sent.append(SimpleNamespace(topic=topic, msg=msg, t_ns=t_ns))

    def wanted(self, topic):
        return topic.name not in self.unwanted

    def forget(self, name):
        self.forgotten.append(name)

    def on(self, name):
        return [s.msg for s in self.sent if s.topic.name == name]


@pytest.fixture
def kept() -> Kept:
    return Kept()


@pytest.fixture(scope="module")
def sender(ring_rig, tmp_path_factory) -> Camera:
    """`support/image_sender.py` with cameras of `ring_rig(4)`, cam01 with another lens, which this is; cam03 is silent."""
    path, first, second, third = tmp_path_factory.mktemp("sender") / "cameras.pickle", *ring_rig(4).cameras[:3]
    other = replace(second, K=second.K * np.array([[1.05, 1, 1], [1, 1.05, 1], [1, 1, 1]]))
    path.write_bytes(pickle.dumps([first, other, third]))
    program = Path(__file__).parents[1] / "support" / "image_sender.py"
    with Running([sys.executable, str(program), str(own_domain()), str(path)]) as running:
        running.out.wait_for("sending")
        yield other


@pytest.fixture
def machines():
    """Two machines joined by a link of this process's own making; skips where the kernel or the user does not allow it."""
    from bench import two_machines

    reason = two_machines.why_not()
    if reason:
        pytest.skip(reason)
    with two_machines.TwoMachines(seed=3) as two:
        yield two
