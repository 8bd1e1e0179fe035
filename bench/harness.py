"""What all benches share. A bench is a table of rows: `arguments` reads its command line, `answer` shows and writes its tables.

Sessions are rendered once (`rendered`) and tracked once per version of the code (`tracked`); `live` and `live_recording` play
one to `posefuse live`, `played` gives views to a tracker in simulated time, `errors` and `score` compare poses with the truth.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
for _folder in (ROOT, ROOT / "tools"):
    sys.path.insert(0, str(_folder)) if str(_folder) not in sys.path else None

from page_marks import made_by, markdown, write_between_marks  # noqa: E402

from posefuse.core import Detections2D, Kind, Observations, Pose3D, PoseSequence, Recording, Rig, Truth, ViewSequence  # noqa: E402
from posefuse.core.skeleton import PAPER14, pick_keypoints  # noqa: E402
from posefuse.evaluation.metrics import true_xyz_at  # noqa: E402
from posefuse.formats.recording import read_recording, write_recording  # noqa: E402
from posefuse.formats.truth import read_truth  # noqa: E402
from posefuse.foundation.parsing import plain  # noqa: E402
from posefuse.foundation.settings import settings_from_mapping  # noqa: E402
from posefuse.pipeline.config import TrackConfig, changed_config  # noqa: E402
from posefuse.pipeline.reading import read_result  # noqa: E402
from posefuse.pipeline.session import find_session  # noqa: E402
from posefuse.pipeline.track import track_session  # noqa: E402
from posefuse_sim.scene import Scene  # noqa: E402
from posefuse_sim.session import SessionPaths, simulate  # noqa: E402

DEMO, DATA, OUT = ROOT / "examples" / "demo", Path("../shared/data"), ROOT / "out" / "bench"
POSEFUSE = (sys.executable, "-m", "posefuse")
# joints of the paper's 14 that have a covariance of their own
JOINTS = tuple(joint for joint in PAPER14.keypoints if joint not in ("neck", "mid_hip"))
Row = Mapping[str, Any]


class Use(StrEnum):
    """What a scene may be used for: constants are fitted to it or chosen on it, or its figures are on a page of the docs."""

    FIT = "fit"
    DEVELOP = "develop"
    REPORT = "report"


# bodies that fits draw, also those of `posefuse_sim.fitting`
FITTED_BODIES = range(7000, 8200)


def checked(scene: Scene, use: Use) -> Scene:
    """The scene. A fit to a body that may be reported ends the program, and so does a report of a body that was fitted to."""
    for person in scene.people:
        seed = person.body.random_seed
        if use is not Use.DEVELOP and (seed in FITTED_BODIES) != (use is Use.FIT):
            drawn = f"{FITTED_BODIES.start} to {FITTED_BODIES.stop - 1}"
            raise SystemExit(f"body {seed} is not for a {use}: fits draw bodies {drawn}, reports others")
    return scene


def scene_from(content: Mapping[str, Any], use: Use = Use.REPORT) -> Scene:
    """A scene of its settings, see `checked`."""
    return checked(settings_from_mapping(content, Scene, where="bench"), use)


def rendered(scene: Scene, folder: Path, use: Use = Use.REPORT, processes: int | None = 1) -> Path:
    """The session of a scene, drawn unless it is there; one that was interrupted is continued."""
    checked(scene, use)
    if not SessionPaths(folder).truth.exists():
        simulate(scene, folder, processes=processes)
    return folder


def truth_of(session: Path) -> Truth:
    return read_truth(SessionPaths(session).truth)


def exact_poses(truth: Truth, t_ns: np.ndarray) -> PoseSequence:
    """The truth at times (T,) as poses that are hardly uncertain."""
    xyz = true_xyz_at(truth, t_ns)
    shape = xyz.shape[:3]
    cov, about = np.broadcast_to(np.eye(3) * 1e-10, (*shape, 3, 3)), {"skeleton": truth.skeleton, "person_id": truth.person_id}
    seen = {"reproj_px": np.zeros(shape), "n_views": np.full(shape, 4), "kind": np.ones(shape)}
    return PoseSequence(t_ns=t_ns, **about, xyz_world=xyz, cov_world=cov, **seen)


def retimed(log: Observations, frame: np.ndarray, step: np.ndarray, step_t_ns: np.ndarray) -> Observations:
    """Frames of a log at other time steps.

    Args:
        frame: (F,) rows of the log, which may come several times. step: (F,) time step that each is at now, see `step_t_ns` (T,).
    """
    rows = np.concatenate([np.arange(log.frame_begin[f], log.frame_begin[f + 1]) for f in frame])
    late_ns = (log.frame_t_ns - log.step_t_ns[log.frame_step])[frame]
    of_frames = {name: getattr(log, name)[frame] for name in ("frame_camera", "frame_look", "n_detections")}
    times = {"step_t_ns": step_t_ns, "frame_step": step, "frame_t_ns": step_t_ns[step] + late_ns}
    return replace(log, **of_frames, **times, person_id=log.person_id[rows], **log.rows(rows))


@cache
def code() -> str:
    """A digest of the source, so that what other code gave is not taken for what this code gives."""
    files = sorted(path for path in (ROOT / "src").rglob("*") if path.suffix in (".py", ".toml", ".npz"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]


def tracked(session: Path, **changes: Any) -> Recording:
    """What `posefuse track` makes of a session, kept by the session, the changes of settings (``fuse__weights``) and the code."""
    config = changed_config(TrackConfig(), {"outputs": {}, **{key.replace("__", "."): value for key, value in changes.items()}})
    about = json.dumps([str(session.resolve()), _stamps(session), plain(changes), code()], default=str)
    folder = OUT / "tracked" / f"{session.name}-{hashlib.sha256(about.encode()).hexdigest()[:16]}"
    if not (folder / "done").exists():
        done = track_session(find_session(session, config), config)
        folder.mkdir(parents=True, exist_ok=True)
        write_recording(folder, done.recording)
        (folder / "done").touch()
    return read_recording(folder)


def _stamps(session: Path) -> list[tuple[str, int, int]]:
    """Name, size and time of each file of a session."""
    found = ((str(path.relative_to(session)), path.stat()) for path in sorted(session.rglob("*")) if path.is_file())
    return [(name, stat.st_size, stat.st_mtime_ns) for name, stat in found]


def sources_of(session: Path) -> list[str]:
    """The videos of a session, for `posefuse live`."""
    return [f"{path.stem}=video:{path}" for path in sorted((session / "videos").glob("*.mp4"))]


def live_command(rig: Path, sources: Iterable[str], *options: object) -> list[str]:
    command = [*POSEFUSE, "live", str(rig), "--json", *map(str, options)]
    return [*command, *(word for source in sources for word in ("--source", source))]


def live(rig: Path, sources: Iterable[str], *options: object) -> dict[str, Any]:
    """Figures of one `posefuse live`."""
    done = subprocess.run(live_command(rig, sources, *options), check=True, capture_output=True)
    return json.loads(done.stdout)


def live_recording(session: Path, *options: object) -> tuple[Recording, dict[str, Any]]:
    """A session played to `posefuse live` and recorded, at the times of its files; and its figures."""
    with tempfile.TemporaryDirectory() as scratch:
        record = Path(scratch) / f"{session.name}.mcap"
        figures = live(session / "rig.toml", sources_of(session), "--record", record, *options)
        found = read_result(record)
    later_ns = found.provenance["start_ns"] - figures["zero_ns"]
    poses = replace(found.poses, t_ns=found.poses.t_ns + later_ns)
    log = replace(found.observations, frame_t_ns=found.observations.frame_t_ns + later_ns)
    return replace(found, poses=poses, observations=log), figures


def arrivals(views: ViewSequence, rig: Rig, late_ns: int = 0, own_name: Callable[[str], str] = str) -> Iterator[tuple[int, Any]]:
    """(ns of arrival, view) of every camera of a rig and time step. own_name: what a camera is called in the views."""
    for i, t_ns in enumerate(views.t_ns.tolist()):
        for name in rig.names:
            c = views.camera_names.index(own_name(name))
            parts = {part: getattr(views, part)[i, :, c] for part in ("xy_img", "score", "sigma_px")}
            box = np.full((len(views.person_id), 4), np.nan)
            yield t_ns + late_ns, Detections2D(camera=name, t_ns=t_ns, skeleton=views.skeleton, box_img=box, **parts)


def played(tracker: Any, come: Iterable[tuple[int, Detections2D]], times_ns: Iterable[int]) -> Iterator[Pose3D]:
    """The tracker's pose at each time, after all views that have arrived by then."""
    waiting = deque(come)
    for t_ns in times_ns:
        while waiting and waiting[0][0] <= t_ns:
            tracker.add(waiting.popleft()[1])
        yield tracker.at(t_ns)


