"""Recordings of a target by several cameras: files that are opened, and the corners seen in them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2

from posefuse.calibration.report import CalibrationReport, Check, RefusedCalibration
from posefuse.core import InputError, Progress, Source, silent
from posefuse.core.errors import choices
from posefuse.formats.kept_video import VIDEOS_FOLDER
from posefuse.sources import IMAGE_SUFFIXES, VIDEO_SUFFIXES, ImagesConfig, RecordedSource, VideoConfig

from .corners import CornerObservations, joined
from .detection import detect_corners, why_nothing
from .kinds import Target

Inputs = Mapping[str, str | Path] | Sequence[str | Path] | str | Path
"""Recordings by camera name, or paths, whose file names without suffix are the cameras' names, or texts ``NAME=PATH``; a folder
of videos, or a session that has one, stands for its videos."""
STAGE = "looking for the target"

# images without times are paired by their place in the folder, for which any rate does
_NUMBERED_HZ = 30.0


def paths_by_camera(inputs: Inputs) -> dict[str, Path]:
    """The recording of each camera, by name: no result depends on the order in which they are given.

    Raises:
        InputError: two recordings of one name.
    """
    if isinstance(inputs, Mapping):
        return {name: Path(path) for name, path in sorted(inputs.items())}
    paths = [inputs] if isinstance(inputs, str | Path) else inputs
    pairs = [pair for path in paths for pair in _named(path)]
    names = [name for name, _ in pairs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"two recordings are named {choices(twice)}; give each camera its own name, as NAME=PATH")
    return dict(sorted(pairs))


def _named(given: str | Path) -> list[tuple[str, Path]]:
    """A recording under the name that a text states, or its file's; of a folder of videos or a session, all in it."""
    path, (name, equals, place) = Path(given), str(given).partition("=")
    if equals and isinstance(given, str) and not path.exists():
        return [(name, Path(place))]
    folder = path / VIDEOS_FOLDER if (path / VIDEOS_FOLDER).is_dir() else path
    if folder == path and not (path.is_dir() and any(_is_video(one) for one in path.iterdir())):
        return [(path.stem, path)]
    found = [one for one in sorted(folder.iterdir()) if is_recording(one)]
    if not found:
        raise InputError(f"{folder}: expected videos ({choices(VIDEO_SUFFIXES)}) or folders of images, got none")
    # a camera twice, as a video and as images, is refused by its name
    return [(one.name if one.is_dir() else one.stem, one) for one in found]


def is_recording(path: Path) -> bool:
    """Whether this is a video or a folder of images."""
    if path.is_dir():
        return any(file.suffix.lower() in IMAGE_SUFFIXES for file in path.iterdir())
    return _is_video(path)


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEO_SUFFIXES


def open_sources(inputs: Inputs) -> list[RecordedSource]:
    """Videos and folders of images, open; raises InputError for a path that does not exist or is neither."""
    sources: list[RecordedSource] = []
    for name, path in paths_by_camera(inputs).items():
        if not path.exists():
            raise InputError(f"{path}: no such video or folder of images")
        if path.is_dir():
            sources.append(ImagesConfig(path, name, _NUMBERED_HZ).build())
        elif _is_video(path):
            sources.append(VideoConfig(path, name).build())
        else:
            raise InputError(f"{path}: expected a folder of images or a video ({choices(VIDEO_SUFFIXES)})")
    return sources


def observe_sources(sources: Sequence[Source], target: Target, every: int = 1, progress: Progress = silent) -> CornerObservations:
    """Corners of the target in every `every`-th frame of each source."""
    seen = []
    progress(STAGE, 0, len(sources))
    for done, source in enumerate(sources, start=1):
        seen.append(detect_corners(source, target, every))
        progress(STAGE, done, len(sources))
    return joined(seen)


def require_target_seen(observations: CornerObservations, sources: Sequence[Source], target: Target) -> None:
    """Raise RefusedCalibration with the likely reason for a camera in which the target was not found."""
    for source in sources:
        seen_or_why_not(observations.of_camera(source.camera), source, target)


def seen_or_why_not(observations: CornerObservations, source: Source, target: Target) -> CornerObservations:
    """The observations of one camera; raises RefusedCalibration with the likely reason where there are none."""
    if len(observations):
        return observations
    frames = [cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY) for frame in itertools.islice(source.frames(), 12)]
    reason = why_nothing(frames, target, dict(observations.edge_width_px).get(source.camera, 0.0))
    detail = f"the target is in none of {observations.frame_count[0]} frames: {reason}"
    raise RefusedCalibration(CalibrationReport(f"camera {source.camera}", (Check("target seen", False, detail),)))
