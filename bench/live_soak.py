"""A live session for a long time: does memory stay flat, and is all of it there after Ctrl-C?

    nice -n 5 python bench/live_soak.py [--minutes 60] [--cameras 4] [--groups 2] [--networks NAME]
        [--session examples/demo] [--trace FILE.csv]

A simulated session is played at the pace of the clock, again and again, and recorded; then Ctrl-C. Every few seconds the memory,
threads, open files and children of every process are read. Growth is the slope of a straight line through what was read
after the warm-up. Latency over time is read from the recording: from the exposure of an image until its keypoints were in the
tracker, and by how much outputs were late. Tables on stderr, one JSON object on stdout.
"""

import argparse
import csv
import itertools
import json
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from posefuse.formats.rig import read_rig
from posefuse.formats.truth import read_truth
from posefuse.messages.bags import read_detections, read_poses

_START_S = 180.0
_END_S = 30.0
_WARM_UP_SHARE = 0.3
_LEAST_SAMPLES = 5
_STRETCHES, _PERCENTILES = 6, (50, 95, 99)


@dataclass(frozen=True)
class Sample:
    """One process at one moment; `t_s` after the session began."""

    t_s: float
    pid: int
    rss_mb: float
    own_mb: float
    threads: int
    files: int
    children: int


class Processes:
    """The session's processes, and what each is for."""

    def __init__(self, root: int) -> None:
        self.roles = {root: "fusion"}
        self.samples: list[Sample] = []
        self._root, self._began_s = root, time.monotonic()

    def named(self, note: str) -> None:
        """Learn which process has which cameras from the session's output."""
        for cameras, pid in re.findall(r"cameras ([^;]+?) in process (\d+)", note):
            self.roles[int(pid)] = f"cameras {cameras}"
        for pid in re.findall(r"rig watched in process (\d+)", note):
            self.roles[int(pid)] = "rig watch"

    def look(self) -> None:
        """Read all processes once."""
        for pid in (self._root, *children_of(self._root)):
            try:
                self.samples.append(sample_of(pid, time.monotonic() - self._began_s))
                self.roles.setdefault(pid, role_of(pid))
            except (FileNotFoundError, ProcessLookupError, KeyError):  # it has ended, or is about to
                continue

    def alive(self) -> list[int]:
        """Which of all processes ever seen still run."""
        return [pid for pid in self.roles if running(pid)]


def children_of(pid: int) -> list[int]:
    try:
        return [int(child) for task in Path(f"/proc/{pid}/task").iterdir() for child in (task / "children").read_text().split()]
    except FileNotFoundError:
        return []


def sample_of(pid: int, t_s: float) -> Sample:
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    rss, own = (int(status[key].split()[0]) / 1024 for key in ("VmRSS", "RssAnon"))
    files = len(list(Path(f"/proc/{pid}/fd").iterdir()))
    return Sample(t_s, pid, rss, own, int(status["Threads"]), files, len(children_of(pid)))


def role_of(pid: int) -> str:
    line = Path(f"/proc/{pid}/cmdline").read_text()
    return "resource tracker" if "resource_tracker" in line else "outputs"


def running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(") ")[1][0] != "Z"
    except FileNotFoundError:
        return False


def soak(args: argparse.Namespace, recording: Path) -> tuple[Processes, dict, dict]:
    """Run, watch, Ctrl-C: the processes, the session's own figures, and how it ended."""
    truth = read_truth(args.session / "truth" / "truth.npz")
    loop_s = round((truth.t_ns[-1] - truth.t_ns[0]) / 1e9 + 1 / 30, 3)
    names = read_rig(args.session / "rig.toml").names[: args.cameras]
    command = [sys.executable, "-m", "posefuse.cli.main", "live", str(args.session / "rig.toml"), "--json"]
    command += [part for name in names for part in ("--source", f"{name}=sim:{args.session}")]
    command += ["--loop", str(loop_s), "--record", str(recording), *(["--groups", str(args.groups)] if args.groups else [])]
    command += ["--networks", args.networks]
    live = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    processes = Processes(live.pid)
    begun = threading.Event()
    notes: list[str] = []

    def listen() -> None:
        for line in live.stderr:
            notes.append(line)
            processes.named(line)
            if ": ok" in line:
                begun.set()

    listening = threading.Thread(target=listen)
    listening.start()
    try:
        if not begun.wait(_START_S):
            raise SystemExit(f"the session did not begin: {''.join(notes)}")
        watch(processes, live, args)
        if live.poll() is not None:
            listening.join()
            lived_s = max(one.t_s for one in processes.samples)
            raise SystemExit(f"the session ended by itself after {lived_s:.0f} s with {live.returncode}: {''.join(notes[-80:])}")
        stopping_s = time.monotonic()
        live.send_signal(signal.SIGINT)
        out = live.stdout.read()
        live.wait(_END_S)
        ended = {"code": live.returncode, "stop_s": time.monotonic() - stopping_s, "left_over": len(processes.alive())}
    finally:
        live.kill()
        listening.join()
    return processes, json.loads(out), ended


