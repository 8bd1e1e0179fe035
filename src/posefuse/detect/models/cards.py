"""Model cards: what a network eats, what it says, and where its file comes from."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from annotated_types import Gt

from posefuse.core import ModelError
from posefuse.core.errors import choices
from posefuse.files.settings import read_mapping, settings, settings_from_mapping

from .archives import NpmSource, WheelSource

CARDS_FOLDER = Path(__file__).parents[1] / "cards"
_BESIDE_SUFFIXES = (".noise.toml", ".joint_centres.toml")


@settings
class ModelInput:
    """What the network eats: a square RGB image whose 0..255 is mapped to low..high."""

    side_px: Annotated[int, Gt(0)]
    low: float
    high: float


@settings
class PersonDecoding:
    """How boxes and alignment points come out of a single-shot person detector.

    Attributes:
        boxes, scores: names of the outputs.
        grids: (cells per side, anchors per cell) in the order of the anchors.
        centre_keypoint: alignment point in the middle of the hips.
        rim_keypoint: alignment point on the circle about it that holds the person, in the direction of the head.
    """

    boxes: str
    scores: str
    grids: tuple[tuple[int, int], ...]
    centre_keypoint: int
    rim_keypoint: int


@settings
class LandmarkDecoding:
    """How keypoints come out of a landmark network.

    Attributes:
        landmarks, presence, heatmaps: names of the outputs.
        channels: landmarks the network gives; the skeleton's keypoints are the first of them.
        skeleton: its name in `core.SKELETONS`.
        noise: file beside the card with the fitted noise model.
        joint_centres: file beside the card with the offsets from landmarks to joint centres; None when not known.
    """

    landmarks: str
    presence: str
    heatmaps: str
    channels: Annotated[int, Gt(0)]
    skeleton: str
    noise: str
    joint_centres: str | None = None


@settings
class ModelCard:
    """A network of a known kind.

    Attributes:
        name: the card's file name without suffix. folder: where the card lies.
        kind: decides which decoding applies.
        summary: what it is for, in a few words.
        licence, sha256, source, input, decoding: see there.
    """

    name: str
    folder: Path
    kind: Literal["person_ssd", "heatmap_landmarks"]
    summary: str
    licence: str
    sha256: str
    source: WheelSource | NpmSource
    input: ModelInput
    decoding: PersonDecoding | LandmarkDecoding

    @property
    def file_name(self) -> str:
        """Name of the model file, the same inside the archive and in the cache."""
        return PurePosixPath(self.source.member).name


def list_cards() -> list[ModelCard]:
    """The cards that come with the package, by name."""
    paths = [path for path in CARDS_FOLDER.glob("*.toml") if not path.name.endswith(_BESIDE_SUFFIXES)]
    return [read_card(path) for path in sorted(paths)]


def read_card(name: str | Path) -> ModelCard:
    """The card of this name, or in this TOML file; raises ModelError or ConfigError when there is none or it is wrong."""
    path = Path(name)
    if path.suffix != ".toml":
        path = CARDS_FOLDER / f"{name}.toml"
        if not path.is_file():
            raise ModelError(f"no model card {str(name)!r}; there are: {choices(card.name for card in list_cards())}")
    content: dict[str, Any] = {"name": path.stem, "folder": path.parent, **read_mapping(path)}
    return settings_from_mapping(content, ModelCard, where=str(path))
