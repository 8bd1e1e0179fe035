"""What the machine offers: `posefuse.doctor`, one check per thing a user may lack; `models` and `plugins`."""

from __future__ import annotations

import os
import platform
import re
import shutil
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, entry_points, requires, version
from pathlib import Path
from typing import Any

from posefuse.core import Progress
from posefuse.detection import default_cards, list_cards, status
from posefuse.detection.card import NetworkCard, needed_cards
from posefuse.detection.engines import devices_found
from posefuse.detection.files import fetch_all, model_path
from posefuse.foundation.platform import default_cache_dir, usable_cores, usb_cameras
from posefuse.foundation.plugins import GROUPS, list_plugins, option_names
from posefuse.foundation.summary import Block, Heading, Note, Table

from .arguments import checked, shown

EXTRAS = {
    "data": "tables of pandas",
    "studio": "page in the browser",
    "sim": "simulator",
    "viewer": "Rerun viewer and recordings",
    "biomech": "OpenSim",
    "ros": "ROS 2 messages, MCAP",
    "lsl": "Lab Streaming Layer",
    "teleop": "robot follows a hand",
    "realsense": "depth cameras of Intel",
    "onnx": "networks through ONNX Runtime",
    "gpu": "networks on a graphics card of NVIDIA",
    "cluster": "batch on a Dask cluster",
}


_LITTLE_DISK_GB = 5.0
NOT_READY = "Not ready: see the lines marked MISSING."


@dataclass(frozen=True)
class MachineCheck:
    """One line of `posefuse doctor`.

    Attributes:
        name: what was looked at. ok: it is there. needed: without it `track` cannot work.
        found: what was found. cure: remedy when it is not ok.
    """

    name: str
    ok: bool
    needed: bool
    found: str
    cure: str = ""


