"""Calibration measured against the truth: errors, clocks and seconds.

Run: python bench/calibrate.py [--seeds N]                markers projected, noise added
     python bench/calibrate.py --rendered [SESSION]       real detection in rendered videos; renders the scene when it is missing
     python bench/calibrate.py --person [SEED]            from a walking person alone, the real 2D network on rendered videos
     python bench/calibrate.py --person-real [DATA]       the same on pose2sim_single: estimates against each other
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from faults.waved_props import Faults, Waving, cube, observe_prop

from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.extrinsics.self_checks import camera_differences
from posefuse.calibration.extrinsics.target import Calibration, calibrate_extrinsics
from posefuse.calibration.solving.rotations import poses_of
from posefuse.calibration.targets.corners import joined
from posefuse.calibration.targets.detection import detect_corners
from posefuse.calibration.targets.kinds import Markers
from posefuse.core import Camera, Rig
from posefuse.formats.rig import read_rig
from posefuse.simulation import SessionPaths, simulate
from posefuse.simulation.build import live_scene
from posefuse.simulation.cameras import looking_at
from posefuse.simulation.props import ArucoCube
from posefuse.simulation.scene import read_scene
from posefuse.sources import VideoConfig

REAL = Path("../shared/data/pose2sim_single")
RADIUS_M, HEIGHT_M = 4.5, 2.2
LENS = np.array([-0.12, 0.05, 0.001, -0.0005, 0.0])
SECONDS = 120.0
SCENE, RENDERED = Path("examples/scenes/calibration_cube_8cam.yaml"), Path("out/calibration_cube_8cam")


def ring(count: int, size_wh: tuple[int, int]) -> Rig:
    focal = 0.9 * size_wh[0]
    intrinsics = np.array([[focal, 0, (size_wh[0] - 1) / 2], [0, focal, (size_wh[1] - 1) / 2], [0, 0, 1]])
    cameras = []
    for i in range(count):
        angle = 2 * np.pi * i / count + 0.3
        centre = np.array([RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), HEIGHT_M])
        pose = looking_at(centre, np.array([0, 0, 1.0]))
        cameras.append(Camera(name=f"cam{i:02d}", size_wh=size_wh, K=intrinsics, cam_from_world=pose, distortion=LENS))
    return Rig(tuple(cameras))


def cases() -> Iterator[tuple[str, Rig, str, bool]]:
    for count, size in ((4, (640, 480)), (8, (640, 480)), (4, (1280, 720)), (8, (1280, 720))):
        yield f"{count} cameras {size[0]}x{size[1]}, synchronised", ring(count, size), "together", False
    yield "6 cameras 640x480, clocks up to 200 ms apart", ring(6, (640, 480)), "offset", True
    yield "8 cameras 1280x720, clocks up to 200 ms apart", ring(8, (1280, 720)), "offset", True


def measured(rig: Rig, clocks: str, apart: bool, seed: int) -> dict[str, float]:
    """Errors of the worst camera against the truth, and the seconds of solve and checks."""
    target = Markers(0.24)
    late = np.random.default_rng(seed).uniform(-0.2, 0.2, len(rig)) if apart else np.zeros(len(rig))
    seen = observe_prop(rig, cube(0.3), target, Waving(SECONDS, seed=seed), Faults(seed=seed, delay_s=tuple(late)))
    begin, begun_cpu = time.perf_counter(), time.process_time()
    found = calibrate_extrinsics(seen, rig.cameras, target, Options(clocks=clocks))
    spent = {"seconds": time.perf_counter() - begin, "cpu_seconds": time.process_time() - begun_cpu}
    return {**errors(rig, found, late), **spent}


def errors(rig: Rig, found: Calibration, late: np.ndarray) -> dict[str, float]:
    """Of the worst camera; scale counts, where the world is does not."""
    true, got = (poses_of(one) for one in (rig, found.rig))
    metres, radians = camera_differences(true, got)
    clock = found.delay_s[:, 0] - late
    return {
        "position_mm": float(metres.max() * 1e3),
        "rotation_deg": float(np.rad2deg(radians.max())),
        "clock_ms": float(np.abs(clock - clock[0]).max() * 1e3),
    }


def rendered(session: Path) -> dict[str, float]:
    """The same from videos of a simulated session, which is rendered first when it is not there or not finished."""
    paths = SessionPaths(session)
    if not paths.rig.exists():
        simulate(read_scene(SCENE), session)
    scene, rig = read_scene(paths.scene), read_rig(paths.rig)
    cube_ = next(prop for prop in scene.props if isinstance(prop, ArucoCube))
    target = Markers(cube_.marker_m, cube_.dictionary, tuple(range(cube_.first_id, cube_.first_id + 6)))
    begin = time.perf_counter()
    seen = joined([detect_corners(VideoConfig(paths.video(camera.name), camera.name).build(), target) for camera in rig])
    detected, begun_cpu = time.perf_counter(), time.process_time()
    late = np.array([placed.sensor.offset_s for placed in live_scene(scene).placed])
    found = calibrate_extrinsics(seen, rig.cameras, target, Options(clocks="offset"))
    return {
        **errors(rig, found, late),
        "marker_views": len(seen) // 4,
        "corner_sigma_px": found.report.numbers["sigma_px"],
        "detection_seconds": detected - begin,
        "seconds": time.perf_counter() - detected,
        "cpu_seconds": time.process_time() - begun_cpu,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--rendered", type=Path, nargs="?", const=RENDERED, metavar="SESSION", help=f"default {RENDERED}")
    parser.add_argument("--person", type=int, nargs="?", const=-1, metavar="SEED", help="a walking person alone; of all seeds")
    parser.add_argument("--person-real", type=Path, nargs="?", const=REAL, metavar="DATA", help=f"default {REAL}")
    args = parser.parse_args()
    if args.person is not None or args.person_real:
        import calibrate_person

        only = None if args.person in (None, -1) else args.person
        figures = calibrate_person.real(args.person_real) if args.person_real else calibrate_person.simulated(only)
        print(json.dumps(figures, indent=2))
        return
    if args.rendered:
        print(json.dumps({"session": str(args.rendered), **rendered(args.rendered)}, indent=2))
        return
    seeds, figures = args.seeds, {}
    print(f"Waved unknown cube, {SECONDS:.0f} s at 30 Hz, {RADIUS_M} m radius, corner noise 0.25 px;", file=sys.stderr)
    print(f"markers projected, not rendered; worst camera of {seeds} seeds\n", file=sys.stderr)
    print("| case | position mm | rotation deg | clock ms | solve and checks s | of all cores s |", file=sys.stderr)
    print("|---|---|---|---|---|---|", file=sys.stderr)
    for label, rig, clocks, apart in cases():
        rows = [measured(rig, clocks, apart, seed) for seed in range(seeds)]
        worst = {name: max(row[name] for row in rows) for name in rows[0]}
        figures[label] = worst
        shown = f"{worst['position_mm']:.2f} | {worst['rotation_deg']:.4f} | {worst['clock_ms']:.2f} | {worst['seconds']:.1f}"
        shown += f" | {worst['cpu_seconds']:.1f}"
        print(f"| {label} | {shown} |", file=sys.stderr)
    print(json.dumps({"seeds": seeds, "cases": figures}, indent=2))


if __name__ == "__main__":
    main()
