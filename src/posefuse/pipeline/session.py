"""A session folder: which rig file, and which video, image folder or 2D pose folder belongs to which camera."""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posefuse.core import CalibrationError, Camera, InputError, Rig, Source
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.formats.pose2d import POSE2D_SUFFIXES, PREDICTIONS_FOLDER
from posefuse.formats.rig import fit_camera_to_video, read_placed_rig, rig_warnings
from posefuse.sources import IMAGE_SUFFIXES, VIDEO_SUFFIXES

from .config import CameraInput, TrackConfig
from .reading import is_result

RIG_PATTERNS = (
    "rig.toml",
    "camera_array.toml",
    "[Cc]alib*.toml",
    "*_camera_calibration.toml",
    "*.qca.txt",
)
RIG_FOLDERS = (".", "calibration", "Calibration")
KINDS = ("videos", "images", "pose2d")
_FOLDERS = {
    "videos": (".", "videos", "Videos", "synchronized_videos"),
    "images": ("images", "frames", "videos"),
    "pose2d": (f"pose2d/{PREDICTIONS_FOLDER}", "pose2d", "openpose_json", "pose-sync", "pose", "pose-2d"),
}
_SUFFIXES = {"videos": VIDEO_SUFFIXES, "images": IMAGE_SUFFIXES, "pose2d": POSE2D_SUFFIXES}
LEAST_CAMERAS = 2
DEPTH_FOLDER = "depth"
_FRAMES_TO_FIND_BARS = 15


@dataclass(frozen=True)
class Input:
    """One camera's data.

    Attributes:
        camera: name in the rig. kind: one of `KINDS`. path: file or folder. settings: those of the config for it.
        depth: folder of its depth images; None where there are none.
    """

    camera: str
    kind: str
    path: Path
    settings: CameraInput
    depth: Path | None = None


def least_cameras(inputs: Sequence[Input]) -> int:
    """Cameras that a session needs: one with depth is enough."""
    return 1 if any(entry.depth is not None for entry in inputs) else LEAST_CAMERAS


@dataclass(frozen=True)
class Session:
    """A folder understood: the calibrated cameras that have data, in the order of the rig file.

    Attributes:
        folder: the session. rig_path: the calibration file. rig: only cameras with data.
        inputs: one per camera of the rig. notes: what was left aside, in words.
    """

    folder: Path
    rig_path: Path
    rig: Rig
    inputs: tuple[Input, ...]
    notes: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """One of `KINDS`; raises InputError where cameras have several kinds of data."""
        kinds = sorted({entry.kind for entry in self.inputs})
        if len(kinds) > 1:
            raise InputError(f"{self.folder}: expected one kind of data for all cameras, got {choices(kinds)}")
        return kinds[0]

    @property
    def files(self) -> tuple[Path, ...]:
        """The files and folders that it is made of, its own first."""
        return (self.folder, self.rig_path, *(entry.path for entry in self.inputs))