@dataclass(frozen=True, kw_only=True)
class Machine:
    """What works on this machine; needed things come first."""

    checks: tuple[MachineCheck, ...]

    @property
    def ready(self) -> bool:
        """Whether `track` will work."""
        return all(check.ok for check in self.checks if check.needed)

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values."""
        return {"ready": self.ready, "checks": [asdict(check) for check in self.checks]}

    def summary(self) -> list[Block]:
        """What was found and what to do, for people."""
        rows = [
            ("ok" if one.ok else "MISSING" if one.needed else "no", one.name, one.found, "" if one.ok else one.cure)
            for one in self.checks
        ]
        verdict = "Ready: `posefuse track SESSION --out DIR` will work." if self.ready else NOT_READY
        return [Heading("This machine"), Table(("", "what", "found", "what to do"), rows, text=True), Note(verdict)]


def doctor() -> Machine:
    """Check what works on this machine.

    Examples:
        >>> import posefuse as pf
        >>> [check.name for check in pf.doctor().checks][0]  # doctest: +SKIP
        'Python'
    """
    checks = [
        _python(),
        _disk(),
        _cache(),
        _video_codec(),
        *_models(),
        _network_devices(),
        _tracking(),
        *_extras(),
        _cameras(),
        *_of_packages(),
    ]
    return Machine(checks=tuple(checks))


def _python() -> MachineCheck:
    found = f"{platform.python_version()} on {platform.system()} {platform.machine()}, {usable_cores()} cores"
    return MachineCheck("Python", sys.version_info >= (3, 11), True, found, "install Python 3.11 or newer")


def _disk() -> MachineCheck:
    free_gb = shutil.disk_usage(Path.cwd()).free / 1e9
    cure = "free some: results with overlay.mp4 and recorded videos are large"
    return MachineCheck("disk", free_gb >= _LITTLE_DISK_GB, False, f"{free_gb:.0f} GB free in this folder", cure)


def _cache() -> MachineCheck:
    folder = default_cache_dir()
    nearest = next(parent for parent in (folder, *folder.parents) if parent.exists())
    writable = os.access(nearest, os.W_OK)
    # networks that others have put there can be read; kernels cannot be kept
    needed = any(status(card, folder) != "ready" for card in default_cards())
    free_gb = shutil.disk_usage(nearest).free / 1e9
    return MachineCheck(
        "model cache",
        writable,
        needed,
        f"{folder} ({free_gb:.0f} GB free)" if writable else f"{folder} cannot be written: every run compiles kernels, a minute",
        "make it writable, or set POSEFUSE_CACHE to a folder that is",
    )


def _names_of(extra: str) -> list[str]:
    """Names of the distributions of an extra."""
    lines = [line.replace("'", '"').partition(";") for line in requires("posefuse") or []]
    chosen = [name for name, _, marker in lines if f'extra == "{extra}"' in marker]
    return [re.split(r"[<>=~![]", name)[0].strip() for name in chosen]


def _installed(names: Sequence[str]) -> tuple[list[str], list[str]]:
    present, absent = [], []
    for name in names:
        try:
            present.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            absent.append(name)
    return present, absent


def _tracking() -> MachineCheck:
    """Whether `track` can begin: its modules import and the detector is ready, for real."""
    cure = "see what to do in the first line marked MISSING above; if there is none, please report this line"
    try:
        from posefuse.detection import BlazePoseConfig
        from posefuse.pipeline import track

        cache_dir = default_cache_dir()
        states = {status(card, cache_dir) for card in default_cards()}
        if "damaged" in states:
            return MachineCheck("tracking", False, True, f"{track.__name__} works; its networks are damaged", "posefuse models")
        if "missing" in states:
            return MachineCheck("tracking", True, True, "ready after the first download, which the first run begins (35 MB)")
        detector = BlazePoseConfig().build()
    except Exception as error:  # noqa: BLE001 - whatever stops this stops `track` as well
        return MachineCheck("tracking", False, True, f"{type(error).__name__}: {error}", cure)
    return MachineCheck("tracking", True, True, f"the detector is ready ({len(detector.skeleton)} keypoints)")


def _extras() -> list[MachineCheck]:
    checks = []
    for extra, purpose in EXTRAS.items():
        present, absent = _installed(_names_of(extra))
        found = ", ".join(present) if not absent else f"missing: {', '.join(absent)}"
        checks.append(MachineCheck(f"extra {extra}: {purpose}", not absent, False, found, f'pip install "posefuse[{extra}]"'))
    return checks


def _video_codec() -> MachineCheck:
    import av

    codecs = [name for name in ("h264", "hevc", "vp9", "libx264") if name in av.codecs_available]
    return MachineCheck(
        "video", "h264" in codecs, True, f"PyAV {av.__version__}: {', '.join(codecs)}", "reinstall PyAV: pip install av"
    )


def _models() -> list[MachineCheck]:
    cache_dir = default_cache_dir()
    needed = {card.name for card in default_cards()}
    return [
        MachineCheck(
            f"model {card.name}",
            state == "ready",
            card.name in needed and state == "damaged",
            f"{card.summary}: {state}",
            f"posefuse models {card.name}",
        )
        for card in list_cards()
        for state in [status(card, cache_dir)]
        if card.name.startswith("blazepose") or state != "missing"
    ]


def _network_devices() -> MachineCheck:
    """On what networks can run here, by what OpenVINO and ONNX Runtime say of themselves."""
    clash = len(_installed(("onnxruntime", "onnxruntime-gpu"))[0]) > 1
    return MachineCheck(
        "processors for networks",
        not clash,
        False,
        devices_found() + ("; onnxruntime and onnxruntime-gpu overwrite each other" if clash else ""),
        "pip uninstall onnxruntime onnxruntime-gpu, then install one of them: extra onnx, or gpu for NVIDIA",
    )


def _of_packages() -> list[MachineCheck]:
    """What the packages of extras look at: functions that return what they found, or raise DependencyError."""
    from posefuse.core import DependencyError

    checks = []
    for entry in entry_points(group="posefuse.machine_checks"):
        try:
            checks.append(MachineCheck(entry.name, True, False, entry.load()()))
        except DependencyError as error:
            checks.append(MachineCheck(entry.name, False, False, "no", str(error)))
    return checks


def _cameras() -> MachineCheck:
    found = usb_cameras()
    cure = "connect one; videos and network cameras need none"
    return MachineCheck("USB cameras", bool(found), False, ", ".join(found) or "none", cure)


@dataclass(frozen=True, kw_only=True)
class Models:
    """The networks on this machine: name, use, state, licence and file of each; those that were asked for and are not ready."""

    folder: Path
    models: tuple[dict[str, str], ...]
    missing: tuple[str, ...]

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values."""
        return {"models": [dict(one) for one in self.models], "exit_code": int(bool(self.missing))}

    def summary(self) -> list[Block]:
        """The networks, for people."""
        rows = [[*one.values()][:-1] for one in self.models]
        table = Table(("model", "for", "state", "licence"), rows, text=True)
        line = f"missing or damaged: {', '.join(self.missing)}; `posefuse models` fetches them"
        return [Heading(f"Models in {self.folder}"), table, *([Note(line, warning=True)] if self.missing else [])]


