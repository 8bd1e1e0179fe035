"""The rig monitor on what the default network sees of people: what it finds, how soon, what it blames, and false alarms.

    python bench/rig_monitor.py [--fit] [--trials 6] [--data ../shared/data] [--cache out/rig_monitor]
    python bench/rig_monitor.py --track [--seeds 100 ...] [--seconds 2 10 60] [--goods 100] [--write docs/reliability.md]

Rendered walks and people who stand are looked at ten times a second by the network; scenes are kept in the cache. Then, after
some seconds, the rig is one of which a camera is turned or moved, a camera's keypoints are late, or those of two are swapped.
`--fit` does it for other bodies in other rooms, from which the constants are; it also prints the most that no fault explains.
Seconds are of the data. Table on stderr, one JSON object on stdout.

`--track` asks what `track` answers to a rig that is wrong from the beginning: real footage (two detectors, two rooms) and the
demo clip are solved with rigs of which a camera is turned, two are swapped, one is late, or all stand elsewhere; and with the
right rig: sections of the clips, three or four of the cameras. Limits are from seeds below 100.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path

import numpy as np
from harness import DATA, DEMO, FITTED_BODIES, Row, Use, answer, arguments, note, rendered, retimed, scene_from, text, tracked
from scenes import walk as random_walk
from scipy.interpolate import interp1d

from paper.scenes.scenes import half_hidden_scene, ring, scene_name, static_scene, walking_scene
from posefuse.calibration.clocks.person_tracks import MIN_SCORE, limb_keypoints
from posefuse.core import SE3, InputError, Observations, Recording, Rig
from posefuse.health import rig_monitor as monitor
from posefuse.health.recorded import UNFIT, checked_rig
from posefuse.health.rig_monitor import RigFinding
from posefuse.pipeline.solve import solve
from posefuse_sim.cameras import looking_at
from posefuse_sim.scene import Scene

RATE_HZ = 10.0
FAULT_AT_S, WATCHED_S, SAID_S, QUIET_S = 6.0, 16.0, 4.0, 60.0


@dataclass(frozen=True)
class Fault:
    """What is wrong with a camera: its name in the table, how it should be called, and how much of it.

    Attributes:
        late_s, late_frames: of its clock; `roll`: how much of a turn is about the optical axis.
    """

    name: str
    kind: str
    turn_deg: float = 0.0
    move_m: float = 0.0
    late_s: float = 0.0
    late_frames: int = 0
    roll: float = 1.0


FAULTS = (
    *(Fault(f"turned by {deg:g} deg", monitor.MOVED, turn_deg=deg) for deg in (0.25, 0.5, 1.0, 2.0, 5.0)),
    *(Fault(f"moved by {100 * m:g} cm", monitor.MOVED, move_m=m) for m in (0.01, 0.03, 0.1)),
    *(Fault(f"{1000 * s:g} ms late", monitor.UNSYNCHRONISED, late_s=s) for s in (0.02, 0.05, 0.1)),
    Fault("two swapped", monitor.SWAPPED),
)
# from the beginning of a recording
WRONG = (
    *(Fault(f"turned by {deg} deg", monitor.MOVED, turn_deg=deg, roll=0.3) for deg in (3, 5, 10)),
    Fault("two swapped", monitor.SWAPPED),
    *(Fault(f"{frames} frames late", monitor.UNSYNCHRONISED, late_frames=frames) for frames in (5, 10)),
    Fault("another rig", UNFIT),
)


@dataclass(frozen=True, eq=False)
class Clip:
    """Keypoints (T, C, K, 2) of limbs that the network saw of a person, NaN where unseen, at times (T,)."""

    name: str
    rig: Rig
    t_s: np.ndarray
    xy_img: np.ndarray

    def only(self, cameras: list[int], name: str) -> "Clip":
        return Clip(name, self.rig.only(self.rig.names[c] for c in cameras), self.t_s, self.xy_img[:, cameras])

    def lasting(self, seconds: float, begin_s: float = 0.0) -> "Clip":
        """To and fro until it is long enough, so that no person jumps."""
        period_s = float(np.median(np.diff(self.t_s)))
        there = np.arange(len(self.t_s))
        both = np.concatenate([there, there[-2:0:-1]])
        take = both[(round(begin_s / period_s) + np.arange(round(seconds / period_s))) % len(both)]
        return Clip(self.name, self.rig, period_s * np.arange(len(take)), self.xy_img[take])


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
    return random_walk({"shape": "random", "low_m": [-1.6, -1.6], "high_m": [1.6, 1.6]}, speed_mps)


def made(seed: int, seconds: float, cameras: int, radius_m: float, fov_deg: float, motion: dict, occluders: int = 0) -> Scene:
    clutter = {"kind": "clutter", "count": occluders, "area_m": [5.0, 5.0], "keep_clear_m": 1.2, "most_height_m": 1.5}
    content = {
        "duration_s": seconds,
        "rate_hz": RATE_HZ,
        "seed": seed,
        "cameras": ring(cameras, fov_deg) | {"radius_m": radius_m},
        "people": [{"body": {"random_seed": seed}, "motion": motion}],
        "occluders": [clutter] if occluders else [],
    }
    return scene_from(content, Use.FIT if seed in FITTED_BODIES else Use.REPORT)


def clip_of_scene(name: str, scene: Scene, cache: Path) -> Clip:
    session = cache / "sessions" / scene_name(name.split(",")[0].replace(" ", "-"), scene)
    return clip_of_session(name, rendered(scene, session, Use.FIT if scene.seed in FITTED_BODIES else Use.REPORT))


def clip_of_session(name: str, session: Path) -> Clip:
    """2D poses as the pipeline for recordings has them."""
    recording = tracked(session, rate_hz=RATE_HZ, joint_centres=False)
    t_ns, views = recording.poses.t_ns, recording.views
    xy = np.where((views.score >= MIN_SCORE)[..., None], views.xy_img, np.nan)[:, 0, :, limb_keypoints(views.skeleton.keypoints)]
    return Clip(name, recording.rig, (t_ns - t_ns[0]) / 1e9, np.moveaxis(xy, 0, 2))


def wrong_rig(rig: Rig, fault: Fault, rng: np.random.Generator) -> tuple[Rig, tuple[str, ...]]:
    """The rig with a fault of the cameras' places or names, and the cameras that are to be named."""
    cameras, a = list(rig.cameras), int(rng.integers(len(rig)))
    if fault.kind == monitor.SWAPPED:
        pairs = [pair for pair in combinations(range(len(rig)), 2) if cameras[pair[0]].size_wh == cameras[pair[1]].size_wh]
        a, b = pairs[rng.integers(len(pairs))]
        cameras[a], cameras[b] = replace(cameras[b], name=rig.names[a]), replace(cameras[a], name=rig.names[b])
        return Rig(tuple(cameras)), (rig.names[a], rig.names[b])
    if fault.kind == UNFIT:
        angle = rng.uniform(0, 2 * np.pi) + 2 * np.pi * (np.arange(len(rig)) + rng.uniform(-0.3, 0.3, len(rig))) / len(rig)
        away_m, height_m = rng.uniform(3, 5, len(rig)), rng.uniform(1.5, 2.5, len(rig))
        centres = np.stack([away_m * np.cos(angle), away_m * np.sin(angle), height_m], axis=1)
        poses = [looking_at(centre, np.array([0, 0, 1.0])) for centre in centres]
        elsewhere = [replace(camera, cam_from_world=pose) for camera, pose in zip(rig, poses, strict=True)]
        return Rig(tuple(elsewhere)), rig.names
    axis = rng.normal(size=3) * (1, 1, fault.roll)
    axis /= np.linalg.norm(axis)
    wrong = SE3.from_rotvec(np.deg2rad(fault.turn_deg) * axis, fault.move_m * axis)
    cameras[a] = replace(cameras[a], cam_from_world=wrong @ cameras[a].cam_from_world)
    return Rig(tuple(cameras)), (rig.names[a],)