def find_session(folder: Path, config: TrackConfig) -> Session:
    """Understand a session folder by convention and by what the config names.

    Raises:
        InputError: nothing usable there, or data that cannot be distinguished; the message lists what is there.
        CalibrationError: no rig file, or fewer than two cameras with data.
    """
    if folder.is_file():
        raise InputError(f"{folder}: is a file; expected a session folder, with a calibration and videos in it")
    if not folder.is_dir():
        raise InputError(f"{folder}: no such session folder")
    if is_result(folder):
        raise InputError(
            f"{folder}: holds a result, not a session; pf.read(RESULT).solve() solves it again, as does "
            "`posefuse solve RESULT --out OTHER`"
        )
    rig_path = _rig_path(folder, config)
    rig = read_placed_rig(rig_path)
    unknown = sorted(set(config.cameras) - set(rig.names))
    if unknown:
        raise CalibrationError(f"config: no camera {choices(unknown)} in {rig_path}; there are: {choices(rig.names)}")
    kind, found = _data(folder, config)
    named = _named_inputs(folder, config)
    matched = {name: (kind, path) for name, path in _match(found, rig, named, folder, kind).items()}
    settings = {name: config.cameras.get(name, CameraInput()) for name in rig.names}
    data = matched | named
    used = [name for name in rig.names if name in data and not settings[name].skip]
    inputs = tuple(Input(name, *data[name], settings[name], _depth_folder(folder, name, settings[name])) for name in used)
    if len(inputs) < least_cameras(inputs):
        raise CalibrationError(
            f"{folder}: expected data of at least {LEAST_CAMERAS} calibrated cameras, got {len(inputs)}; "
            f"the rig has: {choices(rig.names)}; found {kind}: {choices(path.name for path in found)}"
        )
    notes = tuple(f"camera {name}: calibrated, but no {kind} found; left aside" for name in rig.names if name not in used)
    return Session(folder, rig_path, rig.only(entry.camera for entry in inputs), inputs, (*notes, *rig_warnings(rig_path, rig)))


def _depth_folder(folder: Path, camera: str, settings: CameraInput) -> Path | None:
    """Where a camera's depth images are; raises InputError for a folder that is named and does not exist."""
    path = folder / (settings.depth or f"{DEPTH_FOLDER}/{camera}")
    if settings.depth and not path.is_dir():
        raise InputError(f"{path}: camera {camera}: no such folder of depth images")
    return path if path.is_dir() else None


def fitted_camera(camera: Camera, entry: Input, source: Source) -> Camera:
    """The camera for a source's images: as calibrated, or with the crop or scale that is stated or found from them."""
    image = None if source.size_wh == camera.size_wh else _brightest(source)
    try:
        return fit_camera_to_video(camera, source.size_wh, crop=entry.settings.crop, scale=entry.settings.scale, image=image)
    except CalibrationError as error:
        raise CalibrationError(f"{entry.path}: {error}") from None


def _brightest(source: Source) -> Array:
    """The brightest value of each pixel over the first frames: what stays black is no scene."""
    first = (frame.image for frame in itertools.islice(source.frames(), _FRAMES_TO_FIND_BARS))
    return np.asarray(functools.reduce(np.maximum, first))


def _rig_path(folder: Path, config: TrackConfig) -> Path:
    if config.rig:
        path = folder / config.rig
        if not path.exists():
            raise CalibrationError(f"{path}: no such calibration file")
        return path
    found = rig_files(folder)
    if found:
        return found[0]
    places = ", ".join(str(folder / place) for place in RIG_FOLDERS[:2])
    raise CalibrationError(f"no calibration file in {places}; looked for {', '.join(RIG_PATTERNS)}; name one with `rig=FILE`")


def rig_files(folder: Path) -> list[Path]:
    """Calibration files in the usual places of a folder, the one to use first."""
    return [path for place in RIG_FOLDERS for pattern in RIG_PATTERNS for path in sorted((folder / place).glob(pattern))]


def data_entries(folder: Path, kind: str) -> list[Path]:
    """Files or folders of a kind of data in a session's usual places; empty where there are none."""
    return next((found for place in _FOLDERS[kind] if (found := _entries(folder / place, kind))), [])


def looks_like_session(folder: Path) -> bool:
    """Whether a calibration or a folder for videos lies in a folder: the data itself may not be readable."""
    return any(any(folder.glob(pattern)) for pattern in (*RIG_PATTERNS, *_FOLDERS["videos"][1:]))


def _data(folder: Path, config: TrackConfig) -> tuple[str, list[Path]]:
    kinds = KINDS if config.input == "auto" else (config.input,)
    for kind in kinds:
        found = data_entries(folder, kind)
        if found:
            return kind, found
    if config.cameras:
        return kinds[0], []
    looked = choices(dict.fromkeys(f"{place}/" for kind in kinds for place in _FOLDERS[kind]))
    known = " or ".join(f"{kind} ({' '.join(_SUFFIXES[kind])})" for kind in kinds)
    raise InputError(f"{folder}: no {known} found; looked in {looked}")