@checked
def models(
    names: Sequence[str] = (),
    *,
    check: bool = False,
    accept_licence: bool = False,
    progress: Progress | bool | None = None,
) -> Models:
    """Download neural networks into the user's cache and verify them.

    Args:
        names: of models; none: those that the default settings need.
        check: only look at what is there.
        accept_licence: the terms of these networks were read and are accepted.
        progress: True for lines on stderr, or a function (see `Progress`).

    Raises:
        ModelError: no such model, or one that cannot be had.

    Examples:
        >>> import posefuse as pf
        >>> pf.models(check=True).missing  # doctest: +SKIP
        ()
    """
    cache_dir, wanted = default_cache_dir(), _wanted(names)
    if not check:
        with shown(progress) as report:
            fetch_all(wanted, cache_dir, lambda _, __, ___, line="": report("models", 0, None, line), terms=accept_licence)
    found = tuple(
        {
            "name": card.name,
            "summary": card.summary,
            "state": status(card, cache_dir),
            "licence": card.licence,
            "path": str(model_path(card, cache_dir)),
        }
        for card in list_cards()
    )
    missing = tuple(card.name for card in wanted if status(card, cache_dir) != "ready")
    return Models(folder=cache_dir, models=found, missing=missing)


def _wanted(names: Sequence[str]) -> list[NetworkCard]:
    return list({card.name: card for name in names for card in needed_cards(name)}.values()) or default_cards()


@dataclass(frozen=True, kw_only=True)
class Plugins:
    """Cameras, detectors and outputs, bundled and from other packages: kind, name, package, options, reason of a refusal."""

    plugins: tuple[dict[str, Any], ...]

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values."""
        return {"plugins": [dict(one) for one in self.plugins]}

    def summary(self) -> list[Block]:
        """The plug-ins, for people."""
        rows = [[one["kind"], one["name"], one["package"], one["reason"] or ", ".join(one["options"]) or "-"]
                for one in self.plugins]  # fmt: skip
        columns = ("kind", "name", "package", "options, or why it cannot be used")
        return [Heading("Plug-ins"), Table(columns, rows, text=True)]


def plugins() -> Plugins:
    """The cameras, detectors and outputs that can be used, and why others cannot.

    Examples:
        >>> import posefuse as pf
        >>> {one["kind"] for one in pf.plugins().plugins} >= {"detectors", "outputs"}
        True
    """
    found = [plugin for kind in GROUPS for plugin in list_plugins(kind)]
    return Plugins(
        plugins=tuple(
            {"kind": p.kind, "name": p.name, "package": p.package, "options": option_names(p), "reason": p.reason or None}
            for p in found
        )
    )
