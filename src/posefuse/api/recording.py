"""A recording and its joint angles: the result of tracking, to save and solve again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from posefuse import core
from posefuse.core import InputError, Progress
from posefuse.core.arrays import Array
from posefuse.foundation.summary import Block, Facts, Heading

from .arguments import checked, shown
from .rig_and_detector import Rig, rig_of

if TYPE_CHECKING:
    import pandas as pd
    from pandas import DataFrame

    from posefuse.kinematics.gait import Gait
    from posefuse.pipeline.edits import Edits
    from posefuse.pipeline.session import Session

    from .outcome import RunOutcome
    from .playback import Playback


class JointAngles(core.JointAngles):
    """Joint angles of a recording; all of `core.JointAngles`, and what one does with it.

    Examples:
        >>> import posefuse as pf
        >>> angles = pf.read("RESULT").joint_angles()  # doctest: +SKIP
        >>> angles["left_knee", "flexion"].deg.max()  # doctest: +SKIP
        >>> angles.to_dataframe().groupby(["joint", "angle"]).deg.max()  # doctest: +SKIP
    """

    def to_dataframe(self) -> DataFrame:
        """One row per time step, person and angle: time_s, person, joint, angle, deg, sigma_deg; needs the extra ``data``."""
        from posefuse.formats.labelled import angles_to_dataframe

        return angles_to_dataframe(self)


def joint_angles_of(value: core.JointAngles) -> JointAngles:
    """The same angles as those of the public interface."""
    return JointAngles(**{field.name: getattr(value, field.name) for field in fields(core.JointAngles)})


Fit = Literal["points", "none"]
# outputs of the 3D result alone
_WITHOUT_DETECTIONS = ("trc", "c3d", "csv")


class Written(NamedTuple):
    """Files that were written, and why outputs failed, by name."""

    files: list[Path]
    failed: Mapping[str, str]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Recording(core.Recording):
    """People in 3D over time with everything they were made from; from `track`, `read` or a live session alike.

    Attributes:
        rig: the cameras used.
        poses: `PoseSequence`: t_ns (T,), person_id (N,), xyz_world (T, N, K, 3) in metres, cov_world, and how each came about.
        observations: every detection that it was made from, raw, at its own exposure time.
        provenance: plain values: version, settings, inputs.
        path: where it was read from or written to; None for one that is in memory only.
        outcome: how the run of this program went that made it; None for one that was read.

    Examples:
        >>> import posefuse as pf
        >>> recording = pf.read("RESULT")  # doctest: +SKIP
        >>> knee = recording.joint_angles()["left_knee", "flexion"]  # doctest: +SKIP
        >>> knee.deg, knee.sigma_deg  # doctest: +SKIP
    """

    rig: Rig
    path: Path | None = None
    outcome: RunOutcome | None = None

    @property
    def figures(self) -> Mapping[str, Any]:
        """How the run went that made it, as plain values: times, files, outputs that failed; empty for one that was read."""
        return {} if self.outcome is None else self.outcome.figures

    def summary(self) -> Sequence[Block]:
        """What it is, and how the run went that made it, for people."""
        if self.outcome is not None:
            return self.outcome.summary
        title, *facts = repr(self).splitlines()
        return [
            Heading(title),
            Facts(dict(fact.strip().partition(": ")[::2] for fact in facts)),
        ]

    def __repr__(self) -> str:
        poses, rig = self.poses, self.rig
        seen = float(np.isfinite(poses.xyz_world[..., 0]).mean()) if poses.xyz_world.size else 0.0
        people = ", ".join(map(str, poses.person_id.tolist())) or "none"
        return (
            f"Recording of {self.duration_s:.2f} s, {len(poses)} time steps ({self.rate_hz:.1f} per second)\n"
            f"  people (ids): {people}; {len(poses.skeleton)} keypoints ({poses.skeleton.name}), {seen:.0%} present\n"
            f"  cameras: {', '.join(rig.names)} (rig {rig.id})\n"
            f"  observations: {len(self.observations)} detections in {self.observations.image_count} images\n"
            f"  made by posefuse {self.provenance.get('posefuse', '?')} from {self.provenance.get('session', '?')}"
        )

    @property
    def duration_s(self) -> float:
        """From the first time step to the last."""
        from posefuse.outputs.provenance import duration_s

        return duration_s(self.poses)

    @property
    def rate_hz(self) -> float:
        """Time steps per second; NaN for fewer than two."""
        return (len(self.poses) - 1) / self.duration_s if self.duration_s > 0 else float("nan")

    @property
    def recorded_utc(self) -> str:
        """When the camera stated that it recorded, or the live session began, as ``2026-01-31T12:00:00Z``; empty if not known."""
        from posefuse.outputs.provenance import recorded_utc

        return recorded_utc(self.provenance)

    def quality(self) -> dict[str, Any]:
        """How long, complete and exact it is; NaN where that is not known.

        duration_s, time_steps, cameras, people, present_share (of keypoints and time steps), median_sigma_mm,
        median_reprojection_px.
        """
        from posefuse.pipeline.batch.figures import quality_figures

        return quality_figures(self.poses, len(self.rig))

    @property
    def t_s(self) -> Array:
        """(T,) session seconds, as in files and in `Exclusion`."""
        return self.poses.t_ns * 1e-9

    def keypoint(self, name: str) -> Array:
        """(T, N, 3) metres in the world frame; raises InputError for a name that the skeleton does not have."""
        names = self.poses.skeleton.keypoints
        if name not in names:
            raise InputError(f"no keypoint {name!r}; there are: {core.errors.choices(names)}")
        return np.asarray(self.poses.xyz_world[:, :, names.index(name)])

    @checked
    def joint_angles(self, *, fit: Fit = "points") -> JointAngles:
        """Segment frames and joint angles (ISB) with their standard deviations.

        Args:
            fit: ``points`` fits one skeleton of constant lengths per person to the 3D points, ``none`` takes the angles straight
                from them.

        Raises:
            InputError: left and right of a person are swapped, or no person was seen well enough.
        """
        from posefuse.evaluation.biomechanics import BiomechanicsSettings, joints_of

        return joint_angles_of(joints_of(self, BiomechanicsSettings(fit=fit))[1])

    @checked
    def solve(
        self,
        *,
        smooth: bool = True,
        people: int | None = None,
        settings: Mapping[str, Any] | None = None,
        edits: Edits | None = None,
    ) -> Recording:
        """Associate, fuse and smooth the kept observations again; nothing is detected again.

        Args:
            smooth: False leaves every time step as it was fused.
            people: how many at most; None: as before.
            settings: changes by dotted key as in ``--set``, e.g. ``{"fuse.weights": "score"}``.
            edits: stretches and cameras to leave out, the person to keep, names; None: as before; ``Edits()``: none.

        Returns:
            A new recording. With the settings and edits of the first time it is the same to the last bit. What edits exclude
            stays in its observations, so that other edits can be tried later.

        Raises:
            ConfigError: an unknown setting or a wrong value.
            InputError: no one can be followed, or edits about a camera or person that is not there.

        Examples:
            >>> import posefuse as pf
            >>> recording = pf.read("RESULT")  # doctest: +SKIP
            >>> blocked = pf.Exclusion(camera="cam02", start_s=1.5, end_s=2.5)  # doctest: +SKIP
            >>> recording.solve(edits=pf.Edits(exclusions=(blocked,)))  # doctest: +SKIP
        """
        from posefuse.pipeline.config import changed_config
        from posefuse.pipeline.solve import config_of, solve_again

        changes: dict[str, Any] = {**(settings or {})}
        if not smooth:
            changes["raw"] = True
        if people is not None:
            changes["associate.max_people"] = people
        return recording_of(solve_again(self, changed_config(config_of(self.provenance), changes), edits=edits))

    @checked
    def save(
        self,
        path: str | Path,
        *,
        formats: Sequence[str] = (),
        session: str | Path | None = None,
        replace: bool = False,
        progress: Progress | bool | None = None,
    ) -> list[Path]:
        """Write a result folder that `read` reads back to the last bit, and files of other formats next to it.

        Args:
            path: new or empty folder; with `replace` an earlier result is moved to ``NAME.replaced-TIME``.
            formats: names of outputs, e.g. ``trc``, ``c3d``, ``csv``, ``overlay``; see `posefuse plugins`.
            session: the session folder, whose images outputs such as ``overlay`` draw on.

        Returns:
            The files written.

        Raises:
            ConfigError: no such format.
            InputError: the folder holds anything else, or a file cannot be written.
        """
        from posefuse.pipeline.session import find_session
        from posefuse.pipeline.solve import config_of
        from posefuse.pipeline.writing import export_recording

        found = None if session is None else find_session(Path(session), config_of(self.provenance))
        inputs = () if found is None else (found.folder,)
        with shown(progress) as report:
            files, _ = export_recording(
                self, Path(path), formats, found, command="track", replace=replace, progress=report, inputs=inputs
            )
        return files

    @checked
    def export(
        self,
        path: str | Path,
        formats: Sequence[str],
        *,
        session: str | Path | None = None,
        within: str | Path | None = None,
        progress: Progress | bool | None = None,
    ) -> Written:
        """Write files of other formats alone, without the result itself; see `save`. Earlier ones of its own are moved aside.

        Args:
            session: the session folder, whose images are drawn on; None: one of its name near the result.
            within: look for it in this folder only.

        Returns:
            The files, and why outputs failed, by name; each is a `UserWarning`, too.

        Raises:
            ConfigError: no such format.
            InputError: the folder holds anything else or overlaps the result, or no file can be written.
        """
        from posefuse.pipeline.reading import files_of_result
        from posefuse.pipeline.writing import export_recording

        inputs = [] if self.path is None else files_of_result(self.path)
        found = self._session(session, within)
        with shown(progress) as report:
            return Written(*export_recording(self, Path(path), formats, found, replace=True, progress=report, inputs=inputs))

    def _session(self, folder: str | Path | None, within: str | Path | None = None) -> Session | None:
        """The session that it was made from, where that is named or near."""
        from posefuse.pipeline.writing import session_of_recording

        from .playback import session_with_videos

        if folder is not None:
            return session_of_recording(self, Path(folder))
        return None if self.path is None else session_with_videos(self, self.path, None if within is None else Path(within))

    def playback(self, *, within: str | Path | None = None) -> Playback[Recording]:
        """What each camera saw at any time as a small image, from the videos that it was made from; use as a context manager.

        Args:
            within: a folder that the videos must lie in; None: anywhere.

        Examples:
            >>> import posefuse as pf
            >>> with pf.read("RESULT").playback() as playback:  # doctest: +SKIP
            ...     seen = playback.at("cam01", t_ns=1_500_000_000, width_px=640)
            >>> seen.jpeg, seen.detected_px, seen.projected_px  # doctest: +SKIP
        """
        from .playback import Playback

        return Playback(self, self._session(None, within))

    @property
    def edits(self) -> Edits:
        """The corrections that it was made with."""
        from posefuse.pipeline.solve import edits_of

        return edits_of(self.provenance)

    def gait(self) -> tuple[Gait | None, ...]:
        """Foot strikes, steps and strides of each person, in the order of `poses.person_id`; None for one who does not walk."""
        from posefuse.kinematics.gait import gait_from_poses

        return tuple(gait_from_poses(self.poses, n) for n in range(len(self.poses.person_id)))

    @property
    def report_page(self) -> Path | None:
        """Where `report` writes its page unless it is given a folder; None for a recording in memory only."""
        from posefuse.pipeline.writing import PAGE_FILE, report_folder

        return None if self.path is None else report_folder(self.path) / PAGE_FILE

    @checked
    def report(
        self,
        path: str | Path | None = None,
        *,
        fit: Fit = "points",
        opensim_model: str | Path | None = None,
        title: str | None = None,
        progress: Progress | bool | None = None,
    ) -> list[Path]:
        """Write joint angles, gait, OpenSim, BVH, glTF and C3D files and one HTML page into a folder; returns the files.

        Args:
            path: the folder, ``biomechanics`` in the result where None is given; an earlier report is moved aside.
            fit: see `joint_angles`. title: of the page.
            opensim_model: run OpenSim's inverse kinematics, too, on your model, scaled to each person (extra ``biomech``).

        Raises:
            InputError: the folder holds anything else or overlaps the result, or there is no one to report on.
        """
        from posefuse.evaluation.biomechanics import BiomechanicsSettings
        from posefuse.foundation.compiled import compiling
        from posefuse.pipeline.writing import report_folder, write_report_folder

        place = path if path is not None else self.path and report_folder(self.path)
        if place is None:
            raise InputError("report: expected a folder for the files of a recording that was not read from a file")
        model = None if opensim_model is None else Path(opensim_model)
        chosen = BiomechanicsSettings(fit=fit, opensim_model=model)
        with shown(progress) as report, compiling("joint angles", lambda line: report("angles", 0, None, line)):
            return write_report_folder(self, self.path, Path(place), chosen, title=title, progress=report)

    def to_dataframe(self) -> pd.DataFrame:
        """One row per time step, person and keypoint.

        Columns: time_s, person, keypoint, x_m, y_m, z_m, sigma_m, reproj_px, n_views, kind.
        """
        from posefuse.formats.labelled import recording_to_dataframe

        return recording_to_dataframe(self)

    def view(self, *, session: str | Path | None = None, progress: Progress | bool | None = None) -> Path | None:
        """Open the Rerun viewer on it and wait until it is closed; needs the extra ``viewer``.

        Args:
            session: the session folder, whose images are shown with it; None: one of its name near the result.

        Returns:
            What was shown: the ``recording.rrd`` of the result where it has one, else the result.

        Raises:
            DependencyError: no Rerun SDK or no display. InputError: not its session.
        """
        from posefuse.outputs import rerun
        from posefuse.pipeline.writing import session_frames

        file = None if self.path is None else self.path / rerun.RerunSink.file
        if session is None and file is not None and file.is_file():
            rerun.open_in_viewer(file)
            return file
        found = self._session(session)
        with shown(progress) as report:
            if found is None and self.path is not None:
                name = self.provenance.get("session", "unnamed")
                report("images", 0, None, f"shown without images: no session {name} near {self.path} or here")
            rerun.show_recording(self, None if found is None else session_frames(self, found, report, "images"))
        return self.path


def recording_of(value: core.Recording, *, path: Path | None = None, outcome: RunOutcome | None = None) -> Recording:
    """The same result as the recording of the public interface."""
    parts = {field.name: getattr(value, field.name) for field in fields(core.Recording)}
    return Recording(**parts | {"rig": rig_of(value.rig), "path": path, "outcome": outcome})


@checked
def read(path: str | Path, *, observed: bool = True) -> Recording:
    """Read a result folder (of `track` or `Recording.save`), or the .mcap of a live session with its later parts.

    A truncated recording is read as far as possible, with a `UserWarning`.

    Args:
        observed: False: a result folder is read without the detections that it was made from, in a fraction of the memory.

    Raises:
        InputError: not a result, one of a newer format, or damaged.

    Examples:
        >>> import posefuse as pf
        >>> recording = pf.read("RESULT")  # doctest: +SKIP
        >>> recording.poses.xyz_world.shape  # time steps, people, keypoints, (x, y, z) in metres  # doctest: +SKIP
        (300, 1, 33, 3)
        >>> pf.read("live.mcap").solve().save("SECOND")  # a live session, solved again  # doctest: +SKIP
    """
    from posefuse.pipeline.reading import read_result

    return recording_of(read_result(path, observed=observed), path=Path(path))


def needs_detections(outputs: Iterable[str]) -> bool:
    """Whether a result has to be read with its detections for these outputs, by name."""
    return not set(outputs) <= set(_WITHOUT_DETECTIONS)