def observed(clip: Clip, later_rig: Rig | None = None) -> Iterator[tuple[float, monitor.MonitorState, list[RigFinding]]]:
    """Second, state and new findings of the monitor; later_rig: is taken from `FAULT_AT_S` on."""
    state = monitor.new_monitor_state(clip.rig)
    for t_s, seen in zip(clip.t_s.tolist(), clip.xy_img, strict=True):
        rig = clip.rig if later_rig is None or t_s < FAULT_AT_S else later_rig
        state, new = monitor.observe(state, rig, round(t_s * 1e9), seen)
        yield t_s, state, new


def findings(clip: Clip, after_s: float, later_rig: Rig | None = None) -> list[RigFinding]:
    """Findings of the monitor; it stops some time after the first finding after `after_s`."""
    found: list[RigFinding] = []
    for t_s, _, new in observed(clip, later_rig):
        if any(after_s * 1e9 <= one.t_ns < (t_s - SAID_S) * 1e9 for one in found):
            break
        found += new
    return found


def trial(clip: Clip, fault: Fault, number: int) -> Row:
    """One fault in one clip: seconds until the first finding, and whether camera and kind are right."""
    rng = np.random.default_rng([number, FAULTS.index(fault)])
    long = clip.lasting(FAULT_AT_S + WATCHED_S, float(rng.uniform(0, clip.t_s[-1])))
    rig, cameras = wrong_rig(long.rig, fault, rng)
    at, bad = [long.rig.names.index(name) for name in cameras], long.t_s >= FAULT_AT_S
    if fault.kind == monitor.SWAPPED:
        # the monitor remembers what it saw: cables are swapped, not the files of the rig
        rig, long.xy_img[np.ix_(bad, at)] = long.rig, long.xy_img[np.ix_(bad, at[::-1])]
    if fault.late_s:
        before = interp1d(long.t_s, long.xy_img[:, at], axis=0)
        long.xy_img[np.ix_(bad, at)] = before(long.t_s[bad] - fault.late_s)
    found = [one for one in findings(long, FAULT_AT_S, rig) if one.t_ns >= FAULT_AT_S * 1e9]
    if not found:
        return {"found": False}
    first, seconds = found[0], found[0].t_ns / 1e9 - FAULT_AT_S
    right = set(cameras) <= set(first.cameras) if fault.kind == monitor.SWAPPED else first.cameras == cameras
    others = any(not set(one.cameras) <= set(first.cameras if right else cameras) for one in found)
    return {"found": True, "seconds": seconds, "camera": right, "kind": first.kind == fault.kind, "others": others}


