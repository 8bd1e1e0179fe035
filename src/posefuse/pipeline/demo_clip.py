"""The bundled clip: four simulated cameras, a walking person."""

from __future__ import annotations

from pathlib import Path

from posefuse.core import InputError

_PACKAGE = Path(__file__).resolve().parents[1]
# a wheel has the first seconds of the videos, and the rig; a checkout has all of it, with the exact truth
_PLACES = (_PACKAGE.parents[1] / "examples" / "demo", _PACKAGE / "demo_clip")


def clip_folder() -> Path:
    """The session folder of the clip; raises InputError when this installation has none."""
    for place in _PLACES:
        if (place / "rig.toml").is_file():
            return place
    raise InputError(f"the bundled clip is not in this installation (looked in {_PLACES[-1]}); reinstall posefuse")