def errors(poses: Sequence[Pose3D], truth: Truth, joints: Sequence[str] = JOINTS) -> np.ndarray:
    """(T, J, 3) m, of the first person at the time of each pose; NaN where a pose has no such joint or no person."""
    skeleton = poses[0].skeleton
    missing = np.full((len(skeleton), 3), np.nan)
    known = [np.where((p.kind[0] != Kind.MISSING)[:, None], p.xyz_world[0], np.nan) if len(p.kind) else missing for p in poses]
    true = true_xyz_at(truth, np.array([pose.t_ns for pose in poses]))[:, 0]
    return pick_keypoints(np.array(known), skeleton, joints) - pick_keypoints(true, truth.skeleton, joints)


def covariances(poses: Sequence[Pose3D], joints: Sequence[str] = JOINTS) -> np.ndarray:
    """(T, J, 3, 3) as stated for the first person."""
    at, missing = poses[0].skeleton.indices(joints), np.full((len(joints), 3, 3), np.nan)
    return np.array([pose.cov_world[0, at] if len(pose.person_id) else missing for pose in poses])


def score(error: np.ndarray, cov: np.ndarray | None = None) -> dict[str, float]:
    """Of errors (..., 3) m: mean and 95th percentile in mm, share that is known, and by covariances the NEES: 3 is honest."""
    found = np.isfinite(error).all(axis=-1)
    if not found.any():
        return {"found": 0.0}
    away_mm = 1000 * np.linalg.norm(error[found], axis=-1)
    row = {"mean_mm": float(away_mm.mean()), "p95_mm": float(np.percentile(away_mm, 95)), "found": float(found.mean())}
    if cov is not None:
        nees = np.einsum("ni,nij,nj->n", error[found], np.linalg.inv(cov[found]), error[found])
        row |= {"nees": float(nees.mean()), "nees_median": float(np.median(nees))}
    return row


