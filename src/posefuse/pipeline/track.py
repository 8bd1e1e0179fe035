"""The main job: a session folder to a Recording, in two steps: detect, then solve; and into a result folder."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from posefuse import __version__
from posefuse.association import AssociateSettings, associate
from posefuse.calibration.clocks.person_tracks import limb_keypoints
from posefuse.calibration.person.scale import size_doubt
from posefuse.core import (
    InputError,
    LookKind,
    Observations,
    Pose3D,
    PosefuseError,
    PoseSequence,
    Progress,
    Recording,
    Rig,
    silent,
)
from posefuse.core.duplicates import duplicates
from posefuse.core.errors import choices, warn_caller
from posefuse.core.observations import NOT_KEPT
from posefuse.core.protocols import NOISE_NOT_FITTED
from posefuse.core.view_sequences import people_in, views_over_time
from posefuse.detection.build import fetch_networks
from posefuse.foundation.compiled import compiling
from posefuse.foundation.output_file import check_space
from posefuse.foundation.parsing import plain
from posefuse.fusion import FuseSettings, fuse
from posefuse.health.background import background_of
from posefuse.health.misalignment import disagreement, noise_scale
from posefuse.health.recorded import checked_rig
from posefuse.sources.video import recorded_at
from posefuse.tracking import smooth
from posefuse.tracking.warm_up import made_up_detections

from .config import TrackConfig
from .following import FollowedLog, PeopleFollower
from .opening import Opened, open_session
from .result_folder import DetectionStore, ResultFolder
from .session import LEAST_CAMERAS, Session
from .solve import INCOMPLETE_CAMERAS, finding_line, rig_facts, solve_followed
from .time_steps import stored_steps
from .writing import build_sinks, estimated_result_bytes, warn_of_failures, write_result


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Tracked:
    """A recording and how the run went.

    Attributes:
        recording: the result; its provenance has how well each camera fits (``camera_fits``) and what is wrong with the rig
            (``rig_warnings``). seconds: of the whole run. start_up_s: until the first image was looked at.
        files: written, where they lie at the end. failed: why outputs were not written, by name.
    """

    recording: Recording
    seconds: float
    start_up_s: float
    files: Sequence[Path] = ()
    failed: Mapping[str, str] = dataclasses.field(default_factory=dict)


def track_session(
    session: Session,
    config: TrackConfig,
    out: ResultFolder | None = None,
    progress: Progress = silent,
) -> Tracked:
    """Detect, solve and write; a problem that does not stop the work is a `UserWarning`.

    Args:
        out: where the result is written, and the detections are kept while they are made; None: nothing is kept on disk.
        progress: of the stages ``detect`` and ``write``.

    Raises:
        KeyboardInterrupt: Ctrl-C. PosefuseError: anything that leaves fewer than two usable cameras, or no person to follow.
            With either the detections made so far are kept where another attempt can use them.
    """
    began_s, kind = time.perf_counter(), session.kind
    if out is not None:
        out.check(session, config)
    for line in session.notes:
        warn_caller(line)
    progress("detect", 0, None, f"{len(session.inputs)} cameras from {session.rig_path} ({kind})")
    if kind != "pose2d":
        fetch_networks(config.detector, progress)
    files, failed = list[Path](), dict[str, str]()
    with closing(open_session(session, config)) as opened:
        sinks = [] if out is None else build_sinks(config.outputs)
        with compiling("tracking", lambda line: progress("detect", 0, None, line)):
            warm_up(opened)
        start_up_s = time.perf_counter() - began_s
        moved = _moved_cameras(opened, progress)
        if out is None:
            recording = _tracked(opened, moved, progress, None)
        else:
            with out.made(opened, progress) as (folder, store):
                recording = _tracked(opened, moved, progress, store)
                check_space(folder.folder, estimated_result_bytes(opened, len(recording.poses.person_id)))
                files, failed = write_result(recording, session, sinks, folder, progress)
                warn_of_failures(failed)
    seconds = time.perf_counter() - began_s
    return Tracked(recording=recording, seconds=seconds, start_up_s=start_up_s, files=files, failed=failed)


def _tracked(
    opened: Opened,
    moved: Sequence[Mapping[str, Any]],
    progress: Progress,
    store: DetectionStore | None,
) -> Recording:
    """Detect, then solve; `moved` is what is wrong with the rig already, see `_moved_cameras`."""
    session = opened.session
    observations = detect(opened, progress, store)
    incomplete = opened.incomplete()
    # decoded frames are not needed any more, and an hour to be solved takes much memory
    opened.close()
    for line in incomplete:
        warn_caller(line)
    try:
        _check_people(observations)
        opened, observations = _with_known_noise(opened, observations, progress)
        recording = solve_followed(observations, opened.rig, provenance_of(opened, incomplete))
    except PosefuseError:
        if store is not None and not (observations.score > 0).any():
            store.discard()
        raise
    for line in _notes(recording, opened.config):
        progress("detect", 0, None, line)
    if doubt := size_doubt(recording.poses.skeleton, recording.poses.xyz_world):
        warn_caller(f"{session.rig_path.name}: {doubt}")
    cameras, findings = checked_rig(recording, opened.rig)
    for line in (lines := [finding_line(one, session.folder) for one in findings]):
        warn_caller(line)
    about = {**recording.provenance, **rig_facts(cameras, moved, lines)}
    return dataclasses.replace(recording, provenance=about)


def _with_known_noise(opened: Opened, observations: Observations, progress: Progress) -> tuple[Opened, Observations]:
    """Standard deviations of a network whose noise was not fitted, scaled as this recording shows; and what is stated of it."""
    unknown = opened.network.get("unknown", "")
    if NOISE_NOT_FITTED not in unknown or (scale := recorded_noise_scale(observations, opened.rig, opened.config.fuse)) is None:
        return opened, observations
    scaled = f"{NOISE_NOT_FITTED}; scaled by {scale:.2g} from this recording"
    progress("detect", 0, None, f"{opened.network['name']}: {scaled}")
    network = {**opened.network, "unknown": unknown.replace(NOISE_NOT_FITTED, scaled)}
    sigma_px = (observations.sigma_px * scale).astype(observations.sigma_px.dtype)
    return dataclasses.replace(opened, network=network), dataclasses.replace(observations, sigma_px=sigma_px)


# more add nothing
_NOISE_TIME_STEPS = 1000


def recorded_noise_scale(observations: Observations, rig: Rig, fusing: FuseSettings) -> float | None:
    """Of the limb joints of a recording, see `health.misalignment.noise_scale`; None where too little is seen."""
    every = max(1, len(observations.step_t_ns) // _NOISE_TIME_STEPS)
    some = observations.part(slice(None, None, every))
    views, limbs = views_over_time(some, people_in(some)[0].tolist()), limb_keypoints(some.skeleton.keypoints)
    seen = views.xy_img[..., limbs, :], views.score[..., limbs], views.sigma_px[..., limbs]
    return noise_scale(disagreement(rig, *seen, fusing))


def _moved_cameras(opened: Opened, progress: Progress) -> list[dict[str, Any]]:
    """Cameras that moved by what the background shows, for the provenance; what else there is to know is reported."""
    background = background_of(opened.sources, opened.rig.cameras, opened.timeline.span_ns)
    moved: list[dict[str, Any]] = [
        {"camera": one.cameras[0], "t_ns": one.t_ns, "warning": finding_line(one, opened.session.folder)}
        for one in background.moved
    ]
    for one in moved:
        warn_caller(one["warning"])
    for line in background.lines:
        progress("detect", 0, None, line)
    if unknown := opened.network.get("unknown"):
        progress("detect", 0, None, f"{opened.network['name']} on {opened.network['device']}: {unknown}")
    return moved


# Compile the numeric kernels before the clock of the real work runs; they are kept on disk, so only the first run waits.

_TIME_STEPS = 12


def warm_up(opened: Opened) -> None:
    """Run association, fusion and smoothing once on a made-up person in front of the cameras."""
    rig, config = opened.rig, opened.config
    poses: list[Pose3D] = []
    for detections in made_up_detections(rig, opened.skeleton, _TIME_STEPS):
        before = poses[-1] if poses else None
        poses.append(fuse(associate(detections, rig, config.associate, before), rig, config.fuse, before))
    people = [pose for pose in poses if len(pose.person_id) == len(poses[-1].person_id)]
    if len(people) > 2 and len(people[0].person_id):
        smooth(PoseSequence.from_poses(people), config.smooth)


def detect(opened: Opened, progress: Progress = silent, store: DetectionStore | None = None) -> Observations:
    """All detections with the people that the online pass followed.

    What `store` has already is not detected again; what is new is given to it at once.
    """
    config, stored = opened.config, store.stored if store else None
    follower = PeopleFollower(
        skeleton=opened.skeleton,
        rig=opened.rig,
        associating=config.associate,
        fusing=config.fuse,
        keep=store.append if store else None,
    )
    steps = itertools.chain(stored_steps(stored) if stored else (), opened.steps(stored))
    log = FollowedLog(follower)
    for done, one in enumerate(follower.follow(steps), start=1):
        log.add(one)
        progress("detect", done, opened.timeline.count)
    return log.observations()


def provenance_of(opened: Opened, incomplete: Sequence[str]) -> dict[str, Any]:
    """How a result is made, in plain values; nothing that differs between two runs of the same command."""
    session, centres = opened.session, opened.joint_centres if opened.config.joint_centres else None
    recorded = recorded_at(session.inputs[0].path) if session.kind == "videos" else None
    return {
        "posefuse": __version__,
        "rig_id": opened.rig.id,
        "rig_file": session.rig_path.name,
        "session": session.folder.name,
        **({} if recorded is None else {"recorded": recorded}),
        "inputs": {entry.camera: entry.path.name for entry in session.inputs},
        "config": plain(dataclasses.asdict(opened.config)),
        **({"network": dict(opened.network)} if opened.network else {}),
        "joint_centres": plain(dataclasses.asdict(centres)) if centres else None,
        INCOMPLETE_CAMERAS: list(incomplete),
    }


def _check_people(observations: Observations) -> None:
    """Name the cause where it happens: cameras in which no person was ever found."""
    steps, names = len(observations.step_t_ns), observations.camera_names
    if not steps:
        raise InputError("no frame could be read from any camera")
    detected = (observations.score > 0).any(axis=1)
    followed = detected & (observations.person_id != NOT_KEPT)
    cameras = observations.frame_camera[observations.detection_frame]
    # frames of each camera with a person, and how often that person is where the other cameras see one
    seen = [len(np.unique(observations.detection_frame[detected & (cameras == c)])) for c in range(len(names))]
    agreed = [int((followed & (cameras == c)).sum()) for c in range(len(names))]
    empty = [name for name, frames in zip(names, seen, strict=True) if not frames]
    for name in empty:
        warn_caller(f"camera {name}: no person found in {steps} of {steps} frames")
    least = 1 if observations.depth_m is not None else LEAST_CAMERAS
    if len(names) - len(empty) < least:
        raise InputError(
            f"a person was found in {len(names) - len(empty)} of {len(names)} cameras; two are needed "
            f"(no person in: {choices(empty)}); can the network see people in these images? "
            "Of a network of your own, check channels, mean, std and layout in its card"
        )
    if sum(map(bool, agreed)) < least:
        counts = ", ".join(f"{frames} frames of {name}" for name, frames in zip(names, seen, strict=True) if frames)
        raise InputError(f"a person was found in {counts}, but no two agree: is the calibration the one of these videos?")


def _notes(recording: Recording, config: TrackConfig) -> Iterator[str]:
    """What a user may want to know of a result: people left out, names without a person."""
    people = recording.poses.person_id
    if others := others_line(others_seen(recording.observations, config.associate), len(people)):
        yield others
    if unused := config.names[int(people.max(initial=-1)) + 1 :]:
        yield f"{len(people)} {'person' if len(people) == 1 else 'people'} found: no one has the name {choices(unused)}"


# People who were seen but not asked for: how many, and in which cameras.

# a person seen by one camera alone may be a poster on the wall
_LEAST_CAMERAS = 2


def others_seen(observations: Observations, settings: AssociateSettings) -> dict[str, int]:
    """By camera, how many more people than the result has one search of a whole image found at most; none: left out."""
    most: dict[str, int] = {}
    # all of them: who is in the image may belong to no person at this one time step
    people = len(people_in(observations)[0])
    for i in np.flatnonzero(observations.frame_look == LookKind.SEARCH).tolist():
        found = observations.detections(i)
        bodies = ~duplicates(found, settings.duplicate_share) & (found.score > 0).any(axis=1)
        more = int(bodies.sum()) - people
        if more > 0:
            most[found.camera] = max(most.get(found.camera, 0), more)
    return most


def others_line(seen: dict[str, int], followed: int) -> str | None:
    """One line about them; None where there is nothing to report."""
    if len(seen) < _LEAST_CAMERAS:
        return None
    where = ", ".join(f"{camera} ({count})" for camera, count in seen.items())
    count = max(seen.values())
    more = "1 more person was" if count == 1 else f"up to {count} more people were"
    return f"{more} seen than the {followed} followed: {where}; `people=N` follows more"