def rows_of(clips: list[Clip], trials: int) -> list[dict]:
    rows = []
    for fault in FAULTS:
        done = [trial(clip, fault, number) for clip in clips for number in range(trials)]
        found = [one for one in done if one["found"]]
        row = {"fault": fault.name, "trials": len(done), "found": len(found) / len(done)}
        if found:
            seconds = [one["seconds"] for one in found]
            row |= {"seconds_median": float(np.median(seconds)), "seconds_most": max(seconds)}
            row |= {what: float(np.mean([one[what] for one in found])) for what in ("camera", "kind", "others")}
        rows.append(row)
    return rows


def quiet(clip: Clip) -> dict:
    """False alarms of a clip with nothing wrong."""
    long = clip.lasting(QUIET_S)
    found = findings(long, np.inf)
    details = [f"{one.t_ns / 1e9:.0f} s: {one.detail}" for one in found]
    return {"clip": clip.name, "cameras": len(clip.rig), "minutes": QUIET_S / 60, "alarms": len(found), "details": details}


def explained_by_nothing(clip: Clip) -> dict:
    """The most that a turn and a lateness of any camera explain with nothing wrong, in each memory."""
    long, most = clip.lasting(QUIET_S), {}
    for i, (t_s, state, _) in enumerate(observed(long)):
        if t_s > FAULT_AT_S and i % 3 == 0:
            for memory_s, sums in zip(monitor.MEMORIES_S, state.sums, strict=True):
                for one in monitor.suspects(sums):
                    for what, value in ((one.kind, one.sure), ("mm", 1e3 * one.displaced_m)):
                        most[f"{what}, {memory_s:g} s"] = max(most.get(f"{what}, {memory_s:g} s", 0.0), value)
    return {"clip": clip.name, **most}


