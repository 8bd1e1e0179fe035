"""The whole pipeline on the demo clip, as a user runs it: speed, memory, and the error against the truth.

    python bench/pipeline.py [--repeat 3] [--session examples/demo]

A table on stderr, one JSON object on stdout. Times are medians over the runs; `track` writes nothing but the lossless result,
`everything` all default outputs with the overlay video.
"""

import json
import resource
import subprocess
import tempfile
from pathlib import Path

from harness import DEMO, POSEFUSE, answer, arguments, medians, tracked, truth_of

from posefuse.evaluation.metrics import joint_errors


def speed(session: Path, out: Path, repeat: int, *options: str) -> dict:
    """Medians over `repeat` runs of `posefuse track`."""
    command = [*POSEFUSE, "track", str(session), "--out", str(out), "--force", "--json", *options]
    runs = [json.loads(subprocess.run(command, check=True, capture_output=True).stdout) for _ in range(repeat)]
    row = medians([{"time_steps_per_s": run["time_steps_per_s"]} for run in runs])
    return {**row, "images_per_s": runs[0]["cameras"] * row["time_steps_per_s"]}


def main() -> None:
    args = arguments(__doc__, repeat=3, session=DEMO)
    with tempfile.TemporaryDirectory() as folder:
        ways = {"track": ("--outputs", ""), "everything": ()}
        rows = [{"run": way, **speed(args.session, Path(folder) / "result", args.repeat, *ways[way])} for way in ways]
    peak_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    found = joint_errors(tracked(args.session).poses, truth_of(args.session))
    errors = [{"mpjpe_mm": found.mpjpe_mm, "worst_joint_mm": float(found.mean_mm.max())}]
    tables = {"Demo clip: speed (start-up not counted)": rows, "Demo clip: error against the truth, mm (14 joints)": errors}
    answer(args, tables, peak_memory_mb=peak_mb)


if __name__ == "__main__":
    main()
