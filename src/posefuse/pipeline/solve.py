"""From observations to the 3D result: a pure function of observations, rig and settings, which can be run again at any time."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from posefuse.association import AssociateSettings
from posefuse.calibration.extrinsics.refine import refined_extrinsics
from posefuse.calibration.settings import RefineSettings
from posefuse.core import InputError, JointCentres, Observations, Recording, Rig
from posefuse.core.arrays import Array
from posefuse.core.observations import NOT_KEPT, camera_times, on_time_steps
from posefuse.core.view_sequences import ViewsInParts
from posefuse.formats.joint_centres import joint_centres_from_mapping
from posefuse.foundation.parsing import plain
from posefuse.foundation.settings import settings_from_mapping
from posefuse.fusion import FuseSettings
from posefuse.kinematics.body import BodySettings
from posefuse.tracking import SmoothSettings

from .clock import StageClock
from .config import TrackConfig
from .edits import NO_EDITS, Edits, check_edits, only_person, used_frames
from .following import PeopleFollower
from .second_pass import long_enough, poses_over_time, with_bodies
from .time_steps import Timeline, common_timeline, stored_steps

# Time steps for the frames of a live session: cameras that run freely, and of which not every frame was used.


def live_timeline(observations: Observations, config: TrackConfig) -> Timeline:
    """Even time steps at the fastest camera's rate (or `config.rate_hz`), see `common_timeline`.

    Raises:
        InputError: no frame.
        SourceError: nothing between start and end, or more time steps than a recording can have.
    """
    times = camera_times(observations)
    if not times:
        raise InputError("live recording: it holds no detections; there is nothing to solve")
    return common_timeline(times, config.rate_hz, config.start_s, config.end_s)


# in the provenance of a recording whose extrinsics were refined from its people
REFINED = "refined_rig"


@dataclass(frozen=True, kw_only=True)
class SolveSettings:
    """All that a solve depends on besides observations and rig.

    Attributes:
        associate, fuse: see the packages.
        smooth: None: every time step as it was fused, no smoothing, no bridged gaps.
        centres: moves keypoints to joint centres; None: they stay where the detector marks them.
        body: fits one skeleton per person to all views; None: keypoints remain as fused and smoothed.
        only_hidden: fits the people of whom a limb was out of sight for a part of the recording, not the others.
        refine: refines the cameras' poses from the people first; None: they are as calibrated.
        gap_s: None: each camera gives one frame to each time step, interpolated between neighbouring time steps. Otherwise all
            of a camera's frames count at their own times, and two that are no farther apart are interpolated between.
        edits: stretches that are left out, and the person who is kept.
    """

    associate: AssociateSettings
    fuse: FuseSettings
    smooth: SmoothSettings | None
    centres: JointCentres | None
    body: BodySettings | None = None
    only_hidden: bool = False
    refine: RefineSettings | None = None
    gap_s: float | None = None
    edits: Edits = NO_EDITS

    @staticmethod
    def of(config: TrackConfig, centres: JointCentres | None, *, live: bool = False, edits: Edits = NO_EDITS) -> SolveSettings:
        """The part of a configuration that matters after detection; `live`: for the observations of a live session."""
        kept = centres if config.joint_centres else None
        return SolveSettings(
            associate=config.associate,
            fuse=config.fuse,
            smooth=None if config.raw else config.smooth,
            centres=kept,
            body=config.whole_body if _fits_bodies(config, kept) else None,
            only_hidden=config.body == "auto",
            refine=config.refine if config.refine_rig else None,
            gap_s=config.live_gap_s if live else None,
            edits=edits,
        )


def _fits_bodies(config: TrackConfig, centres: JointCentres | None) -> bool:
    """Whether the whole-body fit is asked for, or known to help: with offsets that were fitted to the detector."""
    if config.body != "auto":
        return config.body == "on"
    return centres is not None and config.fuse.weights == "robust" and not config.raw


def solve(
    observations: Observations, rig: Rig, settings: SolveSettings, provenance: Mapping[str, Any], clock: StageClock | None = None
) -> Recording:
    """Associate, fuse and smooth the observations of a recording.

    The first pass is repeated on the stored answers of the detector: with the settings of the first time the result is the
    same to the last bit. Frames that the edits exclude stay in the log and belong to no person.

    Args:
        observations: their person ids are those of the earlier result, by which the person to keep is known.

    Raises:
        InputError: no person could be followed, or not the one to keep.
    """
    used = used_frames(observations, settings.edits.exclusions)
    rest = observations if used.all() else observations.only(used)
    person_id = _associated(rest, rig, settings, clock)
    if settings.edits.person is not None:
        person_id = only_person(person_id, rest.person_id, settings.edits.person)
    solved = run_second_pass(rest.with_person_ids(person_id), rig, settings, provenance, clock)
    if rest is observations:
        return solved
    all_ids = np.full(len(observations), NOT_KEPT)
    all_ids[used[observations.detection_frame]] = solved.observations.person_id
    return dataclasses.replace(solved, observations=observations.with_person_ids(all_ids))


def _associated(observations: Observations, rig: Rig, settings: SolveSettings, clock: StageClock | None) -> Array:
    """(R,) the person of each detection."""
    follower = PeopleFollower(
        skeleton=observations.skeleton, rig=rig, associating=settings.associate, fusing=settings.fuse, clock=clock
    )
    tracks = np.full(len(observations), NOT_KEPT)
    for step, one in zip(stored_steps(observations), follower.follow(stored_steps(observations)), strict=True):
        for (_, rows), found in zip(step.rows(one.batches[one.chosen].kind), one.person_ids, strict=True):
            tracks[rows] = found
    return follower.people_of(tracks, observations.step_t_ns[observations.frame_step[observations.detection_frame]])


def run_second_pass(
    observations: Observations, rig: Rig, settings: SolveSettings, provenance: Mapping[str, Any], clock: StageClock | None = None
) -> Recording:
    """The second pass on observations whose people are known already.

    Raises:
        InputError: no person could be followed.
    """
    with (clock or StageClock()).stage("smooth"):
        kept = observations.keeping(long_enough(observations))
        people, gap_s = long_enough(kept), settings.gap_s
        views = ViewsInParts(kept, people, *(() if gap_s is None else (kept.step_t_ns, round(gap_s * 1e9))))
        poses = poses_over_time(views, rig, settings.fuse, settings.smooth, settings.centres)
        recording = Recording(rig=rig, poses=poses, observations=kept, provenance=provenance)
        if settings.body is None:
            return recording
        return with_bodies(recording, views, settings.body, settings.centres, only_hidden=settings.only_hidden)


def with_refined_rig(recording: Recording, settings: SolveSettings, clock: StageClock | None = None) -> Recording:
    """The recording solved again with the cameras' poses refined from its people; the provenance has what changed.

    A recording whose rig was refined already stays as it is, and so does one whose settings do not ask for it.
    """
    if settings.refine is None or REFINED in recording.provenance:
        return recording
    found = refined_extrinsics(recording.rig, recording.views, settings.refine)
    cameras = {
        name: {"moved_m": moved_m, "turned_rad": turned_rad}
        for name, moved_m, turned_rad in zip(found.rig.names, found.moved_m.tolist(), found.turned_rad.tolist(), strict=True)
    }
    about = {"calibrated_rig_id": recording.rig.id, "before_px": found.before_px, "after_px": found.after_px, "cameras": cameras}
    provenance = {**recording.provenance, "rig_id": found.rig.id, REFINED: about}
    return solve(recording.observations, found.rig, settings, provenance, clock)


def solve_live(
    recording: Recording, settings: SolveSettings, config: TrackConfig | None = None, clock: StageClock | None = None
) -> Recording:
    """The second solve of a live session: all that its cameras observed, associated, fused and smoothed over all of time.

    The observations are brought to even time steps, at the fastest camera's own rate where `config` does not state another;
    the result has these time steps, so it can be solved again like any recording.

    Args:
        config: its `rate_hz`, `start_s` and `end_s` are used.

    Raises:
        InputError: no frame, or no person could be followed.
        SourceError: more time steps than a recording can have.
    """
    line = live_timeline(recording.observations, config or TrackConfig())
    steps = on_time_steps(recording.observations, line.start_ns + line.period_ns * np.arange(line.count))
    if settings.edits.person is not None:
        steps = steps.with_person_ids(recording.observations.person_id)
    return solve(steps, recording.rig, settings, {**recording.provenance, "second_solve": True}, clock)


def solve_again(
    recording: Recording, config: TrackConfig | None = None, clock: StageClock | None = None, edits: Edits | None = None
) -> Recording:
    """Solve a recording again from its observations, with its own settings or others; a live session by `solve_live`.

    Args:
        edits: what is left out, and which person is kept; None: those of the recording.

    Raises:
        InputError: the provenance does not have the settings (the recording was not made by posefuse), or edits that are about
            no camera or person of the recording.
    """
    about = {**recording.provenance}
    table = about.get("joint_centres")
    centres = joint_centres_from_mapping(table, "provenance: joint_centres") if table else None
    chosen = config or config_of(recording)
    edits = edits_of(recording) if edits is None else edits
    check_edits(edits, recording)
    if edits.names:
        chosen = dataclasses.replace(chosen, names=edits.names)
    settings = SolveSettings.of(chosen, centres, live=recording.is_live or bool(about.get("second_solve")), edits=edits)
    about["config"] = plain(dataclasses.asdict(chosen))
    for outdated in ("edits", "fitted_people"):
        about.pop(outdated, None)
    if edits != NO_EDITS:
        about["edits"] = plain(dataclasses.asdict(edits))
    if recording.is_live:
        solved = solve_live(dataclasses.replace(recording, provenance=about), settings, chosen, clock)
    else:
        solved = solve(recording.observations, recording.rig, settings, about, clock)
    return with_refined_rig(solved, settings, clock)


def edits_of(recording: Recording) -> Edits:
    """The edits that a recording was made with; empty for one that is as it was tracked."""
    return settings_from_mapping(recording.provenance.get("edits") or {}, Edits, where="provenance: edits")


def config_of(recording: Recording) -> TrackConfig:
    """The settings that a recording was made with.

    Raises:
        InputError: the provenance does not have them (the recording was not made by posefuse).
    """
    config = recording.provenance.get("config")
    if not isinstance(config, Mapping):
        raise InputError("recording: its provenance has no settings; give the settings to solve it with")
    return settings_from_mapping(config, TrackConfig, where="provenance: config")
