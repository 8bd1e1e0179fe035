"""The rig monitor on what the default network sees of people: what it finds, how soon, what it blames, and false alarms.

    python bench/rig_monitor.py [--fit] [--trials 6] [--data ../shared/data/pose2sim_single] [--cache out/rig_monitor]

Rendered walks and people who stand are looked at ten times a second by the network (kept in the cache; scenes are rendered
where `python -m paper` has not left them). Then, after some seconds, a camera is turned or moved, its clock is late, or two
cables are exchanged: every keypoint is displaced by what that does to its point in space, and keeps the network's error. `--fit`
does it for other bodies in other rooms, from which the constants are; it also prints the most that nothing wrong explains.
Seconds are of the data. Table on stderr, one JSON object on stdout.
"""

import argparse
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.interpolate import CubicSpline

from paper.scenes.scenes import half_hidden_scene, scene_name, static_scene, walking_scene
from posefuse.calibration.keypoints import limb_keypoints
from posefuse.core import SE3, Camera, Recording, Rig, Skeleton, Truth, Views
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.recording import read_recording, write_recording
from posefuse.formats.truth import read_truth
from posefuse.foundation.output_folder import output_folder
from posefuse.foundation.plain_values import plain
from posefuse.foundation.settings import settings_from_mapping
from posefuse.fusion import FuseSettings, fuse
from posefuse.health import rig_monitor as monitor
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.run import track_session
from posefuse.pipeline.session import find_session
from posefuse.simulation import SessionPaths, simulate
from posefuse.simulation.scene import Scene

SESSIONS = Path("out/paper/sessions")
RATE_HZ = 10.0
FAULT_AT_S, WATCHED_S, SAID_S, QUIET_S = 6.0, 16.0, 4.0, 60.0
LEAST_SCORE = 0.5


@dataclass(frozen=True)
class Fault:
    """What is done to a camera: its name in the table, how the monitor should call it, and how much of it."""

    name: str
    kind: str
    turn_deg: float = 0.0
    move_m: float = 0.0
    late_s: float = 0.0


FAULTS = (
    *(Fault(f"turned by {deg:g} deg", "moved", turn_deg=deg) for deg in (0.25, 0.5, 1.0, 2.0, 5.0)),
    *(Fault(f"moved by {100 * m:g} cm", "moved", move_m=m) for m in (0.01, 0.03, 0.1)),
    *(Fault(f"{1000 * s:g} ms late", "unsynchronised", late_s=s) for s in (0.02, 0.05, 0.1)),
    Fault("two exchanged", "swapped"),
)


@dataclass(frozen=True, eq=False)
class Clip:
    """Keypoints that the network saw, and where they were.

    Attributes:
        name: of the scene. rig: calibrated. t_s: (T,). xy_img: (T, C, K, 2), NaN where unseen.
        score, sigma_px: (T, C, K). xyz_world: (T, K, 3), NaN where unknown. skeleton: of these.
        true14_world: (T, 14, 3) of the paper's joints; None of real footage.
    """

    name: str
    rig: Rig
    t_s: np.ndarray
    xy_img: np.ndarray
    score: np.ndarray
    sigma_px: np.ndarray
    xyz_world: np.ndarray
    skeleton: Skeleton
    true14_world: np.ndarray | None

    def only(self, cameras: list[int], name: str) -> "Clip":
        rig = self.rig.only(self.rig.names[c] for c in cameras)
        parts = {part: getattr(self, part)[:, cameras] for part in ("xy_img", "score", "sigma_px")}
        return replace(self, name=name, rig=rig, **parts)

    def lasting(self, seconds: float, begin_s: float = 0.0) -> "Clip":
        """To and fro until it is long enough, so that no person jumps."""
        period_s = float(np.median(np.diff(self.t_s)))
        there = np.arange(len(self.t_s))
        both = np.concatenate([there, there[-2:0:-1]])
        take = both[(round(begin_s / period_s) + np.arange(round(seconds / period_s))) % len(both)]
        return replace(self, t_s=period_s * np.arange(len(take)), xy_img=self.xy_img[take], xyz_world=self.xyz_world[take])


