"""What `posefuse compare` does around the comparison: files of several systems to named tracks, a page, figures."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from posefuse.evaluation.compare import Comparison, Tracks, compare, middle_of
<<<<<<< HEAD
from posefuse.formats.c3d import read_c3d
from posefuse.formats.points_csv import read_points_csv
from posefuse.formats.trc import read_trc
=======
from posefuse.evaluation.tracks import read_tracks
from posefuse.formats.page import Facts, Heading, Line, Page, Plot, Plots, Table, write_page
>>>>>>> main
from posefuse.foundation.output_folder import check_replaceable, output_folder
from posefuse.foundation.places import check_apart
from posefuse.foundation.plain_values import plain
from posefuse.pipeline.reading import read_result

from .terminal import Terminal

<<<<<<< HEAD
KINDS = "a posefuse result folder, .mcap (posefuse live), .trc, .c3d, .csv or .mvnx"
# the segment of an MVNX file whose origin is this joint
_MVNX = {
    "pelvis": "mid_hip", "neck": "neck", "head": "head",
    **{f"{side}{segment}": f"{side}_{joint}" for side in ("left", "right") for segment, joint in (
        ("upperarm", "shoulder"), ("forearm", "elbow"), ("hand", "wrist"),
        ("upperleg", "hip"), ("lowerleg", "knee"), ("foot", "ankle"), ("toe", "big_toe"),
    )},
}  # fmt: skip
_SYNONYMS = {"hip": "mid_hip", "hips": "mid_hip", "left_foot_index": "left_big_toe", "right_foot_index": "right_big_toe"}
_ALIGN_FOR_DRIFT_S = 2.0
# nothing that is compared is farther from its origin or lasts longer; damaged numbers are
_FARTHEST_M = 10_000.0
_LONGEST_S = 21_600.0

=======
>>>>>>> main

def compare_files(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Compare two recordings, write the page, show the figures."""
    if args.out:
        check_apart(args.out, (args.a, args.b))
        check_replaceable(args.out, command="compare", replace=True)
    a, b = read_tracks(args.a, args.person), read_tracks(args.b, args.person)
    found = compare(a, b, time=not args.no_time, space=not args.no_space, scale=args.scale, start_s=args.align_first)
    figures = _figures(found)
    rows = [[point.replace("_", " "), *row.values()] for point, row in figures["points"].items()]
    terminal.facts("Alignment of the second onto the first", _facts(found))
    terminal.table("Distances, mm", ["point", "mean", "sd", "median", "p95", "share compared"], rows)
    if args.out:
        # its own, unchanged, can be made again at any time: replaced without being asked
        with output_folder(args.out, command="compare", inputs=(args.a, args.b), replace=True, warn=terminal.warn) as out:
            write_page(out.folder / "compare.html", comparison_page(a, b, found, rows))
            (out.folder / "compare.json").write_text(json.dumps(plain(figures), indent=2) + "\n", encoding="utf-8")
        page = args.out / "compare.html"
        terminal.note(f"written: {page}")
        terminal.next(f"open {page} in a browser", "every point over time, and the drift")
    else:
        terminal.next("the same with --out DIR", "a page with every point over time, and compare.json")
    return figures


<<<<<<< HEAD
def read_tracks(path: Path, person: int | None = None) -> Tracks:
    """Named points of one person (default: the one seen longest) from a file or result folder.

    Raises:
        InputError: no such file, a kind that is not read, or no such person.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_dir():
        return _from_recording(path, person)
    readers = {".trc": _from_trc, ".c3d": _from_c3d, ".csv": _from_csv, ".mvnx": _from_mvnx, ".mcap": _from_recording}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path}: cannot be compared; expected {KINDS}")
    return reader(path, person)


def plain_name(name: str) -> str:
    """One spelling for all systems: ``RShoulder``, ``jRightShoulder`` and ``right shoulder`` are right_shoulder."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|[\s.\-]+", "_", name.strip().split(":")[-1])
    words = re.sub(r"^([RL])(?=[A-Z][a-z])", r"\1_", words).strip("_").lower().removeprefix("j_")
    words = re.sub(r"^r_", "right_", re.sub(r"^l_", "left_", words))
    words = re.sub(r"^(.*)_(right|left)$", r"\2_\1", words)
    return _SYNONYMS.get(words, words)


def _tracks(path: Path, names: list[str] | tuple[str, ...], t_s: Array, xyz_m: Array) -> Tracks:
    points = [plain_name(name) for name in names]
    middles = {"neck": ("left_shoulder", "right_shoulder"), "mid_hip": ("left_hip", "right_hip")}
    for name, (one, two) in middles.items():
        if name not in points and one in points and two in points:
            middle = (xyz_m[:, points.index(one)] + xyz_m[:, points.index(two)]) / 2
            xyz_m, points = np.concatenate([xyz_m, middle[:, None]], axis=1), [*points, name]
    known = np.isfinite(xyz_m).all(axis=-1)
    if not known.any():
        raise InputError(f"{path}: no point is known at any time: every coordinate is missing")
    if not (np.isfinite(t_s).all() and (np.diff(t_s) > 0).all()):
        raise InputError(f"{path}: expected increasing times in seconds")
    if np.abs(xyz_m[known]).max() > _FARTHEST_M or t_s[-1] - t_s[0] > _LONGEST_S:
        raise InputError(
            f"{path}: expected points within {_FARTHEST_M:g} m and {_LONGEST_S:g} s, got {np.abs(xyz_m[known]).max():.3g} m "
            f"and {t_s[-1] - t_s[0]:.3g} s; is the file damaged, or in other units?"
        )
    return Tracks(path.name, tuple(points), t_s, xyz_m)


