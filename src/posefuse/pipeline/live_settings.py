"""Settings for the second solve of a live session, from those that it was made with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from posefuse.association import AssociateSettings
from posefuse.detection.build import DetectorChoice
from posefuse.foundation.settings import settings_from_mapping
from posefuse.fusion import FuseSettings

from .config import TrackConfig


def track_config_of_live(settings: Mapping[str, Any], where: str) -> TrackConfig:
    """The settings that a recorded run shares with a live one, as the session had them; all others at their defaults.

    Args:
        settings: those of `posefuse live`, as plain values. where: for messages.

    Raises:
        ConfigError: settings of another version.
    """
    associate = settings_from_mapping(settings.get("associate", {}), AssociateSettings, where=f"{where}: associate")
    people = settings.get("track", {}).get("max_people", associate.max_people)
    return TrackConfig(
        detector=settings_from_mapping(settings.get("detector", {}), DetectorChoice, where=f"{where}: detector"),
        associate=replace(associate, max_people=people),
        fuse=settings_from_mapping(settings.get("fuse", {}), FuseSettings, where=f"{where}: fuse"),
        names=tuple(settings.get("names", ())),
        joint_centres=bool(settings.get("joint_centres", True)),
    )