# seconds of a session; a clip that is shorter is played to and fro at ten time steps a second
LASTS_S = (2.0, 10.0, 60.0)


def recordings(data: Path, cache: Path) -> dict[str, Recording]:
    """Each clip as a detector sees it, with its right rig."""
    single, two, webcams = data / "pose2sim_single", data / "pose2sim_two", data / "caliscope" / "post_optimization"
    sessions = {
        "balance, OpenPose": {"pose": single / "openpose_json", "Calib.toml": single / "calibration" / "Calib_qualisys.toml"},
        "balance, BlazePose": {"videos": single / "videos", "Calib.qca.txt": single / "calibration" / "Calib.qca.txt"},
        "two pass, BlazePose": {"videos": two / "videos", "Calib.qca.txt": two / "calibration" / "Calib.qca.txt"},
        "webcams, BlazePose": {
            **{f"videos/{path.name}": path for path in sorted((webcams / "calibration" / "extrinsic").glob("*.mp4"))},
            "camera_array.toml": webcams / "camera_array.toml",
        },
        "demo (rendered), BlazePose": {name: DEMO / name for name in ("videos", "rig.toml")},
    }
    found = {}
    for name, parts in sessions.items():
        if not all(path.exists() for path in parts.values()):
            note(f"{name}: not there, left out")
            continue
        folder = cache / "track" / name
        for place, path in parts.items():
            (folder / place).parent.mkdir(parents=True, exist_ok=True)
            (folder / place).unlink(missing_ok=True)
            (folder / place).symlink_to(path.resolve())
        found[name] = tracked(folder, body="off", rate_hz=60.0 if "OpenPose" in name else None)
    return found


def played(log: Observations, seconds: float, late: tuple[int, int] = (0, 0)) -> Observations:
    """The clip to and fro for so long, ten time steps a second if it is longer than the clip; one camera shows old frames.

    Args:
        late: the camera, and by how many frames.
    """
    period_ns, count = int(np.median(np.diff(log.step_t_ns))), len(log.step_t_ns)
    camera, frames = late
    thin = 1 if count * period_ns >= seconds * 1e9 else max(1, round(1e9 / RATE_HZ / period_ns))
    both = np.concatenate([np.arange(count), np.arange(count - 2, 0, -1)])
    steps = np.arange(0, round(seconds * 1e9 / period_ns) if thin > 1 else min(count, round(seconds * 1e9 / period_ns)), thin)
    chosen, at = [], []
    for place, step in enumerate(steps.tolist()):
        for c in range(len(log.camera_names)):
            from_step = step - frames * (c == camera)
            mine = (log.frame_step == both[from_step % len(both)]) & (log.frame_camera == c) & (from_step >= 0)
            chosen.append(np.flatnonzero(mine))
            at.append(np.full(len(chosen[-1]), place))
    return retimed(log, np.concatenate(chosen), np.concatenate(at), period_ns * steps)


def answered(clip: Recording, log: Observations, rig: Rig) -> list[RigFinding] | None:
    """The answer of `track` to a rig and what was observed, with the settings of the clip; None: it refuses to solve."""
    try:
        return checked_rig(solve(log, rig, clip.provenance), rig)[1]
    except InputError:
        return None