def _entries(place: Path, kind: str) -> list[Path]:
    if not place.is_dir():
        return []
    files = [path for path in place.iterdir() if path.suffix.lower() in _SUFFIXES[kind]]
    if kind == "videos":
        return sorted(files)
    suffixes = IMAGE_SUFFIXES if kind == "images" else (".json",)
    below = ("*", f"{PREDICTIONS_FOLDER}/*") if kind == "pose2d" else ("*",)
    folders = [
        path
        for path in place.iterdir()
        if path.is_dir() and any(file.suffix.lower() in suffixes for pattern in below for file in path.glob(pattern))
    ]
    return sorted(folders + files if kind == "pose2d" else folders)


def _named_inputs(folder: Path, config: TrackConfig) -> dict[str, tuple[str, Path]]:
    named = {}
    for camera, entry in config.cameras.items():
        stated = [(kind, value) for kind, value in zip(KINDS, (entry.video, entry.images, entry.pose2d), strict=True) if value]
        if len(stated) > 1:
            raise InputError(f"config: camera {camera}: expected one of video, images, pose2d, got {len(stated)}")
        if stated:
            path = folder / stated[0][1]
            if not path.exists():
                raise InputError(f"{path}: camera {camera}: no such file or folder")
            named[camera] = (stated[0][0], path)
    return named


def _match(found: list[Path], rig: Rig, named: Mapping[str, tuple[str, Path]], folder: Path, kind: str) -> dict[str, Path]:
    """Data by camera name: spelling aside (cam_01 = Cam1 = cam01_json), every entry must find its camera."""
    taken = {path for _, path in named.values()}
    open_names = [name for name in rig.names if name not in named]
    left = [path for path in found if path not in taken]
    matched: dict[str, Path] = {}
    for path in left:
        name = _camera_of(path.stem, open_names)
        if name is None or name in matched:
            problem = "matches no camera of the rig, or several" if name is None else f"is a second one for camera {name}"
            key = "video" if kind == "videos" else kind
            raise InputError(
                f"{path}: {problem}; cameras: {choices(rig.names)}; rename it, or name the data per camera in "
                f'{folder / "posefuse.toml"}: [cameras.{rig.names[0]}] {key} = "..." (or skip = true)'
            )
        matched[name] = path
    return matched


def _camera_of(stem: str, names: Collection[str]) -> str | None:
    """The one camera whose name is this, or is part of it, or of which it is part ("1", "trial2_cam1"); None if unclear."""
    words = _words(stem)
    exact = [name for name in names if _words(name) == words]
    close = exact or [name for name in names if _inside(_words(name), words) or _inside(words, _words(name))]
    return close[0] if len(close) == 1 else None


def _words(name: str) -> list[str]:
    """``cam_01`` and ``Cam1`` are both ['cam', '1']."""
    words = re.findall(r"[a-z]+|\d+", name.lower())
    return [word.lstrip("0") or "0" if word.isdigit() else word for word in words]


def _inside(part: list[str], whole: list[str]) -> bool:
    return bool(part) and any(whole[i : i + len(part)] == part for i in range(len(whole) - len(part) + 1))


# The bundled clip: four simulated cameras, a walking person.

_PACKAGE = Path(__file__).resolve().parents[1]
# a wheel has the first seconds of the videos, and the rig; a checkout has all of it, with the exact truth
_PLACES = (_PACKAGE.parents[1] / "examples" / "demo", _PACKAGE / "demo_clip")


def clip_folder() -> Path:
    """The session folder of the clip; raises InputError when this installation has none."""
    for place in _PLACES:
        if (place / "rig.toml").is_file():
            return place
    raise InputError(f"the bundled clip is not in this installation (looked in {_PLACES[-1]}); reinstall posefuse")
