"""A scene file with the motion files it names, as a folder of simulated data keeps them."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import yaml

from .scene import Scene, with_motion_files

SCENE_FILE = "scene.yaml"


def write_scene(scene: Scene, folder: Path) -> None:
    """Write scene.yaml, every setting in it, and copy the motion files: the folder holds all it was made from."""
    (folder / SCENE_FILE).write_text(scene_text(scene), encoding="utf-8")
    with_motion_files(scene, lambda i, file: _copied(Path(file), folder / _motion_name(i, file)))


def scene_text(scene: Scene) -> str:
    """The content of scene.yaml: every setting, motion files as the session holds them."""
    return yaml.safe_dump(plain_settings(with_motion_files(scene, _motion_name)), sort_keys=False)


def _motion_name(person: int, file: str) -> str:
    return f"motion/{person}-{Path(file).name}"


def _copied(file: Path, into: Path) -> str:
    """Copy a motion file or folder, so that the session holds all it was made from."""
    into.parent.mkdir(exist_ok=True)
    if file.is_dir():
        shutil.copytree(file, into, dirs_exist_ok=True)
    else:
        shutil.copyfile(file, into)
    return str(into)


def plain_settings(settings: Any) -> Any:
    """Settings as plain values for YAML: mappings, lists, numbers, text."""
    if dataclasses.is_dataclass(settings):
        return {field.name: plain_settings(getattr(settings, field.name)) for field in dataclasses.fields(settings)}
    if isinstance(settings, dict):
        return {key: plain_settings(value) for key, value in settings.items()}
    if isinstance(settings, (tuple, list)):
        return [plain_settings(value) for value in settings]
    return settings
