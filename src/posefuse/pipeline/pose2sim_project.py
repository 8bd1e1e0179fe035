"""What the ``Config.toml`` of a Pose2Sim project states that a session needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from posefuse.core import ConfigError
from posefuse.foundation.settings import read_mapping

PROJECT_FILE = "Config.toml"
# names of its pose models -> our keypoint sets
POSE_MODELS = {
    "body": "coco17",
    "coco_17": "coco17",
    "body_with_feet": "halpe_26",
    "halpe_26": "halpe_26",
    "whole_body": "coco_wholebody_133",
    "coco_133": "coco_wholebody_133",
    "body_25": "body_25",
    "body_25b": "body_25b",
    "blazepose": "blazepose33",
}


@dataclass(frozen=True)
class Pose2SimProject:
    """Facts of a project.

    Attributes:
        frame_rate_hz: None where it is ``auto`` or missing.
        skeleton: name of the keypoint set of its pose files; None where it is not known.
    """

    frame_rate_hz: float | None
    skeleton: str | None


def read_project(folder: Path) -> Pose2SimProject | None:
    """The project a session folder is, or is a trial of; None where there is no ``Config.toml``.

    Raises:
        ConfigError: a file that cannot be read.
    """
    files = [place / PROJECT_FILE for place in (folder, folder.absolute().parent) if (place / PROJECT_FILE).is_file()]
    if not files:
        return None
    # a trial's file has only the differences from the session's file above it
    contents = [read_mapping(file) for file in files]
    rate = next((value for content in contents if (value := _entry(content, "project", "frame_rate")) is not None), None)
    model = next((value for content in contents if (value := _entry(content, "pose", "pose_model")) is not None), None)
    if rate is not None and rate != "auto" and not (isinstance(rate, int | float) and rate > 0):
        raise ConfigError(f"{files[0]}: project.frame_rate: expected a number or 'auto', got {rate!r}")
    return Pose2SimProject(None if rate in (None, "auto") else float(rate), POSE_MODELS.get(str(model).lower()))


def _entry(content: Mapping[str, Any], table: str, key: str) -> Any:
    inside = content.get(table)
    return inside.get(key) if isinstance(inside, Mapping) else None
