"""Setups: cameras with their sources and names, and the rig that places them; presets are files of the workspace."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import posefuse as pf
from posefuse.core import InputError
from posefuse.foundation.platform import usb_cameras
from posefuse_studio.calibrations import FOLDER
from posefuse_studio.workspace import StudioWorkspace, check_name, read_stored, write_stored

DEMO = "Demo clip"
_FOLDER = "setups"
_FILES = ("video", "sim")
_MOST_CAMERAS = 64


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What a session or a calibration looks through.

    Attributes:
        name: as people call it. sources: by camera name, as for ``posefuse live --source``; files by their name in the workspace.
        rig: rig file in the workspace; empty while the cameras are not calibrated.
    """

    name: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    rig: str = ""


def setups(workspace: StudioWorkspace) -> list[Setup]:
    """The presets of a workspace by name, after the bundled clip."""
    paths = sorted(workspace.path(_FOLDER).glob("*.json"))
    found = [(path.stem, read_stored(path, Setup)) for path in paths]
    return [Setup(name=DEMO), *(replace(one, name=name) for name, one in found if one is not None and one.sources)]


def presets(workspace: StudioWorkspace) -> list[str]:
    """Names of those that were saved."""
    return [one.name for one in setups(workspace) if one.name != DEMO]


def setup_named(workspace: StudioWorkspace, name: str) -> Setup:
    """A preset; raises InputError where there is none."""
    for setup in setups(workspace):
        if setup.name == name:
            return setup
    raise InputError(f"setup {name!r}: not in the workspace")


def save_setup(workspace: StudioWorkspace, setup: Setup) -> None:
    """Write a preset; one of the same name is replaced.

    Raises:
        InputError: a name that is not plain, no camera, or a source that leads out of the workspace.
    """
    check_name(setup.name)
    if setup.name == DEMO:
        raise InputError(f"{DEMO}: is the bundled clip; choose another name")
    if not 1 <= len(setup.sources) <= _MOST_CAMERAS:
        raise InputError(f"setup {setup.name}: expected 1 to {_MOST_CAMERAS} cameras, got {len(setup.sources)}")
    for camera, what in setup.sources.items():
        check_name(camera)
        source_text(workspace, what)
    write_stored(workspace.folder(_FOLDER) / f"{setup.name}.json", setup)


def delete_setup(workspace: StudioWorkspace, name: str) -> None:
    """Remove a preset; its videos and rig stay."""
    check_name(name)
    workspace.path(f"{_FOLDER}/{name}.json").unlink(missing_ok=True)


def source_text(workspace: StudioWorkspace, what: str) -> str:
    """A source with the file it names made absolute; raises InputError for a file outside the workspace."""
    kind, colon, rest = what.partition(":")
    return f"{kind}:{workspace.existing(rest)}" if colon and kind.lower() in _FILES else what


def rig_of_setup(workspace: StudioWorkspace, setup: Setup) -> pf.Rig:
    """The calibrated cameras of a setup.

    Raises:
        InputError: it has no rig yet. CalibrationError: a rig file that cannot be read, or without poses.
    """
    if setup.name == DEMO:
        return pf.read_rig(pf.demo_session() / "rig.toml", placed=True)
    if not setup.rig:
        raise InputError(f"setup {setup.name}: its cameras are not calibrated yet; go to Calibrate, or choose a rig file")
    return pf.read_rig(workspace.existing(setup.rig), placed=True)


def sources_of_setup(workspace: StudioWorkspace, setup: Setup) -> dict[str, str]:
    """Its sources by camera name, as `posefuse.live` takes them; raises InputError for a file that is not in the workspace."""
    if setup.name == DEMO:
        return {path.stem: f"video:{path}" for path in sorted((pf.demo_session() / "videos").glob("*.mp4"))}
    return {camera: source_text(workspace, what) for camera, what in setup.sources.items()}


VIDEOS = (".mp4", ".mkv", ".mov", ".avi", ".webm")


@dataclass(frozen=True, kw_only=True)
class Found:
    """One source: its words for people, as it is written for ``--source``, and a name to start with."""

    text: str
    source: str
    name: str
    icon: str


def found_sources(workspace: StudioWorkspace) -> Iterator[Found]:
    """Devices first, then videos of the workspace; without what a calibration has recorded."""
    for number, (device, text) in enumerate(usb_cameras().items(), 1):
        yield Found(text=f"{text} ({device})", source=f"usb:{device}", name=f"cam{number}", icon="videocam")
    for name in workspace.files(*VIDEOS):
        if not name.startswith(f"{FOLDER}/"):
            yield Found(text=name, source=f"video:{name}", name=Path(name).stem[:40], icon="movie")
