"""Checks that every plug-in passes, ours and others'. Call them from the plug-in's own tests.

Each raises `ContractError` naming the rule that is broken; passing returns None.
"""

from __future__ import annotations

import dataclasses
import itertools
import pickle
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from posefuse.core import (
    Detector,
    Frame,
    JointCentres,
    LiveMessage,
    LiveOutput,
    LiveOutputConfig,
    LiveStart,
    PosefuseError,
    Recording,
    Region,
    Sink,
    Source,
)
from posefuse.detection.build import broken_rule

_ENOUGH_FRAMES = 20


class ContractError(PosefuseError):
    """A plug-in that does not do what `core.protocols` asks."""


def check_source(source: Source, most_frames: int = _ENOUGH_FRAMES) -> None:
    """A source: named frames of one size, seq and times strictly increasing, starts again from the beginning, closes twice."""
    _require(isinstance(source, Source), f"{type(source).__name__} lacks a member of core.Source")
    first = list(itertools.islice(source.frames(), most_frames))
    _require(len(first) > 0, "frames() gives at least one frame")
    for frame in first:
        _require(frame.camera == source.camera, f"a frame's camera is the source's ({frame.camera!r}, {source.camera!r})")
        _require(frame.size_wh == source.size_wh, f"every frame has the stated size ({frame.size_wh}, {source.size_wh})")
    for earlier, later in itertools.pairwise(first):
        _require(later.seq > earlier.seq, f"seq increases ({earlier.seq}, {later.seq})")
        _require(later.t_ns > earlier.t_ns, f"t_ns increases ({earlier.t_ns}, {later.t_ns})")
    again = next(iter(source.frames()), None)
    _require(again is not None, "frames() may be called again")
    source.close()
    source.close()


def check_detector(detector: Detector, frames: Sequence[Frame]) -> None:
    """A detector: one answer per frame in order, its own skeleton, missing is NaN with score 0, sigma where a score is.

    Where it knows joint centres, it hands over a `core.JointCentres`.

    `frames` are a few images, with or without people, of any cameras.
    """
    _require(isinstance(detector, Detector), f"{type(detector).__name__} lacks a member of core.Detector")
    centres = detector.joint_centres
    _require(centres is None or isinstance(centres, JointCentres), "joint_centres is a core.JointCentres, or None")
    _require(detector.detect([], []) == [], "no frames give no answers")
    half = min(frames[0].size_wh) / 2
    region = Region(centre_img=np.array(frames[0].size_wh) / 2, side_px=2 * half)
    asked: tuple[list[Region] | None, ...] = (None, [region], [])
    for regions in ([one] * len(frames) for one in asked):
        broken = broken_rule(detector, frames, regions, detector.detect(frames, regions))
        _require(not broken, broken)


def check_output(sink: Sink, recording: Recording, folder: Path) -> None:
    """A sink: writes at least one new, non-empty file into the folder and names exactly what it wrote."""
    _require(isinstance(sink, Sink), f"{type(sink).__name__} lacks a member of core.Sink")
    _require(sink.name != "", "a sink has a name")
    before = set(folder.rglob("*"))
    written = sink.write(recording, folder)
    _require(len(written) > 0, "write() returns the files it made")
    for path in written:
        _require(path.is_file() and path.stat().st_size > 0, f"{path.name} exists and is not empty")
        _require(path.is_relative_to(folder), f"{path} lies in the folder given")
    unnamed = {path for path in set(folder.rglob("*")) - before if path.is_file()} - set(written)
    _require(not unnamed, f"write() names all files it made (not named: {sorted(path.name for path in unnamed)})")


def check_live_output(config: LiveOutputConfig, session: Sequence[LiveMessage], folder: Path) -> None:
    """A live output: its config can be sent to a process, it takes a whole session, closes twice, and continues in new files.

    `session` are a few messages of the kinds that it takes, after a `LiveStart`; `folder` is where `config` makes it write its
    files, if any: a first part is never changed by a later one.
    """
    _require(isinstance(config, LiveOutputConfig), f"{type(config).__name__} lacks a member of core.LiveOutputConfig")
    _require(_is_frozen(config), "a config is a frozen dataclass")
    _require(_sent(config) == config, "a config comes out of pickle as it went in")
    known = LiveMessage.__args__
    _require(len(config.takes) > 0 and set(config.takes) <= {*known} - {LiveStart}, "takes names classes of core.live_messages")
    start, *messages = session
    if not isinstance(start, LiveStart):
        raise ContractError(f"check_live_output: expected a session that begins with a LiveStart, got {type(start).__name__}")
    taken = [message for message in messages if isinstance(message, config.takes)]
    _take_part(config, [start, *taken])
    before = _contents(folder)
    _take_part(config, [replace(start, part=2), *taken])
    changed = sorted(path.name for path, content in before.items() if _contents(folder).get(path) != content)
    _require(not changed, f"a later part leaves the files of the first as they are (not: {changed})")


def _sent(config: LiveOutputConfig) -> LiveOutputConfig | None:
    try:
        return pickle.loads(pickle.dumps(config))  # type: ignore[no-any-return]
    except (pickle.PicklingError, AttributeError, TypeError):
        return None


def _take_part(config: LiveOutputConfig, session: Sequence[LiveMessage]) -> None:
    config.build().close()
    output = config.build()
    _require(isinstance(output, LiveOutput), f"{type(output).__name__} lacks a member of core.LiveOutput")
    _require(output.name != "" and isinstance(output.where, str), "an output has a name, and where is text")
    for message in session:
        with _bears(f"take() bears every {type(message).__name__} of a session"):
            output.take(message)
    with _bears("close() may be called twice"):
        output.close()
        output.close()


@contextmanager
def _bears(rule: str) -> Iterator[None]:
    try:
        yield
    except PosefuseError:
        raise
    except Exception as error:
        raise ContractError(f"contract broken: {rule} ({type(error).__name__}: {error})") from error


def _contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def _is_frozen(config: object) -> bool:
    return dataclasses.is_dataclass(config) and bool(getattr(config, "__dataclass_params__").frozen)  # noqa: B009


def _require(holds: bool, rule: str) -> None:
    if not holds:
        raise ContractError(f"contract broken: {rule}")
