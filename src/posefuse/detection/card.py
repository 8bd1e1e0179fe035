"""Model cards: what goes into a network, what comes out, and which file it must be.

Cards of BlazePose name an archive that is fetched (`files`). Networks in ONNX files are the user's: no weights come with this
package; a card names the file, its hash, its licence and where its maker publishes it.
"""

from __future__ import annotations

import hashlib
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le, MinLen

from posefuse.core import SKELETONS, ConfigError, ModelError, Skeleton
from posefuse.core.errors import choices
from posefuse.foundation.settings import read_mapping, settings, settings_from_mapping

from .archives import NpmSource, WheelSource

CARDS_FOLDER = Path(__file__).parent / "cards"
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


Layout = Literal["simcc", "heatmap", "rtmo", "yolo_pose", "yolox", "detections"]
TOP_DOWN: tuple[Layout, ...] = ("simcc", "heatmap")
ONE_STAGE: tuple[Layout, ...] = ("rtmo", "yolo_pose")
PERSONS: tuple[Layout, ...] = ("yolox", "detections")
LAYOUTS = (*TOP_DOWN, *ONE_STAGE, *PERSONS)
Positive = Annotated[float, Gt(0)]
Share = Annotated[float, Ge(0), Le(1)]


@settings
class NetworkInput:
    """What the network takes, as its maker defines it: (colour - mean) / std of 0..255, one image as (1, 3, height, width).

    Attributes:
        size_wh: px of its input.
        channels: order of the colours.
        mean, std: per channel, in that order, in units of 0..255.
        padding: top-down: the person's box is made this much larger before it is cut out.
        letterbox: whole images: where the scaled image lies on the canvas. fill: grey of the rest, 0..255.
    """

    size_wh: tuple[Annotated[int, Gt(0)], Annotated[int, Gt(0)]]
    channels: Literal["rgb", "bgr"] = "rgb"
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    padding: Annotated[float, Ge(1)] = 1.25
    letterbox: Literal["corner", "centre"] = "corner"
    fill: Annotated[int, Ge(0), Le(255)] = 114


@settings
class Decoding:
    """How the outputs are read. What a layout does not use stays at its default.

    Attributes:
        outputs: names of the outputs in the layout's order; left out: the file's own order.
        split_ratio: simcc: bins per px of the input.
        subpixel: simcc, heatmap: ``none`` (the highest bin), ``quarter`` (a quarter cell towards the higher neighbour),
            ``taylor`` (peak of a parabola through the logarithm) or ``dark`` (the same after a blur).
        blur_cells: dark: width of the blur's kernel, odd.
        udp: heatmap: the maker's unbiased data processing: the image spans size - 1 px, and so does a heatmap.
        end_to_end: yolo_pose: rows of people (box corners, score, class, keypoints) instead of columns of raw candidates.
        raw_boxes: yolox: offsets from grid cells, not yet px.
        person_class: yolox, detections: which class is a person.
        least_score: boxes below it are no person.
        most_overlap: of two boxes that overlap by more than this (intersection over union), the better one is kept.
    """

    outputs: tuple[str, ...] = ()
    split_ratio: Positive = 2.0
    subpixel: Literal["none", "quarter", "taylor", "dark"] = "taylor"
    blur_cells: Annotated[int, Ge(1)] = 11
    udp: bool = False
    end_to_end: bool = False
    raw_boxes: bool = True
    person_class: Annotated[int, Ge(0)] = 0
    least_score: Share = 0.5
    most_overlap: Share = 0.45


@settings
class NetworkCard:
    """A network of a known layout in a local file.

    Attributes:
        name: the card's file name without suffix. folder: where the card lies; the files it names are relative to it.
        kind: layout of the outputs: one of `LAYOUTS`.
        file, sha256: the ONNX file and its hash.
        licence, published: under which terms, and where the maker publishes it; for people.
        summary: what it is for, in a few words.
        keypoints: name of the keypoint set in `core.SKELETONS`; "" for a person detector.
        persons: top-down: card that finds people, a TOML file or ``blazepose_persons``, which is fetched once.
        input, decoding: see there.
        least_keypoint_score: a person whose keypoints score less than this on average is not there.
        noise: file with the fitted noise model (`posefuse fit-noise`); None: a rule of thumb.
        joint_centres: file with offsets from keypoints to joint centres; None: those of the keypoint set.
    """

    name: str
    folder: Path
    kind: Layout
    file: Annotated[str, MinLen(1)]
    sha256: Annotated[str, MinLen(64)]
    licence: str
    published: str = ""
    summary: str = ""
    keypoints: str = ""
    persons: str = "blazepose_persons"
    input: NetworkInput
    decoding: Decoding = Decoding()
    least_keypoint_score: Share = 0.3
    noise: str | None = None
    joint_centres: str | None = None

    @property
    def path(self) -> Path:
        """The network's file."""
        return self.folder / self.file

    @property
    def skeleton(self) -> Skeleton:
        """The keypoint set; only for layouts with keypoints."""
        return SKELETONS[self.keypoints]

    @property
    def noise_file(self) -> Path | None:
        """The fitted noise model, where there is one."""
        return self.folder / self.noise if self.noise else None

    @property
    def joint_centres_file(self) -> Path | None:
        """Offsets from the network's keypoints to joint centres, where they were fitted."""
        return self.folder / self.joint_centres if self.joint_centres else None

    @property
    def persons_card(self) -> Path | None:
        """Card of the person detector; None for ``blazepose_persons``."""
        return None if self.persons == "blazepose_persons" else self.folder / self.persons


def read_network_card(path: Path) -> NetworkCard:
    """Read a card; raises ConfigError naming the file and key for anything that is not right in it."""
    content = {"name": path.stem, "folder": path.parent, **read_mapping(path)}
    card = settings_from_mapping(content, NetworkCard, where=str(path))
    needed = card.kind not in PERSONS
    if needed and card.keypoints not in SKELETONS:
        raise ConfigError(f"{path}: keypoints: no keypoint set {card.keypoints!r}; there are: {choices(SKELETONS)}")
    if card.kind == "simcc" and card.decoding.subpixel == "quarter":
        raise ConfigError(f"{path}: decoding.subpixel: quarter is for heatmaps; simcc takes none, taylor or dark")
    if card.decoding.blur_cells % 2 == 0:
        raise ConfigError(f"{path}: decoding.blur_cells: expected an odd number, got {card.decoding.blur_cells}")
    return card


def checked_file(card: NetworkCard) -> Path:
    """The card's file, with the content that the card states.

    Raises:
        ModelError: it is missing, or its hash is another; names both hashes and where the file is published.
    """
    published = f" (published at {card.published})" if card.published else ""
    if not card.path.is_file():
        raise ModelError(f"model card {card.name}: no file {card.path}; put the network there{published}")
    got = hashlib.sha256(card.path.read_bytes()).hexdigest()
    if got != card.sha256.lower():
        raise ModelError(f"model card {card.name}: {card.path}: expected sha256 {card.sha256}, got {got}{published}")
    return card.path
