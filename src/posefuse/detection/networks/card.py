"""Model cards of networks in ONNX files that the user brings: what goes in, what comes out, and which file it must be.

No weights come with this package. A card names the file, its hash, its licence and where its maker publishes it.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, MinLen

from posefuse.core import SKELETONS, ConfigError, ModelError, Skeleton
from posefuse.core.errors import choices
from posefuse.foundation.settings import read_mapping, settings, settings_from_mapping

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
