"""Run every benchmark and write docs/benchmarks.md: `make bench`, or `python bench/run.py NAME ...` for some of them.

Each benchmark is a script of this folder that prints its table on stderr and one JSON object on stdout. The JSON is kept in
out/bench. Every part of the page states its date and machine; parts that are not run again stay as they are.
"""

import json
import os
import platform
import subprocess
import sys
from datetime import date
from importlib.metadata import version
from pathlib import Path

from harness import OUT, ROOT

from paper.experiments.runs import processor
from posefuse.detection.engines import openvino_core

HERE, PAGE = Path(__file__).resolve().parent, ROOT / "docs" / "benchmarks.md"
TITLES = {
    "pipeline": "The whole pipeline on the demo clip",
    "real_footage": "Real footage",
    "detect": "Detection: time per image",
    "fuse": "Fusion: time per solve",
    "render": "Simulator: rendering",
    "kinematics": "Joint angles",
    "calibrate": "Calibration",
    "rig_monitor": "Rig monitor: moved, late and exchanged cameras",
    "live": "Live: the whole pipeline",
    "live_tracking": "Live: the tracker, and what limits it",
    "live_faults": "Live: what goes wrong, and the results",
    "live_soak": "Live: an hour",
    "wire": "Network: one-way time of a skeleton",
}
PACKAGES = ("posefuse", "numpy", "openvino", "opencv-python-headless", "numba", "av")


def machine() -> str:
    networks = "bf16" if "BF16" in openvino_core().get_property("CPU", "OPTIMIZATION_CAPABILITIES") else "f32"
    cores = len(os.sched_getaffinity(0))
    return f"{processor()}, {cores} cores, networks in {networks}, Python {platform.python_version()}"


def run(name: str) -> str:
    """Run one benchmark, keep its figures, and give its part of the page."""
    print(f"--- {name}", file=sys.stderr, flush=True)
    done = subprocess.run([sys.executable, str(HERE / f"{name}.py")], capture_output=True, text=True, check=False)
    print(done.stderr, file=sys.stderr)
    if done.returncode:
        sys.exit(f"bench/{name}.py ended with code {done.returncode}")
    OUT.mkdir(parents=True, exist_ok=True)
    figures = {"machine": machine(), "date": str(date.today()), "figures": json.loads(done.stdout)}
    (OUT / f"{name}.json").write_text(json.dumps(figures, indent=2))
    table = "\n".join(line.rstrip() for line in done.stderr.strip().splitlines())
    return f"`python bench/{name}.py`, {date.today()}, {machine()}\n\n```\n{table}\n```"


def parts_of_page() -> dict[str, str]:
    """The present text of docs/benchmarks.md, by title."""
    if not PAGE.is_file():
        return {}
    _, *parts = PAGE.read_text(encoding="utf-8").split("\n## ")
    return {title: text.strip() for title, _, text in (part.partition("\n") for part in parts)}


def write_page(parts: dict[str, str]) -> None:
    """docs/benchmarks.md, in the order of TITLES."""
    head = [
        "# Benchmarks",
        "Made by `make bench` and `make bench-live` (each part alone: `python bench/run.py NAME`). "
        "Machines are shared and noisy: read ratios and medians, and look at which machine made a part.",
        f"Packages: {', '.join(f'{name} {version(name)}' for name in PACKAGES)}.",
    ]
    filled = [f"## {title}\n\n{parts[title]}" for title in TITLES.values() if title in parts]
    PAGE.write_text("\n\n".join([*head, *filled]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    for wanted in sys.argv[1:] or [name for name in TITLES if not name.startswith("live")]:
        write_page(parts_of_page() | {TITLES[wanted]: run(wanted)})
