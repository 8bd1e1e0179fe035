"""Time of the default detector per image: a table on stderr, one JSON object on stdout.

    python bench/detect.py [--repeat 50] [--networks blazepose_lite rtmpose_m ...]

Batches of four views with one person each, where the region is known (the usual case), and the worst case of the search: images
in which no person is found. The time of the networks does not depend on what is in the image.
"""

import os
import time

import numpy as np
from harness import answer, arguments

from posefuse.core import Frame, Region
from posefuse.detection import BlazePoseConfig
from posefuse.detection.build import network_plugin
from posefuse.foundation.plugins import plugin_config

VIEWS = 4
SIZES_WH = ((640, 480), (1920, 1080))
OTHERS = ("blazepose_lite", "blazepose_heavy", "blazepose_best")
CORES = len(os.sched_getaffinity(0))


def measure(landmarks: str, streams: int, size_wh: tuple[int, int], known: bool, repeat: int) -> dict[str, str | float]:
    plugin, options = network_plugin(landmarks)
    detector = plugin_config("detectors", plugin, {**options, "streams": streams}).build()
    rng = np.random.default_rng(0)
    shape = (size_wh[1], size_wh[0], 3)
    frames = [
        Frame(camera=f"cam{i}", seq=0, t_ns=0, received_ns=0, image=rng.integers(0, 255, shape, dtype=np.uint8))
        for i in range(VIEWS)
    ]
    region = Region(centre_img=np.array(size_wh) / 2, side_px=0.8 * size_wh[1], angle_rad=0.1)
    regions = [[region] if known else None for _ in frames]
    wall, cpu = [], []
    for i in range(repeat + 3):
        began, spent = time.perf_counter(), time.process_time()
        detector.detect(frames, regions)
        if i >= 3:
            wall.append(time.perf_counter() - began)
            cpu.append(time.process_time() - spent)
    return {
        "landmarks": landmarks,
        "streams": streams,
        "width_px": size_wh[0],
        "region_known": known,
        "wall_ms_per_image": float(np.median(wall)) * 1000 / VIEWS,
        "cpu_ms_per_image": float(np.median(cpu)) * 1000 / VIEWS,
    }


def main() -> None:
    args = arguments(__doc__, repeat=50, networks=OTHERS)
    usual = BlazePoseConfig().landmarks
    cases = [(usual, streams, size, True, args.repeat) for streams in sorted({1, CORES}) for size in SIZES_WH]
    cases += [(name, CORES, SIZES_WH[0], True, args.repeat) for name in args.networks]
    cases.append((usual, CORES, SIZES_WH[0], False, max(3, args.repeat // 10)))
    answer(args, {"Detection per image, four views at once": [measure(*case) for case in cases]})


if __name__ == "__main__":
    main()
