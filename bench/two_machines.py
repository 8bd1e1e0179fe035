"""Two machines on one: network namespaces joined by a link that loses, delays and breaks on request.

The link is carried by this process, packet by packet between two TUN devices, so that no module of the kernel is needed and what
is lost follows from a seed. As root, on Linux.
"""

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

_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000


def why_not() -> str:
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