def medians(runs: Sequence[Row], by: Callable[[Any], Any] = np.median) -> dict[str, float]:
    """Of each figure over runs; by: what is taken instead of the median."""
    return {name: float(by([run[name] for run in runs])) for name in runs[0]}


def arguments(doc: str | None, positional: Sequence[str] = (), **defaults: Any) -> argparse.Namespace:
    """The command line of a bench: an option of each name, or what is positional.

    Args:
        defaults: a value; a tuple of values (several are taken); a type, or a tuple of one type (None, or none, unless given);
            False (a switch); a dictionary (some of its keys, all unless given).
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (defaults | {"write": Path}).items():
        flag = name if name in positional else f"--{name.replace('_', '-')}"
        several = isinstance(default, tuple | dict)
        value = next(iter(default)) if several else default
        kept: Any = (() if several else None) if isinstance(value, type) else default
        if isinstance(default, bool):
            parser.add_argument(flag, action="store_true")
            continue
        kind = value if isinstance(value, type) else type(value)
        options: dict[str, Any] = {"choices": sorted(default)} if isinstance(default, dict) else {}
        options |= {"nargs": "*"} if several else {"nargs": "?"} if name in positional and kept is not None else {}
        parser.add_argument(flag, type=kind, default=list(kept) if several else kept, **options)
    return parser.parse_args()


def note(*words: object) -> None:
    """A line on stderr, at once."""
    print(*words, file=sys.stderr, flush=True)


def text(value: object) -> str:
    """A cell of a table."""
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {text(one)}" for name, one in value.items())
    return ", ".join(map(text, value)) if isinstance(value, list | tuple) else "" if value is None else str(value)


def columns_of(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row))


def show(title: str, rows: Sequence[Row]) -> None:
    """A table on stderr; one row stands upright."""
    if len(rows) == 1:
        rows = [{"": name, title: value} for name, value in rows[0].items()]
    table = Table(title=title, title_justify="left")
    for column in columns_of(rows):
        table.add_column(column)
    for row in rows:
        table.add_row(*(text(row.get(column)) for column in columns_of(rows)))
    Console(stderr=True, width=180).print(table)


def answer(args: argparse.Namespace, tables: Mapping[str, Sequence[Row]], mark: str = "", **facts: Any) -> None:
    """Tables by title on stderr, one JSON object on stdout, and, with ``--write``, between the marks of a page.

    Args:
        mark: name of the marks; that of the script unless stated.
    """
    for title, rows in tables.items():
        show(title, rows)
    print(json.dumps(plain({**facts, **tables}), indent=2))
    if args.write:
        words = [word for word in sys.argv[1:] if word not in ("--write", str(args.write))]
        parts = [made_by(" ".join(["python", f"bench/{Path(sys.argv[0]).name}", *words]))]
        for title, rows in tables.items():
            columns = columns_of(rows)
            parts.append(f"{title}\n\n{markdown(columns, ([text(row.get(name)) for name in columns] for row in rows))}")
        write_between_marks(args.write, "\n\n".join(parts), mark or Path(sys.argv[0]).stem)
