"""Model cards: what goes into a network, what comes out, which file it must be, and where that is published.

No weights come with this package. A card names the network's file next to it, or the source from which it is fetched (`files`).
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, TypeVar

from annotated_types import Ge, Gt, Le

from posefuse.core import SKELETONS, ConfigError, ModelError, Skeleton
from posefuse.core.errors import choices
from posefuse.foundation.settings import read_mapping, settings, settings_from_mapping

from .download import Source, UrlSource

CARDS_FOLDER = Path(__file__).parent / "cards"
_BESIDE_SUFFIXES = (".noise.toml", ".joint_centres.toml")

Layout = Literal["simcc", "heatmap", "rtmo", "yolo_pose", "detections"]
TOP_DOWN: tuple[Layout, ...] = ("simcc", "heatmap")
ONE_STAGE: tuple[Layout, ...] = ("rtmo", "yolo_pose")
PERSONS: tuple[Layout, ...] = ("detections",)
BLAZEPOSE_PERSONS = "blazepose_persons"
LAYOUTS = (*TOP_DOWN, *ONE_STAGE, *PERSONS)
Positive = Annotated[float, Gt(0)]
Share = Annotated[float, Ge(0), Le(1)]
# what no network of these kinds exceeds: nothing larger is unpacked or downloaded
LARGEST_BYTES = 2_000_000_000


@settings
class NetworkInput:
    """What the network takes, as its maker defines it: (colour - mean) / std of 0..255.

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
        subpixel: simcc, heatmap: ``taylor`` (peak of a parabola through the logarithm) or ``dark`` (the same after a blur).
        blur_cells: dark: width of the blur's kernel, odd.
        udp: heatmap: the maker's unbiased data processing: the image spans size - 1 px, and so does a heatmap.
        end_to_end: yolo_pose: rows of people (box corners, score, class, keypoints) instead of columns of raw candidates.
        person_class: detections: which class is a person.
        least_score: boxes below it are no person.
        most_overlap: of two boxes that overlap by more than this (intersection over union), the better one is kept.
    """

    outputs: tuple[str, ...] = ()
    split_ratio: Positive = 2.0
    subpixel: Literal["taylor", "dark"] = "taylor"
    blur_cells: Annotated[int, Ge(1)] = 11
    udp: bool = False
    end_to_end: bool = False
    person_class: Annotated[int, Ge(0)] = 0
    least_score: Share = 0.5
    most_overlap: Share = 0.45


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
    """

    landmarks: str
    presence: str
    heatmaps: str
    channels: Annotated[int, Gt(0)]


@settings
class Terms:
    """What a person who fetches a network has to know and to accept.

    Attributes:
        stated_by: where its makers state the licence of the weights.
        data: what it was trained with, and under which terms that is published.
    """

    stated_by: str
    data: str


@settings
class NetworkCard:
    """One network: what all cards say.

    Attributes:
        name: the card's file name without suffix. folder: where the card lies; the files it names are relative to it.
        kind: decides which of the classes below it is, and how outputs are read.
        summary: what it is for, in a few words.
        joint_centres: file with offsets from keypoints to joint centres; None where they were not fitted.
        file: the network next to the card; "" where it is fetched from `source`.
        source: where it is published; None for a local file.
        size_bytes: of the network's file; an archive is never unpacked beyond it.
        sha256: of the network's file, as it is kept; "" where no source states it.
        licence, published: under which terms, and where the maker publishes it; for people.
        terms: what is to be read and accepted before it is fetched; None: nothing beyond the licence.
        keypoints: name of the keypoint set in `core.SKELETONS`; "" for a person detector.
        noise: file with the fitted noise model (`posefuse fit-noise`); None: a rule of thumb.
        input: see there.
    """

    name: str
    folder: Path
    kind: str
    summary: str = ""
    joint_centres: str | None = None
    file: str = ""
    source: Source | None = None
    size_bytes: Annotated[int, Gt(0)] = LARGEST_BYTES
    sha256: str = ""
    licence: str
    terms: Terms | None = None
    published: str = ""
    keypoints: str = ""
    noise: str | None = None
    input: NetworkInput

    @property
    def file_name(self) -> str:
        """Name of the network's file: next to the card, or in the cache."""
        if self.source is None:
            return self.file
        if isinstance(self.source, UrlSource):
            # what is in archives is called alike; cards of the same archive share the file
            return f"{PurePosixPath(self.source.file_name).stem if self.source.member else self.name}.onnx"
        return PurePosixPath(self.source.member).name

    @property
    def skeleton(self) -> Skeleton:
        """The keypoint set; only for networks that give keypoints."""
        return SKELETONS[self.keypoints]

    @property
    def noise_file(self) -> Path | None:
        """The fitted noise model, where there is one."""
        return self.folder / self.noise if self.noise else None

    @property
    def joint_centres_file(self) -> Path | None:
        """Offsets from the network's keypoints to joint centres, where they were fitted."""
        return self.folder / self.joint_centres if self.joint_centres else None


