"""From observations to the 3D result: a pure function of observations, rig and provenance, which can be run again at any time.

The provenance of a recording states all else that it depends on: ``config`` (`TrackConfig`), ``joint_centres`` (the detector's
table), ``edits`` (`Edits`) and ``second_solve`` (whether these are the observations of a live session).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import ConfigError, InputError, JointCentres, Observations, Recording, Rig
from posefuse.core.arrays import Array
from posefuse.core.observations import NOT_KEPT, camera_times, on_time_steps
from posefuse.core.view_sequences import ViewsInParts
from posefuse.formats.joint_centres import joint_centres_from_mapping
from posefuse.foundation.parsing import plain
from posefuse.foundation.settings import settings_from_mapping
from posefuse.health.recorded import CameraFit, checked_rig
from posefuse.health.rig_monitor import UNSYNCHRONISED, RigFinding
from posefuse.sources import Coverage, incomplete_cameras

from .config import TrackConfig
from .edits import NO_EDITS, Edits, check_edits, left_out, only_person, used_frames
from .following import PeopleFollower
from .second_pass import fit_bodies_in_place, long_enough, poses_over_time
from .time_steps import common_timeline, frame_period_ns, stored_steps

# what the provenance states of the cameras, in plain values
CAMERA_FITS, RIG_WARNINGS, MOVED_CAMERAS, INCOMPLETE_CAMERAS = (
    "camera_fits", "rig_warnings", "moved_cameras", "incomplete_cameras"
)  # fmt: skip
# settings that stored observations cannot follow
_OBSERVED = ("rig", "input", "cameras", "keypoints", "detector")


def solve(observations: Observations, rig: Rig, provenance: Mapping[str, Any]) -> Recording:
    """Associate, fuse and smooth the observations of a recording as its provenance states.

    The first pass is repeated on the stored answers of the detector: with the settings of the first time the result is the
    same to the last bit. Frames that the edits exclude stay in the log and belong to no person.

    Args:
        observations: their person ids are those of the earlier result, by which the person to keep is known.

    Raises:
        InputError: no person could be followed, or not the one to keep; or no settings in the provenance.
    """
    config, edits = config_of(provenance), edits_of(provenance)
    used = used_frames(observations, edits.exclusions)
    rest = observations if used.all() else observations.only(used)
    person_id = _associated(rest, rig, config)
    try:
        if edits.person is not None:
            person_id = only_person(person_id, rest.person_id, edits.person)
        solved = solve_followed(rest.with_person_ids(person_id), rig, provenance)
    except InputError as error:
        raise type(error)(f"{error}{left_out(edits.exclusions)}") from None
    if rest is observations:
        return solved
    all_ids = np.full(len(observations), NOT_KEPT)
    all_ids[used[observations.detection_frame]] = solved.observations.person_id
    return dataclasses.replace(solved, observations=observations.with_person_ids(all_ids))


def _associated(observations: Observations, rig: Rig, config: TrackConfig) -> Array:
    """(R,) the person of each detection."""
    follower = PeopleFollower(skeleton=observations.skeleton, rig=rig, associating=config.associate, fusing=config.fuse)
    tracks = np.full(len(observations), NOT_KEPT)
    for step, one in zip(stored_steps(observations), follower.follow(stored_steps(observations)), strict=True):
        for (_, rows), found in zip(step.rows(one.batch.kind), one.person_ids, strict=True):
            tracks[rows] = found
    return follower.people_of(tracks, observations.step_t_ns[observations.frame_step[observations.detection_frame]])


def solve_followed(observations: Observations, rig: Rig, provenance: Mapping[str, Any]) -> Recording:
    """The second pass on observations whose people are known already.

    Raises:
        InputError: no person could be followed; or no settings in the provenance.
    """
    config, table = config_of(provenance), provenance.get("joint_centres")
    centres = joint_centres_from_mapping(table, "provenance: joint_centres") if table and config.joint_centres else None
    kept = observations.keeping(long_enough(observations))
    people = long_enough(kept)
    # of a live session not every frame was used: all count at their own times
    own_times = (kept.step_t_ns, round(config.live_gap_s * 1e9)) if provenance.get("second_solve") else ()
    views = ViewsInParts(kept, people, *own_times)
    poses = poses_over_time(views, rig, config.fuse, None if config.raw else config.smooth, centres)
    recording = Recording(rig=rig, poses=poses, observations=kept, provenance=provenance)
    if not fits_bodies(config, centres):
        return recording
    return fit_bodies_in_place(recording, views, config.whole_body, centres, only_hidden=config.body == "auto")


def fits_bodies(config: TrackConfig, centres: JointCentres | None) -> bool:
    """Whether the whole-body fit is asked for, or known to help: with offsets that were fitted to the detector."""
    if config.body != "auto":
        return config.body == "on"
    return centres is not None and config.joint_centres and config.fuse.weights == "robust" and not config.raw


def solve_again(recording: Recording, config: TrackConfig | None = None, edits: Edits | None = None) -> Recording:
    """Solve a recording again from its observations, with its own settings or others.

    The observations of a live session are brought to even time steps, at the fastest camera's own rate where `config` does not
    state another; the result has these time steps, so it can be solved again like any recording.

    Args:
        config: of a live session its `rate_hz` is used, too.
        edits: what is left out, and which person is kept; None: those of the recording.

    Raises:
        InputError: the provenance does not have the settings (the recording was not made by posefuse), or edits that are about
            no camera or person of the recording; no frame, or no person could be followed.
        ConfigError: another value of a setting that the observations were made with.
        SourceError: nothing recorded between `start_s` and `end_s`, or more time steps than a recording can have.
    """
    about, observations = {**recording.provenance}, recording.observations
    chosen = config or config_of(about)
    edits = edits_of(about) if edits is None else edits
    check_edits(edits, recording)
    if edits.names:
        chosen = dataclasses.replace(chosen, names=edits.names)
    live = recording.is_live or about.get("second_solve", False)
    if "config" in about:
        _check_same(config_of(about), chosen, _OBSERVED if live else (*_OBSERVED, "rate_hz"))
    about["config"] = plain(dataclasses.asdict(chosen))
    for outdated in ("edits", "fitted_people"):
        about.pop(outdated, None)
    if edits != NO_EDITS:
        about["edits"] = plain(dataclasses.asdict(edits))
    if live:
        about["second_solve"] = True
        observations = _on_even_steps(observations, chosen)
        if edits.person is not None:
            observations = observations.with_person_ids(recording.observations.person_id)
    elif (chosen.start_s, chosen.end_s) != (None, None):
        t_ns = observations.step_t_ns
        line = common_timeline({"all": t_ns}, None, chosen.start_s, chosen.end_s)
        first = int(np.searchsorted(t_ns, line.start_ns - line.period_ns // 2))
        observations = observations.part(slice(first, first + line.count))
    solved = solve(observations, recording.rig, about)
    if CAMERA_FITS not in about:
        return solved
    return dataclasses.replace(solved, provenance={**solved.provenance, **_checked_again(solved, edits)})


def _checked_again(solved: Recording, edits: Edits) -> dict[str, Any]:
    """How well each camera fits now, and what of the recording's warnings is true of what is used of it."""
    log, about = solved.observations, solved.provenance
    cameras, findings = checked_rig(solved, solved.rig)
    if edits.exclusions:
        log = log.only(used_frames(log, edits.exclusions))
        findings = checked_rig(dataclasses.replace(solved, observations=log), solved.rig)[1]
    times = camera_times(log)
    used_ns = {name: range(int(t_ns[0]) + 1, int(t_ns[-1]) + 1) for name, t_ns in times.items()}
    moved = [one for one in about.get(MOVED_CAMERAS, ()) if one["t_ns"] in used_ns.get(one["camera"], ())]
    recorded = camera_times(solved.observations)
    unread = [name for name in solved.rig.names if name not in recorded]
    coverages = [Coverage(name, 1, 0, None, 0) for name in unread] + [_coverage(name, t_ns) for name, t_ns in times.items()]
    incomplete = {line.split(":")[0] for line in incomplete_cameras(coverages)}
    lines = [finding_line(one, Path(about.get("session", "SESSION"))) for one in findings]
    left = [line for line in about.get(INCOMPLETE_CAMERAS, ()) if line.split(":")[0] in incomplete]
    return {**rig_facts(cameras, moved, lines), INCOMPLETE_CAMERAS: left}


