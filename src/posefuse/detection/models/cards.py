"""Model cards: inputs and outputs of a network, and the source of its file."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from annotated_types import Gt, MinLen

from posefuse.core import ModelError
from posefuse.core.errors import choices
from posefuse.foundation.settings import read_mapping, settings, settings_from_mapping

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
        noise: file next to the card with the fitted noise model.
        joint_centres: file next to the card with the offsets from landmarks to joint centres; None when not known.
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
        size_bytes: of the model file; an archive is never unpacked beyond it.
        licence, sha256, source, input, decoding: see there.
    """

    name: str
    folder: Path
    kind: Literal["person_ssd", "heatmap_landmarks"]
    summary: str
    licence: str
    sha256: str
    size_bytes: Annotated[int, Gt(0)]
    source: WheelSource | NpmSource
    input: ModelInput
    decoding: PersonDecoding | LandmarkDecoding

    @property
    def file_name(self) -> str:
        """Name of the model file, the same inside the archive and in the cache."""
        return PurePosixPath(self.source.member).name

    @property
    def joint_centres_file(self) -> Path | None:
        """Offsets from landmarks to joint centres, where known."""
        return _beside(self.folder, self.decoding.joint_centres) if isinstance(self.decoding, LandmarkDecoding) else None


@settings
class EnsembleCard:
    """Several landmark networks that look at the same crops.

    Attributes:
        name, folder, summary: as in `ModelCard`.
        members: their cards, by name or TOML file next to this one.
        mirrored: each also looks at the crop's mirror image.
        joint_centres: file next to the card; None when not known.
    """

    name: str
    folder: Path
    kind: Literal["landmark_ensemble"]
    summary: str
    members: Annotated[tuple[str, ...], MinLen(1)]
    mirrored: bool
    joint_centres: str | None = None

    @property
    def joint_centres_file(self) -> Path | None:
        """Offsets from the averaged landmarks to joint centres, where known."""
        return _beside(self.folder, self.joint_centres)

    def member_cards(self) -> list[ModelCard]:
        """The cards of the members; raises as `read_card`."""
        files = {name: self.folder / f"{name}.toml" for name in self.members}
        return [read_card(file if file.is_file() else name) for name, file in files.items()]


def list_cards() -> list[ModelCard]:
    """The cards of networks that come with the package, by name."""
    cards = [_read(path) for path in _card_files()]
    return [card for card in cards if isinstance(card, ModelCard)]


def read_card(name: str | Path) -> ModelCard:
    """The card of this network, or in this TOML file; raises ModelError or ConfigError when there is none or it is wrong."""
    card = read_any_card(name)
    if isinstance(card, EnsembleCard):
        raise ModelError(f"model card {card.name}: expected one network, got an ensemble of {', '.join(card.members)}")
    return card


def read_any_card(name: str | Path) -> ModelCard | EnsembleCard:
    """As `read_card`, ensembles included."""
    path = Path(name)
    if path.suffix != ".toml":
        path = CARDS_FOLDER / f"{name}.toml"
        if not path.is_file():
            raise ModelError(f"no model card {str(name)!r}; there are: {choices(file.stem for file in _card_files())}")
    return _read(path)


def _beside(folder: Path, name: str | None) -> Path | None:
    return folder / name if name else None


def _card_files() -> list[Path]:
    return sorted(path for path in CARDS_FOLDER.glob("*.toml") if not path.name.endswith(_BESIDE_SUFFIXES))


def _read(path: Path) -> ModelCard | EnsembleCard:
    content: dict[str, Any] = {"name": path.stem, "folder": path.parent, **read_mapping(path)}
    if content.get("kind") == "landmark_ensemble":
        return settings_from_mapping(content, EnsembleCard, where=str(path))
    return settings_from_mapping(content, ModelCard, where=str(path))
