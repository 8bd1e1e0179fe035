"""How fast the simulator renders: the demo scene, four cameras of 640x480, with noise and H.264, in one process per core.

    python bench/render.py [--seconds 6]

A table on stderr, one JSON object on stdout. Building the bodies and starting the processes is counted.
"""

import argparse
import dataclasses
import json
import os
import resource
import sys
import tempfile
import time
from pathlib import Path

from posefuse.simulation import read_scene, simulate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=6.0)
    args = parser.parse_args()
    scene = dataclasses.replace(read_scene(Path("examples/scenes/demo.yaml")), duration_s=args.seconds)
    done = []
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        simulate(scene, Path(folder) / "session", progress=lambda count, total: done.append(count))
        seconds = time.perf_counter() - began
    figures = {
        "frames": done[-1],
        "processes": len(os.sched_getaffinity(0)),
        "seconds": seconds,
        "frames_per_s": done[-1] / seconds,
        "cpu_ms_per_frame": 1000 * cpu_s() / done[-1],
        "peak_memory_mb_per_process": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024,
    }
    for name, value in figures.items():
        print(f"{name:28s}{value:10.1f}", file=sys.stderr)
    print(json.dumps(figures, indent=2))


def cpu_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


if __name__ == "__main__":
    main()
