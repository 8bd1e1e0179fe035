"""What a recording stores about how it was made, so that a replay needs no options."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from posefuse import __version__
from posefuse.core import InputError, Rig
from posefuse.formats.recording import rig_values
from posefuse.foundation.settings import settings_from_mapping
from posefuse.messages.bags import read_notes
from posefuse.outputs.live.record import NOTES

from .config import LiveConfig


@dataclass(frozen=True)
class Provenance:
    """How a session was recorded: its cameras in their order, the rig's content hash, and all settings."""

    cameras: tuple[str, ...]
    rig_id: str
    config: LiveConfig


def notes_of(rig: Rig, config: LiveConfig) -> dict[str, str]:
    """As texts for a file."""
    return {
        "posefuse": __version__,
        "cameras": json.dumps(rig.names),
        "rig_id": rig.id,
        "rig": json.dumps(rig_values(rig)),
        "settings": json.dumps(asdict(config), default=str),
    }


def read_provenance(path: Path) -> Provenance | None:
    """What `notes_of` left in a recording; None where there is nothing. Raises InputError for settings of another version."""
    notes: Mapping[str, str] | None = read_notes(path, NOTES)
    if notes is None:
        return None
    try:
        cameras, rig_id, settings = json.loads(notes["cameras"]), notes["rig_id"], json.loads(notes["settings"])
    except (KeyError, ValueError) as error:
        raise InputError(f"{path}: its notes on how it was made cannot be read ({error})") from None
    config = settings_from_mapping(settings, LiveConfig, where=f"{path}, made with posefuse {notes.get('posefuse', '?')}")
    return Provenance(tuple(cameras), rig_id, config)
