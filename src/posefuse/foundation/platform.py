"""What differs between Linux, macOS and Windows, in one place: cores, priorities, cameras, message channels, the cache."""

from __future__ import annotations

import contextlib
import ctypes
import os
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import platformdirs

from posefuse.core.errors import ConfigError

# how FFmpeg reads USB cameras of each system; any other system is taken for one with Video4Linux
_CAMERA_FORMATS = {"win32": "dshow", "darwin": "avfoundation"}
# where Linux has cameras, and what it states of them
DEVICES, V4L = Path("/dev"), Path("/sys/class/video4linux")
_BELOW_NORMAL_PRIORITY_CLASS = 0x4000
_TIMER_MS = 1


def usable_cores() -> int:
    """How many cores this process may use; at least 1."""
    if hasattr(os, "process_cpu_count"):  # Python 3.13
        return os.process_cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def available_memory_bytes() -> int | None:
    """Memory that a new process can use without swapping, as Linux reports it; None where that is not known."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")), None)


def lower_priority(steps: int) -> None:
    """Let other processes go first: by so many steps of niceness, on Windows by one class. No effect where not allowed."""
    if hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(steps)
    elif sys.platform == "win32":
        kernel32 = ctypes.WinDLL("kernel32")
        kernel32.GetCurrentProcess.restype = ctypes.c_void_p
        kernel32.SetPriorityClass.argtypes = (ctypes.c_void_p, ctypes.c_ulong)
        kernel32.SetPriorityClass(kernel32.GetCurrentProcess(), _BELOW_NORMAL_PRIORITY_CLASS)


def lower_thread_priority(steps: int) -> None:
    """Let this process's other threads go before the calling one, by so many steps of niceness; on Linux alone."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            thread = threading.get_native_id()
            os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, thread) + steps)


@contextlib.contextmanager
def punctual() -> Iterator[None]:
    """This process is scheduled first and its waits end on time, where the system allows it; its children do not inherit it."""
    if sys.platform == "win32":
        # waits end every 15.6 ms otherwise
        winmm = ctypes.WinDLL("winmm")
        winmm.timeBeginPeriod(_TIMER_MS)
        try:
            yield
        finally:
            winmm.timeEndPeriod(_TIMER_MS)
        return
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    except (OSError, AttributeError):
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


def peak_memory_mb(pids: Sequence[int]) -> float:
    """Peak memory of processes (resident, shared memory counted in each), added up; NaN where the system does not report it."""
    try:
        status = [Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace") for pid in pids]
        return sum(int(text.split("VmHWM:")[1].split()[0]) for text in status) / 1024
    except (OSError, IndexError, ValueError):
        return float("nan")


def processor_s(pid: int) -> float | None:
    """Processor time of a process so far; None where the system does not report it."""
    try:
        # the name in brackets may hold anything
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return None


def message_sockets() -> tuple[socket.socket, socket.socket]:
    """Two connected byte streams of this machine."""
    ends = socket.socketpair()
    for end in ends:
        # Windows connects two TCP sockets on the loopback
        if end.family in (socket.AF_INET, socket.AF_INET6):
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return ends


def usb_camera_format() -> str:
    """FFmpeg's name of the input that reads USB cameras here."""
    return _CAMERA_FORMATS.get(sys.platform, "v4l2")


def usb_camera_address(device: str) -> str:
    """What FFmpeg calls the camera: DirectShow needs the prefix of a video device."""
    return f"video={device}" if usb_camera_format() == "dshow" and not device.startswith("video=") else device


def usb_cameras() -> dict[str, str]:
    """The cameras that are there: what the system calls each, by the name that a user gives; empty where it cannot list them."""
    import av

    if usb_camera_format() == "v4l2":
        # a camera has several nodes; that of its images has index 0
        nodes = {str(path): V4L / path.name for path in sorted(DEVICES.glob("video*"))}
        return {path: _line(node / "name") or path for path, node in nodes.items() if _line(node / "index") in ("0", "")}
    try:
        found = av.enumerate_input_devices(usb_camera_format())
    except (av.error.FFmpegError, ValueError):
        return {}
    named = "description" if usb_camera_format() == "dshow" else "name"
    cameras = [device for device in found if "video" in device.media_types]
    return {getattr(device, named): device.description or device.name for device in cameras}


def _line(path: Path) -> str:
    """What a file of the system has; empty where there is none."""
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""


def default_cache_dir() -> Path:
    """The user's cache folder: POSEFUSE_CACHE, else the system's place for caches (Linux: XDG_CACHE_HOME or ~/.cache)."""
    if own := os.environ.get("POSEFUSE_CACHE"):
        return Path(own)
    return home_folder(platformdirs.user_cache_dir, "POSEFUSE_CACHE")


def home_folder(of_system: Callable[..., str], instead: str) -> Path:
    """Our folder at a place that `platformdirs` knows, e.g. `user_cache_dir`.

    Args:
        instead: the variable that names another place.

    Raises:
        ConfigError: the user has no home folder, as one of a container that no account belongs to.
    """
    try:
        return Path(of_system("posefuse", appauthor=False))
    except RuntimeError:
        raise ConfigError(f"this user has no home folder; set HOME or {instead} to a folder that can be written") from None


def display() -> str:
    """Where windows open; empty where there is no screen. Windows and macOS have a desktop of their own."""
    if sys.platform in ("win32", "darwin"):
        return "desktop"
    return os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or ""