def scenes(fit: bool) -> Iterator[tuple[str, Scene]]:
    """Bodies and rooms that constants are from, or those that are reported: walks, with occluders, and people who stand."""
    if fit:
        yield "walk 4", made(7190, 20.0, 4, 4.5, 66, walk(1.35))
        yield "walk 4 occluded", made(7191, 12.0, 4, 3.6, 72, walk(1.1), occluders=3)
        yield "walk 3 far", made(7192, 12.0, 3, 6.5, 60, walk(1.5))
        yield "walk 8", made(7193, 8.0, 8, 5.0, 62, walk(1.2))
        yield "stands 8", made(7194, 4.0, 8, 4.2, 64, {"kind": "idle"})
        return
    for seed, seconds in ((1, 60.0), (21, 12.0), (22, 12.0), (23, 12.0)):
        yield f"walk 4, body {seed}", walking_scene(seed, seconds)
    yield "walk 4 occluded, body 31", made(31, 12.0, 4, 4.5, 66, walk(1.35), occluders=4)
    yield "walk 8, body 32", made(32, 10.0, 8, 4.5, 60, walk(1.35))
    yield "stands 8, body 33", made(33, 4.0, 8, 4.5, 60, {"kind": "idle"})
    yield "T-pose 8 occluded, body 1", static_scene(True)
    yield "waves 4 half hidden, body 1", half_hidden_scene("screen")
    yield "waves 4 false arm, body 1", half_hidden_scene("false_arm")


def walk(speed_mps: float) -> dict:
    return {"kind": "walk", "speed_mps": speed_mps, "path": {"shape": "random", "low_m": [-1.6, -1.6], "high_m": [1.6, 1.6]}}


def made(seed: int, seconds: float, cameras: int, radius_m: float, fov_deg: float, motion: dict, occluders: int = 0) -> Scene:
    clutter = {"kind": "clutter", "count": occluders, "area_m": [5.0, 5.0], "keep_clear_m": 1.2, "most_height_m": 1.5}
    content = {
        "duration_s": seconds,
        "rate_hz": RATE_HZ,
        "seed": seed,
        "cameras": {
            "kind": "ring",
            "count": cameras,
            "radius_m": radius_m,
            "height_m": 2.2,
            "image": {"size_px": [640, 480], "horizontal_fov_deg": fov_deg},
        },
        "people": [{"body": {"random_seed": seed}, "motion": motion}],
        "occluders": [clutter] if occluders else [],
    }
    return settings_from_mapping(content, Scene, where="rig monitor")


def clip_of_scene(name: str, scene: Scene, cache: Path) -> Clip:
    folder = scene_name(name.split(",")[0].replace(" ", "-"), scene)
    kinds = (f"walking-{scene.seed}", f"static-occluded-{scene.seed}", "occlusion-screen", "occlusion-false_arm")
    kept = [SESSIONS / scene_name(kind, scene) for kind in kinds]
    session = next((path for path in kept if path.is_dir()), cache / "sessions" / folder)
    paths = SessionPaths(session)
    if not paths.rig.exists() or paths.incomplete.exists():
        simulate(scene, session, processes=1)
    return clip_of_session(name, session, cache / folder)


def clip_of_session(name: str, session: Path, cache: Path) -> Clip:
    """2D poses as the pipeline for recordings has them, made once."""
    if not cache.exists():
        config = replace(TrackConfig(), rate_hz=RATE_HZ, joint_centres=False, outputs={})
        done = track_session(find_session(session, config), config, StageClock(), *3 * [lambda *_: None])
        cache.parent.mkdir(parents=True, exist_ok=True)
        with output_folder(cache, command="bench rig_monitor") as made:
            folder = made.folder
            write_recording(folder, done.recording)
    truth = session / "truth" / "truth.npz"
    return clip_of(name, read_recording(cache), read_truth(truth) if truth.is_file() else None)


def clip_of(name: str, recording: Recording, truth: Truth | None) -> Clip:
    poses, true14 = recording.poses, None
    xy = np.where((recording.views.score[:, 0] >= LEAST_SCORE)[..., None], recording.views.xy_img[:, 0], np.nan)
    if truth is not None:
        true14 = pick_keypoints(true_xyz_at(truth, poses.t_ns)[:, 0], truth.skeleton, PAPER14.keypoints)
    views = (xy, recording.views.score[:, 0], recording.views.sigma_px[:, 0])
    return Clip(name, recording.rig, (poses.t_ns - poses.t_ns[0]) / 1e9, *views, poses.xyz_world[:, 0], poses.skeleton, true14)