def _from_recording(path: Path, person: int | None) -> Tracks:
    poses = read_result(path).poses
    seen = np.isfinite(poses.xyz_world[..., 0]).sum(axis=(0, 2))
    if person is not None and person not in poses.person_id:
        raise InputError(f"{path}: no person {person}; there are: {', '.join(map(str, poses.person_id))}")
    n = int(np.argmax(seen)) if person is None else int(np.flatnonzero(poses.person_id == person)[0])
    return _tracks(path, poses.skeleton.keypoints, poses.t_ns / 1e9, poses.xyz_world[:, n])


def _from_trc(path: Path, _: int | None) -> Tracks:
    data = read_trc(path)
    return _tracks(path, data.names, data.t_s, data.xyz_world)


def _from_c3d(path: Path, _: int | None) -> Tracks:
    data = read_c3d(path)
    return _tracks(path, data.names, np.arange(len(data.xyz_world)) / data.rate_hz, data.xyz_world)


def _from_csv(path: Path, person: int | None) -> Tracks:
    data = read_points_csv(path, person)
    return _tracks(path, data.names, data.t_s, data.xyz_m)


def _from_mvnx(path: Path, _: int | None) -> Tracks:
    """Xsens MVNX: the origins of segments are joint centres; metres, Z up."""
    labels: list[str] = []
    times, positions = [], []
    try:
        for _event, element in ET.iterparse(path):
            tag = element.tag.rpartition("}")[2]
            if tag == "segment" and element.get("label"):
                labels.append(str(element.get("label")))
            elif tag == "frame":
                text = next((child.text for child in element if child.tag.rpartition("}")[2] == "position"), None)
                if element.get("type") == "normal" and text:
                    times.append(float(element.get("time", "nan")) / 1000)
                    positions.append([float(number) for number in text.split()])
                element.clear()
    except (ET.ParseError, ValueError, OSError, RecursionError) as error:
        raise InputError(f"{path}: not an MVNX file ({' '.join(str(error).split())})") from None
    if not positions or {len(row) for row in positions} != {3 * len(labels)}:
        raise InputError(f"{path}: expected frames with a position of each of {len(labels)} segments")
    known = [(i, _MVNX[label.lower()]) for i, label in enumerate(labels) if label.lower() in _MVNX]
    if not known:
        raise InputError(f"{path}: expected segments such as {choices(list(_MVNX)[:4])}, got {choices(labels[:8])}")
    xyz = np.array(positions).reshape(len(times), -1, 3)[:, [i for i, _name in known]]
    return _tracks(path, [name for _i, name in known], np.array(times), xyz)


=======
>>>>>>> main
def _facts(found: Comparison) -> dict[str, Any]:
    turn = np.degrees(np.arccos(np.clip((np.trace(found.alignment.rotation) - 1) / 2, -1, 1)))
    return {
        "offset in time": f"{1000 * found.alignment.offset_s:.1f} ms",
        "turned by": f"{turn:.2f} deg",
        "moved by": f"{np.linalg.norm(found.alignment.shift_m):.3f} m",
        "scale": f"{found.alignment.scale:.4f}",
        "mean distance": f"{found.errors.mpjpe_mm:.1f} mm over {len(found.points)} points",
        "drift": f"{found.drift_mm_per_m:.1f} mm per m over {found.walked_m[-1]:.1f} m walked",
    }


def _figures(found: Comparison) -> dict[str, Any]:
    errors = found.errors
    return {
        "offset_s": found.alignment.offset_s,
        "rotation": found.alignment.rotation.tolist(),
        "shift_m": found.alignment.shift_m.tolist(),
        "scale": found.alignment.scale,
        "residual_mm": 1000 * found.alignment.residual_m,
        "mean_mm": errors.mpjpe_mm,
        "drift_mm_per_m": found.drift_mm_per_m,
        "walked_m": float(found.walked_m[-1]),
        "points": {
            point: {
                "mean_mm": float(errors.mean_mm[k]),
                "sd_mm": float(errors.sd_mm[k]),
                "median_mm": float(errors.median_mm[k]),
                "p95_mm": float(errors.p95_mm[k]),
                "found": float(errors.found[k]),
            }
            for k, point in enumerate(found.points)
        },
    }


def comparison_page(a: Tracks, b: Tracks, found: Comparison, rows: list[list[Any]]) -> Page:
    """Alignment, distances, drift and every point over time."""
    t_s = found.t_s - found.t_s[0]
    both = np.isfinite(found.a_m) & np.isfinite(found.b_m)
    middle = [middle_of(np.where(both, one, np.nan)) for one in (found.a_m, found.b_m)]
    apart = Line("apart", found.walked_m, 1000 * found.apart_m)
    paths = [Line(name, m[:, 0], m[:, 1]) for name, m in zip((a.name, b.name), middle, strict=True)]
    points = [
        Plot(
            f"{point.replace('_', ' ')}, {axis}",
            [Line(a.name, t_s, found.a_m[:, k, i]), Line(b.name, t_s, found.b_m[:, k, i])],
            x_label="s", y_label="m",
        )
        for k, point in enumerate(found.points)
        for i, axis in enumerate("xyz")
    ]  # fmt: skip
    return Page(
        f"{b.name} compared with {a.name}",
        [
            Heading("Alignment", f"{b.name} is aligned to {a.name}."),
            Facts(_facts(found)),
            Heading("Distances"),
            Table(["point", "mean mm", "sd mm", "median mm", "p95 mm", "share compared"], rows),
            Heading("Drift", "Horizontal distance between the means of all points."),
            Plots(
                [
                    Plot("Along the path", [apart], x_label="distance walked, m", y_label="mm", from_zero=True),
                    Plot("From above", paths, x_label="x, m", y_label="y, m", equal=True),
                ]
            ),
            Heading("Points over time"),
            Plots(points, small=True),
        ],
    )
