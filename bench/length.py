"""How processor time and memory of `track`, `report` and `compare` grow with the length of a recording of one person.

    python bench/length.py [SESSION] [--minutes 1 4 8] [--only report compare] [--write docs/reliability.md]

The session (default: examples/demo) is tracked once; a result folder is taken as it is. Its observations are then put one
after the other, every second time backwards, so that the person moves on without a jump. `solve` is `posefuse solve RESULT`:
all but decoding and detection. `bodies` is the same with `--body on`. Each command is a process of its own; memory is the
largest that its system call reports. With `--only`, the page's other rows stay if they are of the same lengths.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from posefuse.core import Observations, Recording
from posefuse.formats.recording import ABOUT_FILE, read_recording, write_recording

POSEFUSE = [sys.executable, "-m", "posefuse"]
COMMANDS = ("solve", "bodies", "report", "compare")
ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tools"))


def there_and_back(recording: Recording, minutes: float) -> Recording:
    """The recording repeated in time to this length, every second time backwards."""
    log, poses = recording.observations, recording.poses
    period_ns = int(np.median(np.diff(poses.t_ns)))
    span_ns = int(poses.t_ns[-1]) + period_ns
    count = max(1, round(minutes * 60e9 / span_ns))
    logs = [log if i % 2 == 0 else _backwards(log) for i in range(count)]
    parts = [_later(one, i * span_ns) for i, one in enumerate(logs)]
    order = [np.arange(len(poses))[:: 1 if i % 2 == 0 else -1] for i in range(count)]
    taken = np.concatenate(order)
    planes = {name: getattr(poses, name)[taken] for name in ("xyz_world", "cov_world", "reproj_px", "n_views", "kind")}
    t_ns = np.concatenate([poses.t_ns + i * span_ns for i in range(count)])
    return replace(recording, observations=Observations.concatenate(parts), poses=replace(poses, t_ns=t_ns, **planes))


def _backwards(log: Observations) -> Observations:
    """The same frames in the opposite order of time."""
    order = np.argsort(-log.frame_step, kind="stable")
    frames = [slice(log.frame_begin[i], log.frame_begin[i + 1]) for i in order]
    rows = np.concatenate([np.arange(one.start, one.stop) for one in frames])
    last = len(log.step_t_ns) - 1
    ends_ns = int(log.step_t_ns[0] + log.step_t_ns[-1])
    return replace(
        log,
        step_t_ns=ends_ns - log.step_t_ns[::-1],
        frame_camera=log.frame_camera[order],
        frame_t_ns=ends_ns - log.frame_t_ns[order],
        frame_step=last - log.frame_step[order],
        frame_look=log.frame_look[order],
        n_detections=log.n_detections[order],
        person_id=log.person_id[rows],
        **log.rows(rows),
    )


def _later(log: Observations, later_ns: int) -> Observations:
    return replace(log, step_t_ns=log.step_t_ns + later_ns, frame_t_ns=log.frame_t_ns + later_ns)


def measured(command: list[str]) -> tuple[float, float]:
    """Processor seconds and megabytes of a command."""
    process = subprocess.Popen([*POSEFUSE, *command], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"posefuse {' '.join(command)}: ended with {os.waitstatus_to_exitcode(status)}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("session", type=Path, nargs="?", default=ROOT / "examples" / "demo")
    parser.add_argument("--minutes", type=float, nargs="+", default=[1, 4, 8])
    parser.add_argument("--only", nargs="+", choices=COMMANDS)
    parser.add_argument("--write", type=Path, help="page whose table 'length' is replaced")
    args = parser.parse_args()
    wanted = args.only or COMMANDS
    cells: dict[str, list[str]] = {name: [] for name in wanted}
    with tempfile.TemporaryDirectory() as scratch:
        tracked = args.session
        if not (tracked / ABOUT_FILE).is_file():
            tracked = Path(scratch) / "tracked"
            command = [*POSEFUSE, "track", str(args.session), "--out", str(tracked), "--outputs", "trc"]
            subprocess.run(command, check=True, stdout=sys.stderr)
        for minutes in args.minutes:
            long = Path(scratch) / "long"
            long.mkdir()
            write_recording(long, there_and_back(read_recording(tracked), minutes))
            out = Path(scratch) / "out"
            commands = {
                "solve": ["track", str(long), "--out", str(out), "--outputs", "trc", "--body", "off"],
                "bodies": ["track", str(long), "--out", str(out), "--outputs", "trc", "--body", "on"],
                "report": ["report", str(long), "--out", str(out)],
                "compare": ["compare", str(long), str(long), "--out", str(out)],
            }
            for name in wanted:
                cpu_s, memory_mb = measured(commands[name])
                cells[name].append(f"{cpu_s:.0f} s, {memory_mb:.0f} MB")
                print(f"{name} {minutes:g} min: {cells[name][-1]}", file=sys.stderr, flush=True)
                shutil.rmtree(out, ignore_errors=True)
            shutil.rmtree(long)
    head = ["| command | " + " | ".join(f"{one:g} min" for one in args.minutes) + " |", "|---|" + "---:|" * len(args.minutes)]
    rows = {name: f"| {name} | " + " | ".join(row) + " |" for name, row in cells.items()}
    print("\n".join([*head, *rows.values()]))
    if args.write:
        from page_marks import between_marks, write_between_marks

        written = between_marks(args.write, "length")[1].splitlines()
        if written[:2] == head:
            rows = {line.split(" | ")[0].strip("| "): line for line in written[2:]} | rows
        table = "\n".join([*head, *(rows[name] for name in COMMANDS if name in rows)])
        write_between_marks(args.write, table, "length")


if __name__ == "__main__":
    main()
