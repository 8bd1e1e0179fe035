"""What a recording stores about how it was made: the rig and all settings, for the second solve and for replays."""

from __future__ import annotations

import json
from dataclasses import asdict

from posefuse import __version__
from posefuse.core import Rig
from posefuse.formats.recording import rig_values

from .config import LiveConfig


def notes_of(rig: Rig, config: LiveConfig) -> dict[str, str]:
    """As texts for a file."""
    return {
        "posefuse": __version__,
        "cameras": json.dumps(rig.names),
        "rig_id": rig.id,
        "rig": json.dumps(rig_values(rig)),
        "settings": json.dumps(asdict(config), default=str),
    }