@settings
class PersonCard(NetworkCard):
    """The network that finds people for BlazePose: a .tflite file."""

    kind: Literal["person_ssd"]
    decoding: PersonDecoding


@settings
class LandmarkCard(NetworkCard):
    """A network of BlazePose's layout: a .tflite file.

    Attributes:
        decoding: see there.
        mirrored: it also looks at the mirror image of each crop, and both looks are averaged.
    """

    kind: Literal["heatmap_landmarks"]
    decoding: LandmarkDecoding
    mirrored: bool = False


@settings
class OnnxCard(NetworkCard):
    """A network in an ONNX file, of one of `LAYOUTS`.

    Attributes:
        persons: top-down: card that finds people, a TOML file or ``blazepose_persons``.
        decoding: see there.
        least_keypoint_score: a person whose keypoints score less than this on average is not there.
    """

    kind: Layout
    persons: str = BLAZEPOSE_PERSONS
    decoding: Decoding = Decoding()
    least_keypoint_score: Share = 0.3


C = TypeVar("C", bound=NetworkCard)
_CLASSES: dict[str, type[NetworkCard]] = {"person_ssd": PersonCard, "heatmap_landmarks": LandmarkCard}


def list_cards() -> list[NetworkCard]:
    """The cards of networks that come with the package, by name."""
    return [read_card(path) for path in _card_files()]


def named_networks() -> dict[str, str]:
    """What each name stands for that ``networks`` takes: those that find keypoints."""
    return {card.name: card.summary for card in list_cards() if card.keypoints}


def read_card(name: str | Path, expected: type[C] = NetworkCard) -> C:  # type: ignore[assignment]
    """The card of this name, or in this TOML file.

    Args:
        name: of a card of the package, or a path that ends with .toml. expected: the class that it must be.

    Raises:
        ModelError: there is none of this name, or it is of another kind. ConfigError: its content is wrong; names file and key.
    """
    path = Path(name)
    if path.suffix != ".toml":
        path = CARDS_FOLDER / f"{name}.toml"
        if not path.is_file():
            raise ModelError(f"no model card {str(name)!r}; there are: {choices([path.stem for path in _card_files()])}")
    content: dict[str, Any] = {"name": path.stem, "folder": path.parent, **read_mapping(path)}
    card = settings_from_mapping(content, _CLASSES.get(str(content.get("kind")), OnnxCard), where=str(path))
    if not isinstance(card, expected):
        raise ModelError(f"model card {card.name}: expected {_WORDS[expected]}, got {card.kind}")
    _check(card, path)
    return card


def persons_card(card: NetworkCard) -> NetworkCard | None:
    """The network that finds people for one that looks at one person at a time; None for the others."""
    if isinstance(card, LandmarkCard):
        return read_card(BLAZEPOSE_PERSONS)
    if not isinstance(card, OnnxCard) or card.kind not in TOP_DOWN:
        return None
    own = card.folder / card.persons
    return read_card(own if own.is_file() else card.persons)


def needed_cards(name: str | Path) -> list[NetworkCard]:
    """The networks that work together under a name: a network, and what finds people for it."""
    card: NetworkCard = read_card(name)
    persons = persons_card(card)
    return [card] if persons is None else [card, persons]


def _card_files() -> list[Path]:
    return sorted(path for path in CARDS_FOLDER.glob("*.toml") if not path.name.endswith(_BESIDE_SUFFIXES))


_WORDS: dict[type[NetworkCard], str] = {
    PersonCard: "kind person_ssd",
    LandmarkCard: "kind heatmap_landmarks",
    OnnxCard: f"a network in an ONNX file ({', '.join(LAYOUTS)})",
}


def _check(card: NetworkCard, path: Path) -> None:
    """Raise ConfigError for values that do not go together."""
    if bool(card.file) == (card.source is not None):
        raise ConfigError(f"{path}: expected either file, a network next to the card, or a [source] to fetch it from")
    if len(card.sha256) != 64 and not (card.sha256 == "" and isinstance(card.source, UrlSource)):
        raise ConfigError(f"{path}: sha256: expected 64 hexadecimal digits, got {card.sha256!r}")
    if card.kind not in (*PERSONS, "person_ssd") and card.keypoints not in SKELETONS:
        raise ConfigError(f"{path}: keypoints: no keypoint set {card.keypoints!r}; there are: {choices(SKELETONS)}")
    if isinstance(card, OnnxCard) and card.decoding.blur_cells % 2 == 0:
        raise ConfigError(f"{path}: decoding.blur_cells: expected an odd number, got {card.decoding.blur_cells}")
