"""Random but valid values, every axis a different size; and two machines on one."""

import fcntl
import heapq
import os
import random
import select
import shutil
import struct
import subprocess
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from posefuse.core import SE3, SKELETONS, Detections2D, Joints, Pose3D, Skeleton

_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000


@pytest.fixture
def some_detections() -> Callable[..., Detections2D]:
    def make(
        people: int = 3, skeleton: Skeleton = SKELETONS["blazepose33"], seed: int = 0, t_ns: int = 1_700_000_000_123_456_789
    ):
        rng = np.random.default_rng(seed)
        k = len(skeleton)
        xy = rng.uniform(0, 600, (people, k, 2))
        score, sigma = rng.uniform(0, 1, (people, k)), rng.uniform(1, 9, (people, k))
        lost = rng.random((people, k)) < 0.2
        xy[lost], score[lost], sigma[lost] = np.nan, 0, np.nan
        return Detections2D("cam 3/left", t_ns, skeleton, xy, score, sigma, rng.uniform(0, 600, (people, 4)))

    return make


@pytest.fixture
def some_pose() -> Callable[..., Pose3D]:
    def make(people: int = 2, skeleton: Skeleton = SKELETONS["coco17"], seed: int = 0, t_ns: int = 1_700_000_000_123_456_789):
        rng = np.random.default_rng(seed)
        k = len(skeleton)
        half = rng.normal(size=(people, k, 3, 3)) * 0.02
        cov = half @ np.swapaxes(half, -1, -2)
        cov = (cov + np.swapaxes(cov, -1, -2)) / 2
        xyz = rng.normal(size=(people, k, 3))
        reproj, views = rng.uniform(0, 5, (people, k)), rng.integers(0, 9, (people, k))
        kind = rng.integers(0, 5, (people, k))
        lost = rng.random((people, k)) < 0.2
        xyz[lost], cov[lost], reproj[lost], views[lost], kind[lost] = np.nan, np.nan, np.nan, 0, 0
        return Pose3D(t_ns, skeleton, np.array([40, 7, 11][:people]), xyz, cov, reproj, views, kind)

    return make


@pytest.fixture
def standing() -> Callable[..., Pose3D]:
    """A person who stands at the origin and looks along +x; `moved` overrides keypoints."""

    def make(**moved: tuple[float, float, float]) -> Pose3D:
        right = {
            "shoulder": (0, -0.2, 1.4), "elbow": (0, -0.2, 1.1), "wrist": (0, -0.2, 0.85), "hip": (0, -0.1, 0.9),
            "knee": (0, -0.1, 0.5), "ankle": (0, -0.1, 0.1), "ear": (0, -0.08, 1.6), "eye": (0.08, -0.03, 1.63),
        }  # fmt: skip
        at = {"nose": (0.1, 0.0, 1.6)}
        for part, (x, y, z) in right.items():
            at |= {f"right_{part}": (x, y, z), f"left_{part}": (x, -y, z)}
        at |= moved
        skeleton = SKELETONS["coco17"]
        xyz = np.array([[at[name] for name in skeleton.keypoints]], float)
        k = len(skeleton)
        cov = np.tile(np.eye(3) * 1e-4, (1, k, 1, 1))
        return Pose3D(5_000_000_000, skeleton, [1], xyz, cov, np.ones((1, k)), np.full((1, k), 3), np.ones((1, k)))

    return make


@pytest.fixture
def some_joints() -> Joints:
    rng = np.random.default_rng(3)
    return Joints(
        np.array([4_000_000_000, 5_000_000_000]),
        np.array([40, 7]),
        ("pelvis", "left_thigh", "left_shank"),
        SE3(rng.normal(size=(2, 2, 3, 4)), rng.normal(size=(2, 2, 3, 3))),
        ("left_hip", "left_knee", "left_ankle", "neck"),
        (("flexion", "adduction", "rotation"),) * 4,
        rng.normal(size=(2, 2, 4, 3)),
        rng.uniform(0.01, 0.1, (2, 2, 4, 3)),
    )