def watch(processes: Processes, live: subprocess.Popen, args: argparse.Namespace) -> None:
    end_s = time.monotonic() + 60 * args.minutes
    while live.poll() is None and time.monotonic() < end_s:
        processes.look()
        if args.trace:
            write_trace(args.trace, processes)
        time.sleep(min(args.every, max(0.0, end_s - time.monotonic())))


def write_trace(path: Path, processes: Processes) -> None:
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(("role", *asdict(processes.samples[0])))
        rows.writerows((processes.roles.get(one.pid, ""), *asdict(one).values()) for one in processes.samples)


def growth(processes: Processes) -> list[dict]:
    """Per process: memory after the warm-up and at the end, and how fast it grew."""
    last_s = max(one.t_s for one in processes.samples)
    rows = []
    for pid, role in processes.roles.items():
        mine = [one for one in processes.samples if one.pid == pid and one.t_s >= _WARM_UP_SHARE * last_s]
        if len(mine) >= _LEAST_SAMPLES:
            rows.append({"process": role, **trend(mine)})
    return [*rows, {"process": "all", **{key: sum(row[key] for row in rows) for key in rows[0] if key != "process"}}]


def trend(samples: list[Sample]) -> dict:
    hours = np.array([one.t_s for one in samples]) / 3600
    slopes = {key: float(np.polyfit(hours, [getattr(one, key) for one in samples], 1)[0]) for key in ("rss_mb", "own_mb")}
    first, last = samples[0], samples[-1]
    return {
        "rss_mb": last.rss_mb,
        "growth_mb_per_h": slopes["rss_mb"],
        "own_growth_mb_per_h": slopes["own_mb"],
        "threads_more": last.threads - first.threads,
        "files_more": last.files - first.files,
        "children_more": last.children - first.children,
    }


def over_time(recording: Path) -> list[dict]:
    """For equal stretches of the session: images and outputs per second, and what they took, ms."""
    images = np.array([(view.t_ns, stages["fused"]) for view, stages in read_detections(recording)], np.int64)
    outputs = np.array([(pose.t_ns, stages["output"]) for pose, stages in read_poses(recording)], np.int64)
    edges = np.linspace(images[0, 0], images[-1, 0], _STRETCHES + 1).astype(np.int64)
    rows = []
    for begin, end in itertools.pairwise(edges.tolist()):
        seconds = (end - begin) / 1e9
        seen, late = (some[(some[:, 0] >= begin) & (some[:, 0] < end)] for some in (images, outputs))
        row = {"minutes": (end - edges[0]) / 60e9, "images_per_s": len(seen) / seconds, "outputs_per_s": len(late) / seconds}
        for name, times in (("fused_ms", seen), ("output_late_ms", late)):
            found = np.percentile((times[:, 1] - times[:, 0]) / 1e6, _PERCENTILES)
            row |= {f"{name} p{share}": value for share, value in zip(_PERCENTILES, found.tolist(), strict=True)}
        rows.append(row)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--every", type=float, default=5.0, help="seconds between two looks")
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--groups", type=int, default=0)
    parser.add_argument("--networks", default="blazepose_full", help="as of `posefuse live`")
    parser.add_argument("--trace", type=Path, help="keep every look in a CSV file")
    parser.add_argument("--session", type=Path, default=Path(__file__).resolve().parents[1] / "examples" / "demo")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        recording = Path(scratch) / "soak.mcap"
        processes, figures, ended = soak(args, recording)
        recorded = sum(1 for _ in read_poses(recording))
        stretches = over_time(recording)
        size_mb = recording.stat().st_size / 2**20
    rows = growth(processes)
    for shown in (rows, stretches):
        table = Table(*shown[0], title=f"{figures['seconds'] / 60:.0f} minutes, {args.cameras} cameras")
        for row in shown:
            table.add_row(*(value if isinstance(value, str) else f"{value:.2f}" for value in row.values()))
        Console(stderr=True, width=140).print(table)
    latency = figures["latency"]
    facts = {
        "minutes": figures["seconds"] / 60,
        "cameras": args.cameras,
        "networks": args.networks,
        **ended,
        "poses": figures["poses"],
        "poses_recorded": recorded,
        "recording_mb": size_mb,
        "outputs_lost": figures["outputs_lost"],
        "recording_dropped": figures["outputs"]["record"]["dropped"],
        "used_share": figures["used_share"],
        "poses_per_s": figures["poses_per_s"],
        "p95_ms": latency["all_cameras_total_ms"]["p95"],
        "restarts": figures["restarts"],
        "events": len(figures["events"]),
    }
    Console(stderr=True, width=140).print("\n".join(f"{key}: {value}" for key, value in facts.items()))
    print(json.dumps({**facts, "processes": rows, "stretches": stretches}, indent=2))


if __name__ == "__main__":
    main()