def tracked_wrong(clips: dict[str, Recording], seeds: list[int], lasts_s: list[float]) -> list[dict]:
    """For each fault and length: named, another answer, nothing."""
    rows = []
    for (number, fault), seconds in product(enumerate(WRONG), lasts_s):
        row = {
            "fault": fault.name,
            "seconds": f"up to {seconds:g}",
            **dict.fromkeys(("sessions", "named", "others", "nothing"), 0),
        }
        row["nothing in"] = []
        for seed, (place, (name, clip)) in product(seeds, enumerate(clips.items())):
            there, cameras = wrong_rig(clip.rig, fault, np.random.default_rng([seed, place, number, round(seconds)]))
            log = played(clip.observations, seconds, (clip.rig.names.index(cameras[0]), fault.late_frames))
            found = answered(clip, log, there)
            right = found is None if fault.kind == UNFIT else False
            right |= any(one.kind == fault.kind and set(one.cameras) & set(cameras) for one in found or [])
            right &= all(set(one.cameras) <= set(cameras) for one in found or [])
            row["sessions"] += 1
            row["named" if right else "others" if found or found is None else "nothing"] += 1
            if found == []:
                row["nothing in"] = sorted({*row["nothing in"], name})
        rows.append(row)
        note(row)
    return rows


def tracked_right(clips: dict[str, Recording], sessions: int, seed: int) -> dict:
    """False alarms: sections of the clips, three or four of the cameras, for 2 s or played to and fro for 10 s."""
    alarms, rng = [], np.random.default_rng(seed)
    for number in range(sessions):
        name = list(clips)[number % len(clips)]
        log, rig = clips[name].observations, clips[name].rig
        count, cameras = len(log.step_t_ns), np.sort(rng.permutation(len(rig))[: rng.integers(3, 5)])
        begin, lasts = rng.uniform(0, 0.5), rng.uniform(0.5, 1.0)
        first, last = int(begin * lasts * count), int((begin * lasts + lasts) * count)
        part = log.only((log.frame_step >= first) & (log.frame_step < last) & np.isin(log.frame_camera, cameras))
        part = replace(
            part,
            camera_names=tuple(rig.names[c] for c in cameras),
            frame_camera=np.searchsorted(cameras, part.frame_camera),
            step_t_ns=log.step_t_ns[first:last],
            frame_step=part.frame_step - first,
        )
        found = answered(clips[name], played(part, 10.0 if number % 3 == 0 else 2.0), rig.only(part.camera_names))
        if found:
            alarms.append(f"{name}, steps {first} to {last}, {part.camera_names}: {text([one.detail for one in found])}")
    return {"sessions": sessions, "alarms": alarms}


def track_main(args: argparse.Namespace) -> None:
    clips = recordings(args.data, args.cache)
    good, rows = tracked_right(clips, args.goods, args.seeds[0]), tracked_wrong(clips, args.seeds, args.seconds)
    about = f"Seeds {text(args.seeds)}; {text(list(clips))}"
    right = {"right rigs": good["sessions"], "alarms": len(good["alarms"]), "which": good["alarms"]}
    answer(args, {f"Wrong rigs. {about}": rows, "Right rigs": [right]}, mark="wrong rigs")


def main() -> None:
    args = arguments(
        __doc__, fit=False, trials=6, data=DATA, cache=Path("out/rig_monitor"), track=False, seeds=(100, 101, 102),
        seconds=LASTS_S, goods=100,
    )  # fmt: skip
    if args.track:
        track_main(args)
        return
    clips = [clip_of_scene(name, scene, args.cache) for name, scene in scenes(args.fit)]
    clips += [clip.only([0, 2, 4, 6], clip.name.replace("8", "4 of 8", 1)) for clip in clips if len(clip.rig) == 8]
    still = list(clips)
    if not args.fit and args.data.is_dir():
        still.append(clip_of_session("pose2sim_single (real)", args.data / "pose2sim_single"))
    tables = {"Nothing wrong": [quiet(clip) for clip in still]}
    if args.fit:
        tables["Most that is explained with nothing wrong"] = [explained_by_nothing(clip) for clip in clips]
    walks = [clip for clip in clips if "walk" in clip.name]
    tables["Faults, people who walk"] = rows_of(walks, args.trials)
    answer(args, tables, fit=args.fit)


if __name__ == "__main__":
    main()