class Kept:
    """An outlet that keeps what it is given."""

    def __init__(self) -> None:
        self.sent = []
        self.forgotten = []

    def publish(self, topic, msg, t_ns):
        assert msg.__msgtype__ == topic.type_name
        self.sent.append(SimpleNamespace(topic=topic, msg=msg, t_ns=t_ns))

    def forget(self, name):
        self.forgotten.append(name)

    def on(self, name):
        return [s.msg for s in self.sent if s.topic.name == name]


@pytest.fixture
def kept() -> Kept:
    return Kept()


@pytest.fixture
def machines():
    """Two machines joined by a link of this process's own making; skips where the kernel or the user does not allow it."""
    reason = _why_not_two_machines()
    if reason:
        pytest.skip(reason)
    with TwoMachines(seed=3) as two:
        yield two


def _why_not_two_machines() -> str:
    """Why two machines cannot be made here; empty when they can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "`ip` is missing (Debian: iproute2)"
    if not os.access("/dev/net/tun", os.R_OK | os.W_OK):
        return "/dev/net/tun is missing"
    made = subprocess.run(["ip", "netns", "add", "pf_probe"], capture_output=True, text=True)
    subprocess.run(["ip", "netns", "del", "pf_probe"], capture_output=True)
    return "" if made.returncode == 0 else f"no network namespaces ({made.stderr.strip()})"


class TwoMachines:
    """Namespaces `names` with addresses `addresses`; `loss` (0..1), `delay_s` and `cut` may be set at any time."""

    def __init__(self, seed: int = 0) -> None:
        tag = f"{os.getpid() % 10_000}"
        self.names = (f"pf{tag}a", f"pf{tag}b")
        self.addresses = ("10.77.0.1", "10.77.0.2")
        self.loss, self.delay_s, self.cut = 0.0, 0.0, False
        self._random = random.Random(seed)
        self._fds = []
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._carry, daemon=True)

    def __enter__(self):
        for name, address in zip(self.names, self.addresses, strict=True):
            device = f"{name}0"
            fd = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            fcntl.ioctl(fd, _TUNSETIFF, struct.pack("16sH", device.encode(), _IFF_TUN | _IFF_NO_PI))
            self._fds.append(fd)
            _ip("netns", "add", name)
            _ip("link", "set", device, "netns", name)
            _ip("-n", name, "addr", "add", f"{address}/24", "dev", device)
            _ip("-n", name, "link", "set", device, "up", "multicast", "on", "txqueuelen", "1000")
            _ip("-n", name, "link", "set", "lo", "up")
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._done.set()
        self._thread.join()
        for fd in self._fds:
            os.close(fd)
        for name in self.names:
            _ip("netns", "del", name)

    def start(self, machine: int, *command: str, **options) -> subprocess.Popen:
        """Run a program on machine 0 or 1."""
        return subprocess.Popen(
            ["ip", "netns", "exec", self.names[machine], *command], stdout=subprocess.PIPE, text=True, **options
        )

    def _carry(self) -> None:
        waiting: list[tuple[float, int, int, bytes]] = []
        count = 0
        while not self._done.is_set():
            now = time.monotonic()
            while waiting and waiting[0][0] <= now:
                _, _, fd, packet = heapq.heappop(waiting)
                if not self.cut:
                    _send(fd, packet)
            timeout = min(0.05, waiting[0][0] - now) if waiting else 0.05
            for fd in select.select(self._fds, [], [], max(timeout, 0))[0]:
                packet = os.read(fd, 65536)
                other = self._fds[1 - self._fds.index(fd)]
                if not self.cut and self._random.random() >= self.loss:
                    count += 1
                    heapq.heappush(waiting, (time.monotonic() + self.delay_s, count, other, packet))


def _send(fd: int, packet: bytes) -> None:
    try:
        os.write(fd, packet)
    except BlockingIOError:
        return  # a full queue drops, as a real link does


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)
