"""Run every benchmark and write docs/benchmarks.md: `make bench`, or `python bench/run.py NAME ...` for some of them.

Each benchmark is a script of this folder that prints its table on stderr and one JSON object on stdout. The JSON is kept in
out/bench, and the page is put together from what lies there, so that one benchmark can be run anew by itself.
"""

import json
import os
import platform
import subprocess
import sys
from datetime import date
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).resolve().parent
OUT = HERE.parent / "out" / "bench"
PAGE = HERE.parent / "docs" / "benchmarks.md"
TITLES = {
    "pipeline": "The whole pipeline on the demo clip",
    "real_footage": "Real footage",
    "detect": "2D estimation: time per image",
    "fuse": "Fusion: time per solve",
    "fuse_accuracy": "Fusion: accuracy with outliers",
    "render": "Simulator: rendering",
    "kinematics": "Joint angles",
    "calibrate": "Calibration",
    "live": "Live: the whole pipeline",
    "live_tracking": "Live: the tracker against the paper's way",
    "live_faults": "Live: what goes wrong, and what comes of it",
    "live_soak": "Live: an hour",
    "wire": "Network: one-way time of a skeleton",
}
PACKAGES = ("posefuse", "numpy", "openvino", "opencv-contrib-python-headless", "numba", "av")


def machine() -> str:
    info = Path("/proc/cpuinfo")
    names = (
        [line.split(":")[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
        if info.is_file()
        else []
    )
    cores = len(os.sched_getaffinity(0))
    return f"{names[0] if names else platform.processor()}, {cores} cores, Python {platform.python_version()}"


def run(name: str) -> None:
    """Run one benchmark and keep its figures and its table."""
    print(f"--- {name}", file=sys.stderr, flush=True)
    done = subprocess.run([sys.executable, str(HERE / f"{name}.py")], capture_output=True, text=True, check=False)
    print(done.stderr, file=sys.stderr)
    if done.returncode:
        sys.exit(f"bench/{name}.py ended with code {done.returncode}")
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / f"{name}.json").write_text(
        json.dumps({"machine": machine(), "date": str(date.today()), "figures": json.loads(done.stdout)}, indent=2)
    )
    (OUT / f"{name}.txt").write_text(done.stderr)


def write_page() -> None:
    """docs/benchmarks.md from the kept figures."""
    parts = [
        "# Benchmarks",
        "Made by `make bench` (each part alone: `python bench/run.py NAME`). "
        "Machines are shared and noisy: read ratios and medians.",
        f"Packages: {', '.join(f'{name} {version(name)}' for name in PACKAGES)}.",
    ]
    for name, title in TITLES.items():
        if not (OUT / f"{name}.txt").is_file():
            continue
        about = json.loads((OUT / f"{name}.json").read_text())
        table = "\n".join(line.rstrip() for line in (OUT / f"{name}.txt").read_text().strip().splitlines())
        parts += [f"## {title}", f"`python bench/{name}.py`, {about['date']}, {about['machine']}", f"```\n{table}\n```"]
    PAGE.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


if __name__ == "__main__":
    for wanted in sys.argv[1:] or [name for name in TITLES if not name.startswith("live")]:
        run(wanted)
    write_page()
