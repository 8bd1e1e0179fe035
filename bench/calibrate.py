"""Calibration measured against the truth: errors, clocks and seconds. From a person alone: `bench/calibrate_person.py`.

    python bench/calibrate.py [--seeds N]               markers projected, noise added
    python bench/calibrate.py --rendered SESSION        real detection in rendered videos; renders the scene when it is missing

Tables on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from faults.sessions import errors as rig_errors
from faults.waved_props import Faults, Waving, cube, observe_prop
from harness import answer, arguments, medians, rendered
from scenes import ring

from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.extrinsics.target import Calibration, calibrate_extrinsics
from posefuse.calibration.targets.corners import joined
from posefuse.calibration.targets.detection import detect_corners
from posefuse.calibration.targets.kinds import Markers
from posefuse.core import Rig
from posefuse.formats.rig import read_rig
from posefuse.sources import VideoConfig
from posefuse_sim import SessionPaths
from posefuse_sim.build import live_scene
from posefuse_sim.props import ArucoCube
from posefuse_sim.scene import read_scene

LENS = (-0.12, 0.05, 0.001, -0.0005, 0.0)
SECONDS = 120.0
SCENE = Path("examples/scenes/calibration_cube_8cam.yaml")


def cases() -> Iterator[tuple[str, Rig, str, bool]]:
    for count, size, apart in (
        *((count, size, False) for size in ((640, 480), (1280, 720)) for count in (4, 8)),
        (6, (640, 480), True),
        (8, (1280, 720), True),
    ):
        rig = ring(count, size, 0.9 * size[0], begin_rad=0.3, lens=LENS)
        clocks = "clocks up to 200 ms apart" if apart else "synchronised"
        yield f"{count} cameras {size[0]}x{size[1]}, {clocks}", rig, "offset" if apart else "together", apart


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
    millimetres, degrees = rig_errors(rig, found.rig)
    clock = found.clocks.offset_s - late
    return {"position_mm": millimetres, "rotation_deg": degrees, "clock_ms": float(np.abs(clock - clock[0]).max() * 1e3)}


def from_videos(session: Path) -> dict[str, float]:
    """The same from videos of a simulated session, which is rendered first when it is not there or not finished."""
    paths = SessionPaths(rendered(read_scene(SCENE), session, processes=None))
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
    args = arguments(__doc__, seeds=3, rendered=Path)
    if args.rendered:
        answer(args, {"Rendered": [{"session": str(args.rendered), **from_videos(args.rendered)}]})
        return
    rows = []
    for label, rig, clocks, apart in cases():
        rows.append({"case": label, **medians([measured(rig, clocks, apart, seed) for seed in range(args.seeds)], np.max)})
    about = f"Waved unknown cube, {SECONDS:.0f} s at 30 Hz, corner noise 0.25 px; markers projected, not rendered"
    answer(args, {f"{about}; worst camera of {args.seeds} seeds": rows}, seeds=args.seeds)


if __name__ == "__main__":
    main()
