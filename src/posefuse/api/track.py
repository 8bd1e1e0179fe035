"""Recordings to 3D: `posefuse.track`, `solve` and `batch`."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from posefuse import core
from posefuse.core import InputError, Progress
from posefuse.fusion.settings import Weights

from .arguments import checked, lines_of, shown
from .outcome import solved_outcome, tracked_outcome
from .recording import Recording, recording_of

if TYPE_CHECKING:
    from posefuse.pipeline.batch import Study
    from posefuse.pipeline.config import TrackConfig
    from posefuse.pipeline.edits import Edits

FORMATS = ("trc", "c3d", "csv")
_NEED_IMAGES = ("overlay",)


@checked
def track(
    session: str | Path,
    *,
    people: int | None = None,
    rig: str | Path | None = None,
    networks: str | Path | None = None,
    device: str | int | None = None,
    weights: Weights | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    out: str | Path | None = None,
    formats: Sequence[str] | None = None,
    resume: bool = False,
    replace: bool = False,
    config: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    progress: Progress | bool | None = None,
) -> Recording:
    """Detect, associate, fuse and smooth the people of a session folder.

    Args:
        session: folder with a calibration file and one video, image folder or folder of 2D poses per camera. Its
            ``posefuse.toml`` is read if it exists; the arguments take precedence over it. A result is solved again by `solve`.
        people: follow at most this many.
        rig: another calibration file.
        networks: name of the 2D networks, e.g. ``blazepose_lite``, or a model card (TOML).
        device: processor, e.g. ``cpu`` or ``cuda:1``, or the number of a card of NVIDIA (see docs/networks.md).
        weights: how views are weighted: ``robust`` (default), ``score``, ``none``, ``all``.
        start_s: begin at this time of the session, in seconds.
        end_s: end at this time of the session, in seconds.
        out: folder to write the result to. The detections are kept there while they are made, so that an interruption loses
            nothing.
        formats: outputs to write there, e.g. ``("trc", "c3d")``; see `posefuse plugins`. None: those that ``posefuse.toml``
            names, else trc, c3d, csv, overlay and overview.
        resume: continue the interrupted work of `out`; from the beginning where there is none.
        replace: move an earlier result that is there to ``NAME.replaced-TIME``.
        config: settings file in place of the session's ``posefuse.toml``.
        settings: any other setting by dotted key, e.g. ``{"smooth.cutoff_hz": 8}``.
        progress: True for bars on stderr, or a function (see `Progress`).

    Returns:
        The recording; `Recording.save` writes it, `Recording.figures` and `Recording.summary` state how it went. A
        problem that does not stop the work (a camera that breaks off, was moved or is not synchronised, an output that cannot
        be written) is a `UserWarning`.

    Raises:
        KeyboardInterrupt: Ctrl-C; the detections stay in `out`, if it was given.
        PosefuseError: anything that leaves fewer than two usable cameras or no person to follow; the message names the next step.

    Examples:
        >>> import posefuse as pf
        >>> recording = pf.track("examples/demo", end_s=0.5)  # doctest: +SKIP
        >>> recording.save("RESULT", formats=("trc", "c3d"))  # doctest: +SKIP
    """
    from posefuse.detection.build import network_settings
    from posefuse.pipeline.reading import is_live
    from posefuse.pipeline.result_folder import ResultFolder
    from posefuse.pipeline.session import find_session
    from posefuse.pipeline.track import track_session

    folder = Path(session)
    if is_live(folder):
        raise InputError(f"{folder}: is a recording, not a session; `posefuse solve` solves it again")
    if out is None and (resume or replace or formats):
        raise InputError("track: resume, replace and formats are about the folder `out`, which was not given")
    names = None if formats is None else tuple(formats)
    options = {"rig": rig, "associate.max_people": people, "fuse.weights": weights, "start_s": start_s, "end_s": end_s}
    changes = {key: value for key, value in (options | {"outputs": names}).items() if value is not None}
    changes |= network_settings(networks, device) | dict(settings or {})
    chosen = session_config(folder, config, changes, outputs=out is not None)
    found, where = find_session(folder, chosen), None
    if out is not None:
        where = ResultFolder(path=Path(out), force=replace, resume=resume)
    with shown(progress) as report:
        tracked = track_session(found, chosen, where, report)
    place = None if where is None else where.path
    return recording_of(tracked.recording, path=place, outcome=tracked_outcome(place, found, chosen.detector, tracked))


@checked
def session_config(folder: Path, config: str | Path | None, changes: Mapping[str, Any], *, outputs: bool = True) -> TrackConfig:
    """Settings of a session: its own ``posefuse.toml`` or another file, with changes by dotted key on top.

    Args:
        outputs: False: no outputs where neither names some.
    """
    from posefuse.pipeline.config import CONFIG_FILE, read_config

    path = folder / CONFIG_FILE if config is None else Path(config)
    given = dict(changes)
    if isinstance(rig := given.get("rig"), (str, Path)):
        # relative to here; a name in a settings file is relative to the session
        given["rig"] = str(Path(rig).absolute() if Path(rig).exists() else rig)
    return read_config(path if config is not None or path.is_file() else None, given, {} if outputs else {"outputs": ()})


def demo_session() -> Path:
    """The bundled clip of four simulated cameras and a walking person, a session folder for `track`.

    Raises:
        InputError: this installation has none.

    Examples:
        >>> import posefuse as pf
        >>> sorted(path.name for path in (pf.demo_session() / "videos").glob("*.mp4"))[:2]
        ['cam00.mp4', 'cam01.mp4']
    """
    from posefuse.pipeline.session import clip_folder

    return clip_folder()


@checked
def solve(
    result: str | Path,
    out: str | Path,
    *,
    edits: Edits | None = None,
    replace: bool = False,
    config: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    progress: Progress | bool | None = None,
) -> Recording:
    """Solve a result or a live recording again from its observations, without detecting, into a new result folder.

    `Recording.solve` does the same in memory.

    Args:
        result: result folder, or the .mcap of a live session.
        out: folder for the new result.
        edits: what is left out, who is kept, and names; None: those it was made with.
        replace: move an earlier result in `out` to ``NAME.replaced-TIME``.
        config: settings file, on top of the settings of the result.
        settings: settings by dotted key, on top of both; ``start_s`` and ``end_s`` select a part.
        progress: True for bars on stderr, or a function (see `Progress`).

    Raises:
        InputError: not a result, settings or edits about what is not there, or no person to follow.
        ConfigError: a wrong setting.

    Examples:
        >>> import posefuse as pf
        >>> blocked = pf.Exclusion(camera="cam02", start_s=1.5, end_s=2.5)
        >>> again = pf.solve("RESULT", "SECOND", edits=pf.Edits(exclusions=(blocked,)))  # doctest: +SKIP
    """
    from posefuse.foundation.compiled import compiling
    from posefuse.foundation.output_folder import output_folder
    from posefuse.pipeline.edits import check_exclusions
    from posefuse.pipeline.reading import files_of_result, read_result
    from posefuse.pipeline.solve import edits_of, solve_again
    from posefuse.pipeline.writing import build_sinks, nearby_session, warn_of_failures, write_result

    path, place, changes = Path(result), Path(out), dict(settings or {})
    began_s, inputs = time.perf_counter(), files_of_result(path)
    with shown(progress) as report, output_folder(place, command="track", inputs=inputs, replace=replace) as folder:
        earlier, note = read_result(path, start_s=changes.get("start_s"), end_s=changes.get("end_s")), lines_of(report, "solve")
        session = None if earlier.is_live else nearby_session(earlier, path)
        chosen = _solve_config(earlier, config, changes, images=session is not None)
        # an hour of them takes much memory, and only observations are solved again
        earlier = dataclasses.replace(earlier, poses=earlier.poses.people(np.zeros(0, np.intp)))
        if edits is not None:
            check_exclusions(edits.exclusions, earlier)
        used = edits_of(earlier.provenance) if edits is None else edits
        sinks = build_sinks(chosen.outputs)
        with compiling("tracking", note):
            recording = solve_again(earlier, chosen, used)
        files, failed = write_result(recording, session, sinks, folder, report)
    warn_of_failures(failed)
    excluded, seconds = len(used.exclusions), time.perf_counter() - began_s
    outcome = solved_outcome(place, recording, files=files, failed=failed, seconds=seconds, excluded=excluded)
    return recording_of(recording, path=place, outcome=outcome)


def _solve_config(earlier: core.Recording, config: str | Path | None, changes: Mapping[str, Any], *, images: bool) -> TrackConfig:
    """The recording's own settings with the config file and changes on top; without images no outputs that draw on them."""
    from posefuse.pipeline.config import DEFAULT_OUTPUTS, options_by_name, read_config

    base = dict(earlier.provenance.get("config") or {})
    outputs = options_by_name(DEFAULT_OUTPUTS if earlier.is_live else base.get("outputs") or ())
    base["outputs"] = {name: one for name, one in outputs.items() if images or name not in _NEED_IMAGES}
    return read_config(None if config is None else Path(config), changes, base)