def _coverage(name: str, t_ns: Array) -> Coverage:
    """Of frames at these times, as if one were missing wherever two are apart."""
    period_ns = frame_period_ns(t_ns) or 0.0
    expected = 1 + round((int(t_ns[-1]) - int(t_ns[0])) / period_ns) if period_ns else len(t_ns)
    return Coverage(name, expected, len(t_ns), int(t_ns[-1]), round(period_ns))


def finding_line(finding: RigFinding, session: Path) -> str:
    """When it shows, what is wrong with a camera, and what to do about it."""
    remedy = f"; `posefuse calibrate clocks {session}` finds its offset" if finding.kind == UNSYNCHRONISED else ""
    return f"at {finding.t_ns / 1e9:.1f} s: {finding.detail}{remedy}"


def rig_facts(cameras: Mapping[str, CameraFit], moved: Sequence[Mapping[str, Any]], lines: Sequence[str]) -> dict[str, Any]:
    """What the provenance states of the cameras: how well each fits, which moved, and all warnings; `lines` are the others."""
    fits = {name: dataclasses.asdict(one) for name, one in cameras.items()}
    warned = [*(one["warning"] for one in moved), *lines]
    facts: dict[str, Any] = plain({CAMERA_FITS: fits, MOVED_CAMERAS: list(moved), RIG_WARNINGS: warned})
    return facts


def _check_same(before: TrackConfig, now: TrackConfig, names: Sequence[str]) -> None:
    for name in names:
        if getattr(before, name) != getattr(now, name):
            raise ConfigError(f"{name}: the detections were made with another value; for this one, track the session again")


def _on_even_steps(observations: Observations, config: TrackConfig) -> Observations:
    """Of cameras that run freely, and of which not every frame was used; see `common_timeline`."""
    times = camera_times(observations)
    if not times:
        raise InputError("live recording: it holds no detections; there is nothing to solve")
    line = common_timeline(times, config.rate_hz, config.start_s, config.end_s)
    return on_time_steps(observations, line.start_ns + line.period_ns * np.arange(line.count))


def edits_of(provenance: Mapping[str, Any]) -> Edits:
    """The edits that a recording was made with; empty for one that is as it was tracked."""
    return settings_from_mapping(provenance.get("edits") or {}, Edits, where="provenance: edits")


def config_of(provenance: Mapping[str, Any]) -> TrackConfig:
    """The settings that a recording was made with.

    Raises:
        InputError: the provenance does not have them (the recording was not made by posefuse).
    """
    config = provenance.get("config")
    if not isinstance(config, Mapping):
        raise InputError("recording: its provenance has no settings; give the settings to solve it with")
    return settings_from_mapping(config, TrackConfig, where="provenance: config")
