"""A live session's MCAP file as a `Recording`: what was detected, what was published, and how the session was made."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.association import AssociateSettings
from posefuse.association.settings import MOST_NAME, MOST_NAMES
from posefuse.core import (
    Camera,
    ConfigError,
    Detections2D,
    InputError,
    JointCentres,
    MessageError,
    Observations,
    Pose3D,
    PosefuseError,
    PoseSequence,
    Recording,
    Rig,
    SourceError,
)
from posefuse.core.arrays import Array
from posefuse.core.errors import choices, warn_caller
from posefuse.core.observations import NOT_KEPT, observations_from_frames
from posefuse.core.recording import person_name
from posefuse.detection.build import DetectorChoice
from posefuse.formats.recording import rig_from_values
from posefuse.foundation.output_file import parts_of
from posefuse.foundation.parsing import one_line, plain
from posefuse.foundation.settings import settings_from_mapping
from posefuse.fusion import FuseSettings
from posefuse.pipeline.config import TrackConfig

from . import topics
from .bags import Warn, read_clock, read_mcap, read_notes, read_rig
from .camera_messages import joint_centres_from_message
from .messages import detections_from_message, names_from_message, pose_from_message

# Settings for the second solve of a live session, from those that it was made with.


def track_config_of_live(settings: Mapping[str, Any], where: str) -> TrackConfig:
    """The settings that a recorded run shares with a live one, as the session had them; all others at their defaults.

    Args:
        settings: those of `posefuse live`, as plain values. where: for messages.

    Raises:
        ConfigError: settings of another version.
    """
    associate = settings_from_mapping(settings.get("associate", {}), AssociateSettings, where=f"{where}: associate")
    people = settings.get("track", {}).get("max_people", associate.max_people)
    return TrackConfig(
        detector=settings_from_mapping(settings.get("detector", {}), DetectorChoice, where=f"{where}: detector"),
        associate=replace(associate, max_people=people),
        fuse=settings_from_mapping(settings.get("fuse", {}), FuseSettings, where=f"{where}: fuse"),
        names=tuple(settings.get("names", ())),
        joint_centres=bool(settings.get("joint_centres", True)),
    )


# Which person of a live session's poses a detection shows: messages of detections do not have it.

# a detection farther from a person's projection than this share of the projection's extent shows another person
_MOST_OFF_SHARE = 0.25
# the pose nearest in time counts for a frame if it is this close
_NEAR_NS = 100_000_000


def people_of_detections(observations: Observations, rig: Rig, poses: PoseSequence) -> Array:
    """(R,) the person whose pose, seen by the camera at the frame's time, is nearest to each detection; -1: no person.

    In one frame a person has the nearest detection only.
    """
    frame = observations.detection_frame
    people = np.full(len(observations), NOT_KEPT, np.int64)
    if not len(poses.person_id):
        return people
    for c, camera in enumerate(rig):
        rows = np.flatnonzero(observations.frame_camera[frame] == c)
        if not len(rows):
            continue
        off = _off_share(camera, observations.xy_img[rows], observations.frame_t_ns[frame[rows]], poses)
        nearest = off.argmin(axis=1)
        share = off[np.arange(len(rows)), nearest]
        order = np.lexsort((share, nearest, frame[rows]))
        first = np.ones(len(rows), np.bool_)
        first[1:] = (np.diff(frame[rows][order]) != 0) | (np.diff(nearest[order]) != 0)
        chosen = order[first & (share[order] < _MOST_OFF_SHARE)]
        people[rows[chosen]] = poses.person_id[nearest[chosen]]
    return people


def _off_share(camera: Camera, xy_img: Array, t_ns: Array, poses: PoseSequence) -> Array:
    """(R, N) median distance of a detection's keypoints from each person's projection, per extent of the latter; else inf."""
    after = np.searchsorted(poses.t_ns, t_ns).clip(1, max(len(poses) - 1, 1))
    before, after = after - 1, after.clip(max=len(poses) - 1)
    tick = np.where(t_ns - poses.t_ns[before] <= poses.t_ns[after] - t_ns, before, after)
    shown = camera.project(poses.xyz_world[tick])
    shown[np.abs(poses.t_ns[tick] - t_ns) > _NEAR_NS] = np.nan
    apart = np.linalg.norm(xy_img[:, None] - shown, axis=-1)
    there = np.isfinite(apart).any(axis=-1)
    off = np.full(there.shape, np.inf)
    seen = shown[there]
    extent = (np.nanmax(seen, axis=1) - np.nanmin(seen, axis=1)).max(axis=-1)
    off[there] = np.nanmedian(apart[there], axis=-1) / np.maximum(extent, 1.0)
    return off


# read on both sides of a section
_SECTION_MARGIN_S = 2.0
_TOPICS = {topic.name for topic in (topics.DETECTIONS, topics.POSE, topics.JOINT_CENTRES, topics.NAMES)}


@dataclass
class _Content:
    """What the files hold, in their order; times are those of the messages. `stated_ns`: time 0, if not the first pose."""

    stated_ns: int | None = None
    frames: list[Detections2D] = field(default_factory=list)
    poses: list[Pose3D] = field(default_factory=list)
    tables: dict[str, JointCentres | None] = field(default_factory=dict)
    names: dict[int, str] = field(default_factory=dict)

    @property
    def start_ns(self) -> int:
        """The time of the messages at time 0; with one pose at least."""
        return self.poses[0].t_ns if self.stated_ns is None else self.stated_ns


def read(path: Path, warn: Warn | None = None, *, start_s: float | None = None, end_s: float | None = None) -> Recording:
    """Read a recording of ``posefuse live --record``, its later parts (``NAME.2.mcap``, ...) included, or the output ``mcap``.

    The poses are those that were published, at the output ticks, at joint centres where the session moved them there. The
    observations are all detections that the tracker was given, each at its own exposure time with the clock offset taken
    away that was known then. The person of a detection is found again from the poses, see `people_of_detections`. Times
    count from the first output tick, whose time on the session's clock (ns since 1970) is ``start_ns`` in the provenance;
    the first frames were exposed a little before it. The output ``mcap`` of a result has the provenance and the times of the
    result; its observations are what each camera saw of the people at the time steps.

    Args:
        path: the first part. warn: is given one line for each part that was cut off or is damaged; a `UserWarning`
            where none is given.
        start_s, end_s: a part of the session in seconds from its first output tick; the rest is not decoded.

    Raises:
        SourceError: no such file, no MCAP file, or one that is damaged before its first pose.
        InputError: it holds no pose, or parts of different sessions.
        MessageError: a message that is malformed.
    """
    say = warn or warn_caller
    notes = read_notes(path)
    parts, made = _parts(path, notes), _stated_provenance(path, notes)
    content = _Content(stated_ns=made.get("start_ns"))
    low_s = -math.inf if start_s is None else start_s - _SECTION_MARGIN_S
    high_s = math.inf if end_s is None else end_s + _SECTION_MARGIN_S
    for part in parts:
        try:
            _read_part(part, content, say, lambda at_s: low_s <= at_s <= high_s)
        except SourceError as error:
            if not content.poses:
                raise
            # what was read of it, and what the other parts hold, is still good
            say(f"{error}; what follows in this part is missing")
    if not content.poses:
        raise InputError(f"{path}: holds no pose; expected a recording of `posefuse live --record`")
    start_ns = content.start_ns
    rig = _rig_of(path, notes)
    poses = PoseSequence.from_poses([replace(pose, t_ns=pose.t_ns - start_ns) for pose in content.poses])
    frames = [replace(one, t_ns=one.t_ns - start_ns) for one in content.frames]
    observations = observations_from_frames(poses.skeleton, rig.names, frames)
    observations = observations.with_person_ids(people_of_detections(observations, rig, poses))
    if made:
        return Recording(rig=rig, poses=poses, observations=observations, provenance=made)
    if not notes:
        say(f"{path}: it does not hold how it was made: solved again, it has the usual settings and no joint centres")
    table = next((content.tables[name] for name in rig.names if content.tables.get(name) is not None), None)
    about = _provenance(parts, notes, rig, table, say) | {"start_ns": start_ns}
    if about["config"] is not None:
        about["config"]["names"] = _all_names(about["config"]["names"], content.names, say)
    return Recording(rig=rig, poses=poses, observations=observations, provenance=plain(about))


def simulated_times(path: Path) -> tuple[Array, Array]:
    """Times (T,) of the session at which `/clock` was kept and its simulated times (T,) then, ns; empty where there was none."""
    t_ns, sim_ns = zip(*(read_clock(part, lambda line: None) for part in _parts(path, read_notes(path))), strict=True)
    return np.concatenate(t_ns), np.concatenate(sim_ns)


def _parts(path: Path, notes: Mapping[str, str]) -> list[Path]:
    """The file with these notes and its later parts; a file of such a name that is the first part of its session is none."""
    found = [path]
    for part in parts_of(path)[1:]:
        try:
            other: Mapping[str, str] = read_notes(part)
        except SourceError:
            # what it holds is stated where it is read
            other = notes
        if other is not notes and other.get("part") == "1":
            continue
        if {**other, "part": ""} != {**notes, "part": ""}:
            raise InputError(f"{part}: is a part of another session than {path}; move it to another folder")
        found.append(part)
    return found


def _read_part(part: Path, content: _Content, say: Warn, in_section: Callable[[float], bool]) -> None:
    """Add what is in one part and in the section, and was in none before it; the first pose always."""

    def wanted(topic: str, logged_ns: int) -> bool:
        timed = content.poses and topic in (topics.DETECTIONS.name, topics.POSE.name)
        return not timed or in_section((logged_ns - content.start_ns) / 1e9)

    newest_ns = max((pose.t_ns for pose in content.poses), default=None)
    before = {(one.camera, one.t_ns) for one in content.frames} if newest_ns is not None else set()
    for topic, msg, _ in read_mcap(part, _TOPICS, say, wanted):
        if topic == topics.DETECTIONS.name:
            view, _ = detections_from_message(msg)
            if (view.camera, view.t_ns) not in before:
                content.frames.append(view)
        elif topic == topics.POSE.name:
            pose, _ = pose_from_message(msg)
            if newest_ns is None or pose.t_ns > newest_ns:
                content.poses.append(pose)
        elif topic == topics.NAMES.name:
            content.names = names_from_message(msg)
        else:
            try:
                centres = joint_centres_from_message(msg)
            except MessageError as error:
                raise MessageError(f"{part}: {error}") from None
            content.tables.update(dict.fromkeys(centres.cameras, centres.table))


def _rig_of(path: Path, notes: Mapping[str, str]) -> Rig:
    """To the last bit where the recording has it so; otherwise as ROS messages keep it."""
    if "rig" not in notes:
        return read_rig(path, lambda line: None)
    try:
        return rig_from_values(json.loads(notes["rig"]))
    except (PosefuseError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path}: the rig in its notes cannot be read ({one_line(error)})") from None


def _stated_provenance(path: Path, notes: Mapping[str, str]) -> dict[str, Any]:
    """Of a file that was made from a result; empty for that of a session."""
    try:
        made = json.loads(notes.get("provenance", "{}"))
    except ValueError as error:
        raise InputError(f"{path}: the provenance in its notes cannot be read ({one_line(error)})") from None
    if not isinstance(made, dict) or not isinstance(made.get("start_ns", 0), int):
        raise InputError(f"{path}: the provenance in its notes cannot be read (expected settings and a start time)")
    return made


def _all_names(settled: Sequence[str], given: Mapping[int, str], say: Warn) -> tuple[str, ...]:
    """Names in the order of ids: those of the settings, and over them those that were given in the session."""
    if late := sorted(person for person, name in given.items() if name and person >= MOST_NAMES):
        say(f"names of people {choices(map(str, late))} are left out: a recording names the first {MOST_NAMES} ids")
    known = {**dict(enumerate(settled)), **{person: name[:MOST_NAME] for person, name in given.items()}}
    last = max((person for person, name in known.items() if name and person < MOST_NAMES), default=-1)
    return tuple(known.get(person) or person_name((), person) for person in range(last + 1))


def _provenance(
    parts: Sequence[Path], notes: Mapping[str, str], rig: Rig, table: JointCentres | None, say: Warn
) -> dict[str, Any]:
    try:
        settings = json.loads(notes.get("settings", "{}"))
        config = asdict(track_config_of_live(settings, where=str(parts[0])))
    except (ConfigError, ValueError) as error:
        say(f"{parts[0]}: its settings cannot be used with this version ({one_line(error)}); give settings to solve it again")
        settings, config = {}, None
    return {
        "posefuse": notes.get("posefuse", ""),
        "rig_id": rig.id,
        "session": parts[0].name,
        "parts": [part.name for part in parts],
        "live": settings,
        "config": config,
        "joint_centres": asdict(table) if table is not None else None,
    }