@checked
def batch(
    study: str | Path,
    out: str | Path,
    *,
    networks: str | Path | None = None,
    device: str | int | None = None,
    formats: Sequence[str] | None = None,
    report: bool = True,
    jobs: int | None = None,
    scheduler: str | None = None,
    config: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    replace: bool = False,
    progress: Progress | bool | None = None,
) -> Study:
    """Track every session below a folder; a trial that fails is named, and the others are finished.

    Run it again to continue: complete trials are kept, failed and new ones are done.

    Args:
        study: folder with sessions below it, e.g. ``P01/walk1``; a calibration may lie with the session or above it.
        out: folder for the results: a result folder per trial, and the table ``study.csv``.
        networks: as in `track`. device: the same.
        formats: outputs of each trial, see `posefuse plugins`; None: those of `config`, else trc, c3d and csv.
        report: write joint angles, gait and the report of each trial.
        jobs: trials at once on this machine; None: as many as its cores and its free memory allow.
        scheduler: address of a Dask scheduler, e.g. ``tcp://host:8786``, to run the trials there (extra ``cluster``).
        config: settings file of every trial, on top of the ``posefuse.toml`` of each.
        settings: settings of every trial by dotted key, as in `track`.
        replace: make trials again that were completed with other settings or from other files.
        progress: True for bars on stderr, or a function (see `Progress`).

    Returns:
        The study: `Study.rows` is the table, `Study.failed` lists failures with reasons.

    Raises:
        InputError: no session below `study`, or no place for the results.
        ConfigError: a wrong setting or an unknown format.
        DependencyError: `scheduler` without the extra ``cluster``.

    Examples:
        >>> import posefuse as pf
        >>> study = pf.batch("STUDY", "RESULTS")  # doctest: +SKIP
        >>> study.failed  # doctest: +SKIP
        {}
    """
    from posefuse.detection.build import network_settings
    from posefuse.pipeline.batch import run_study

    changes, named = study_settings(config, network_settings(networks, device) | dict(settings or {}))
    with shown(progress) as reported:
        return run_study(
            Path(study),
            Path(out),
            formats=named if formats is None else tuple(formats),
            settings=changes,
            report=report,
            jobs=jobs,
            scheduler=scheduler,
            replace=replace,
            progress=reported,
        )


@checked
def study_settings(config: str | Path | None, settings: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Settings of every trial by dotted key, and the outputs that they name; raises ConfigError before any work."""
    from posefuse.pipeline.config import read_config, settings_by_key

    path = None if config is None else Path(config)
    read_config(path, settings)
    changes = {**settings_by_key(path), **settings}
    return changes, tuple(changes.pop("outputs", FORMATS))
