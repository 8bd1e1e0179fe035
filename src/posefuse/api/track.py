"""Recordings to 3D: `posefuse.track`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from posefuse.core import InputError, Progress
from posefuse.fusion.settings import Weights

from .arguments import checked
from .progress import shown
from .recording import Recording, recording_of


@checked
def track(
    session: str | Path,
    *,
    people: int | None = None,
    rig: str | Path | None = None,
    networks: str | None = None,
    weights: Weights | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    out: str | Path | None = None,
    formats: Sequence[str] | None = None,
    resume: bool = False,
    replace: bool = False,
    settings: Mapping[str, Any] | None = None,
    progress: Progress | bool | None = None,
) -> Recording:
    """Detect, associate, fuse and smooth the people of a session folder.

    Args:
        session: folder with a calibration file and one video, image folder or folder of 2D poses per camera. Its
            ``posefuse.toml`` is read if it exists; the arguments take precedence over it.
        people: follow at most this many.
        rig: another calibration file.
        networks: name of the 2D networks, e.g. ``blazepose_lite``, or a model card (TOML).
        weights: how views are weighted: ``robust`` (default), ``score``, ``none``, ``all``.
        start_s: begin at this time of the session, in seconds.
        end_s: end at this time of the session, in seconds.
        out: folder to write the result to. The detections are kept there while they are made, so that an interruption loses
            nothing.
        formats: outputs to write there, e.g. ``("trc", "c3d")``; see `posefuse plugins`. None: those that ``posefuse.toml``
            names, else none.
        resume: continue the interrupted work of `out`.
        replace: move an earlier result that is there to ``NAME.replaced-TIME``.
        settings: any other setting by dotted key, e.g. ``{"smooth.cutoff_hz": 8}``.
        progress: True for bars on stderr, or a function (see `Progress`).

    Returns:
        The recording; `Recording.save` writes it. A problem that does not stop the work (a camera that breaks off, was moved or
        is not synchronised, an output that cannot be written) is a `UserWarning`.

    Raises:
        KeyboardInterrupt: Ctrl-C; the detections stay in `out`, if it was given.
        PosefuseError: anything that leaves fewer than two usable cameras or no person to follow; the message names the next step.

    Examples:
        >>> import posefuse as pf
        >>> recording = pf.track("examples/demo", end_s=0.5)  # doctest: +SKIP
        >>> recording.save("RESULT", formats=("trc", "c3d"))  # doctest: +SKIP
    """
    from posefuse.detection.build import fetch_networks, network_settings
    from posefuse.pipeline.clock import StageClock
    from posefuse.pipeline.config import CONFIG_FILE, changed_config, read_config
    from posefuse.pipeline.result_folder import ResultFolder, check_result_folder, track_into
    from posefuse.pipeline.run import track_session
    from posefuse.pipeline.session import find_session

    if out is None and (resume or replace or formats):
        raise InputError("track: resume, replace and formats are about the folder `out`, which was not given")
    folder = Path(session)
    path = folder / CONFIG_FILE
    options = {
        "rig": None if rig is None else str(Path(rig).absolute()),
        "associate.max_people": people,
        "fuse.weights": weights,
        "start_s": start_s,
        "end_s": end_s,
        "outputs": None if formats is None else tuple(formats),
    }
    changes = {key: value for key, value in options.items() if value is not None}
    changes |= (network_settings(networks) if networks else {}) | dict(settings or {})
    config = changed_config(read_config(path if path.is_file() else None, base={"outputs": ()}), changes)
    with shown(progress) as report:
        found = find_session(folder, config)
        note = lambda line: report("detect", 0, None, line)  # noqa: E731
        where = None if out is None else ResultFolder(path=Path(out), force=replace, resume=resume)
        if where is not None:
            check_result_folder(found, config, where)
        for line in found.notes:
            _warn(line)
        if found.inputs[0].kind != "pose2d":
            fetch_networks(config.detector, report)
        if where is not None:
            tracked = track_into(found, config, where, StageClock(), report, _warn, solve_interrupted=False)
        else:
            steps = lambda done, total: report("detect", done, total)  # noqa: E731
            tracked = track_session(found, config, StageClock(), steps, note, _warn, solve_interrupted=False)
    return recording_of(tracked.recording)


def _warn(line: str) -> None:
    warnings.warn(line, UserWarning, stacklevel=2)
