"""How fast the simulator renders: the demo scene, four cameras of 640x480, with noise and H.264, in one process per core.

    python bench/render.py [--seconds 6]

A table on stderr, one JSON object on stdout. Building the bodies and starting the processes is counted.
"""

import os
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from harness import ROOT, answer, arguments

from posefuse_sim import read_scene, simulate


def main() -> None:
    args = arguments(__doc__, seconds=6.0)
    scene = replace(read_scene(ROOT / "examples" / "scenes" / "demo.yaml"), duration_s=args.seconds)
    done = []
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        simulate(scene, Path(folder) / "session", progress=lambda count, total: done.append(count))
        seconds = time.perf_counter() - began
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    row = {
        "frames": done[-1],
        "processes": len(os.sched_getaffinity(0)),
        "seconds": seconds,
        "frames_per_s": done[-1] / seconds,
        "cpu_ms_per_frame": 1000 * sum(one.ru_utime + one.ru_stime for one in used) / done[-1],
        "peak_memory_mb_per_process": used[1].ru_maxrss / 1024,
    }
    answer(args, {"Rendering": [row]})


if __name__ == "__main__":
    main()