def disturbed(
    clip: Clip, fault: Fault, rng: np.random.Generator, from_s: float = FAULT_AT_S
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Keypoints with the fault from then on, and the cameras that have it."""
    bad = clip.t_s >= from_s
    a, b = rng.permutation(len(clip.rig))[:2]
    xy = clip.xy_img.copy()
    if fault.kind == "swapped":
        xy[np.ix_(bad, [a, b])] = clip.xy_img[np.ix_(bad, [b, a])]
        return xy, tuple(sorted((clip.rig.names[a], clip.rig.names[b])))
    camera = clip.rig.cameras[a]
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    seen = later(clip, fault.late_s) if fault.late_s else clip.xyz_world
    after = bumped(camera, np.deg2rad(fault.turn_deg) * axis, fault.move_m * axis)
    xy[:, a] += np.where(bad[:, None, None], after.project(seen) - camera.project(clip.xyz_world), 0.0)
    return xy, (camera.name,)


def bumped(camera: Camera, turn_rad: np.ndarray, move_m: np.ndarray) -> Camera:
    return replace(camera, cam_from_world=SE3.from_rotvec(turn_rad, move_m) @ camera.cam_from_world)


def later(clip: Clip, late_s: float) -> np.ndarray:
    """(T, K, 3) where points were `late_s` before."""
    out = np.full(clip.xyz_world.shape, np.nan)
    for k in range(out.shape[1]):
        known = np.isfinite(clip.xyz_world[:, k, 0])
        if known.sum() > 3:
            out[known, k] = CubicSpline(clip.t_s[known], clip.xyz_world[known, k])(clip.t_s[known] - late_s)
    return out


def findings(clip: Clip, xy: np.ndarray, after_s: float) -> list[monitor.RigFinding]:
    """Findings of the monitor for keypoints (T, C, K, 2); it stops some time after the first finding after `after_s`."""
    chosen = limb_keypoints(clip.skeleton.keypoints)
    state, found = monitor.new_monitor_state(clip.rig), []
    for t_s, seen in zip(clip.t_s.tolist(), xy[:, :, chosen], strict=True):
        if any(after_s * 1e9 <= one.t_ns < (t_s - SAID_S) * 1e9 for one in found):
            break
        state, new = monitor.observe(state, clip.rig, round(t_s * 1e9), seen)
        found += new
    return found


def trial(clip: Clip, fault: Fault, number: int) -> dict:
    """One fault in one clip: seconds until the first finding, and whether camera and kind are right."""
    rng = np.random.default_rng([number, FAULTS.index(fault)])
    long = clip.lasting(FAULT_AT_S + WATCHED_S, float(rng.uniform(0, clip.t_s[-1])))
    xy, cameras = disturbed(long, fault, rng)
    found = [one for one in findings(long, xy, FAULT_AT_S) if one.t_ns >= FAULT_AT_S * 1e9]
    if not found:
        return {"found": False}
    first = found[0]
    right = set(cameras) <= set(first.cameras) if fault.kind == "swapped" else first.cameras == cameras
    others = any(not set(one.cameras) <= set(first.cameras if right else cameras) for one in found)
    seconds = first.t_ns / 1e9 - FAULT_AT_S
    return {"found": True, "seconds": seconds, "camera": right, "kind": first.kind == fault.kind, "others": others}


def rows_of(clips: list[Clip], trials: int) -> list[dict]:
    rows = []
    for fault in FAULTS:
        done = [trial(clip, fault, number) for clip in clips for number in range(trials)]
        found = [one for one in done if one["found"]]
        seconds = [one["seconds"] for one in found]
        rows.append(
            {
                "fault": fault.name,
                "trials": len(done),
                "found": len(found) / len(done),
                "seconds_median": float(np.median(seconds)) if found else None,
                "seconds_most": float(np.max(seconds)) if found else None,
                "right_camera": sum(one["camera"] for one in found) / len(found) if found else None,
                "right_kind": sum(one["kind"] for one in found) / len(found) if found else None,
                "others_blamed": sum(one["others"] for one in found) / len(found) if found else None,
            }
        )
    return rows


def used_or_left_out(clips: list[Clip]) -> list[dict]:
    """Mean error of the fused 14 joints in mm while something is wrong with a camera: its views used as ever, or left out."""
    rows = []
    for cameras in (4, 3):
        few = [clip.only(list(range(cameras)), clip.name) for clip in clips if len(clip.rig) == 4]
        without = {clip.name: [error_mm(clip, clip.xy_img, c) for c in range(cameras)] for clip in few}
        right = {"cameras": cameras, "fault": "none", "displaced_mm": 0.0}
        rows.append(right | {"used": mean(error_mm(clip, clip.xy_img) for clip in few), "left_out": None})
        for fault in (one for one in FAULTS if one.kind != "swapped"):
            used, left_out, displaced = [], [], []
            for number, clip in enumerate(few):
                xy, [name] = disturbed(clip, fault, np.random.default_rng([number, FAULTS.index(fault)]), -np.inf)
                c = clip.rig.names.index(name)
                used.append(error_mm(clip, xy))
                left_out.append(without[clip.name][c])
                displaced.append(displaced_mm(clip, xy, c))
            row = {"cameras": cameras, "fault": fault.name, "displaced_mm": mean(displaced)}
            rows.append(row | {"used": mean(used), "left_out": mean(left_out)})
    return rows


def mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def displaced_mm(clip: Clip, xy_img: np.ndarray, c: int) -> float:
    """By how much a camera's view of the person was moved, at the person; rms."""
    camera = clip.rig.cameras[c]
    apart = (camera.norm_from_px(xy_img[:, c]) - camera.norm_from_px(clip.xy_img[:, c])) * camera.depth(clip.xyz_world)[..., None]
    return 1e3 * float(np.sqrt(np.nanmean((apart**2).sum(axis=-1))))


def error_mm(clip: Clip, xy_img: np.ndarray, left_out: int | None = None) -> float:
    """Of the robust fusion of every fifth time step."""
    assert clip.true14_world is not None
    score = np.where(np.isfinite(xy_img[..., 0]), clip.score, 0.0)
    if left_out is not None:
        score[:, left_out] = 0.0
    apart = []
    for i in range(0, len(clip.t_s), 5):
        views = Views(
            t_ns=i,
            skeleton=clip.skeleton,
            camera_names=clip.rig.names,
            person_id=np.zeros(1, np.int64),
            xy_img=np.where((score[i] > 0)[..., None], xy_img[i], np.nan)[None],
            score=score[i][None],
            sigma_px=clip.sigma_px[i][None],
        )
        pose = fuse(views, clip.rig, FuseSettings())
        got = pick_keypoints(pose.xyz_world[0], clip.skeleton, PAPER14.keypoints)
        apart.append(np.linalg.norm(got - clip.true14_world[i], axis=-1))
    return 1e3 * float(np.nanmean(apart))


def quiet(clip: Clip) -> dict:
    """False alarms of a clip with nothing wrong."""
    long = clip.lasting(QUIET_S)
    found = findings(long, long.xy_img, np.inf)
    details = [f"{one.t_ns / 1e9:.0f} s: {one.detail}" for one in found]
    return {"clip": clip.name, "cameras": len(clip.rig), "minutes": QUIET_S / 60, "alarms": len(found), "details": details}


def explained_by_nothing(clip: Clip) -> dict:
    """The most that a turn and a lateness of any camera explain with nothing wrong, in each memory."""
    long, chosen, most = clip.lasting(QUIET_S), limb_keypoints(clip.skeleton.keypoints), {}
    state = monitor.new_monitor_state(clip.rig)
    for i, (t_s, seen) in enumerate(zip(long.t_s.tolist(), long.xy_img[:, :, chosen], strict=True)):
        state, _ = monitor.observe(state, clip.rig, round(t_s * 1e9), seen)
        if t_s > FAULT_AT_S and i % 3 == 0:
            for memory_s, sums in zip(monitor.MEMORIES_S, state.sums, strict=True):
                for one in monitor.suspects(sums):
                    for what, value in (
                        (f"{one.kind}, {memory_s:g} s", one.sure),
                        (f"mm, {memory_s:g} s", 1e3 * one.displaced_m),
                    ):
                        most[what] = max(most.get(what, 0.0), value)
    return {"clip": clip.name, **most}


def show(rows: list[dict], title: str) -> None:
    table = Table(*rows[0], title=title)
    for row in rows:
        cells = (f"{v:.2f}" if isinstance(v, float) else "; ".join(v) if isinstance(v, list) else str(v) for v in row.values())
        table.add_row(*("" if cell == "None" else cell for cell in cells))
    Console(stderr=True, width=190).print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fit", action="store_true", help="bodies and rooms that constants are from")
    parser.add_argument("--trials", type=int, default=6, help="per fault and clip")
    parser.add_argument("--data", type=Path, default=Path("../shared/data/pose2sim_single"))
    parser.add_argument("--cache", type=Path, default=Path("out/rig_monitor"))
    args = parser.parse_args()
    clips = [clip_of_scene(name, scene, args.cache) for name, scene in scenes(args.fit)]
    clips += [clip.only([0, 2, 4, 6], clip.name.replace("8", "4 of 8", 1)) for clip in clips if len(clip.rig) == 8]
    still = list(clips)
    if not args.fit and args.data.is_dir():
        still.append(clip_of_session("pose2sim_single (real)", args.data, args.cache / "pose2sim_single"))
    alarms = [quiet(clip) for clip in still]
    if args.fit:
        show([explained_by_nothing(clip) for clip in clips], "Most that is explained with nothing wrong")
    walks = [clip for clip in clips if "walk" in clip.name]
    matters = used_or_left_out(walks)
    rows = rows_of(walks, args.trials)
    show(alarms, "Nothing wrong")
    show(rows, "Faults, people who walk")
    show(matters, "Error of the fused joints in mm while something is wrong with one camera")
    print(json.dumps(plain({"fit": args.fit, "faults": rows, "nothing_wrong": alarms, "used_or_left_out": matters}), indent=2))


if __name__ == "__main__":
    main()
