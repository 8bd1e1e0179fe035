"""A live session for a long time: does memory stay flat, and is all of it there after Ctrl-C?

    nice -n 5 python bench/live_soak.py [--minutes 60] [--cameras 4] [--groups 2] [--networks NAME]
        [--session examples/demo]

A simulated session is played at the pace of the clock, again and again, and recorded; then Ctrl-C. Every few seconds the
memory of every process is read. Growth is the slope of a straight line through what was read after the warm-up. Tables on stderr,
one JSON object on stdout.
"""

import argparse
import contextlib
import re
import tempfile
import time
from pathlib import Path

import numpy as np
from harness import DEMO, answer, arguments, live_command
from live_program import Program, children_of, loop_s, running

from posefuse.formats.rig import read_rig
from posefuse_ros.bags import read_poses

_EVERY_S, _WARM_UP_SHARE, _LEAST_SAMPLES = 5.0, 0.3, 5


# seconds after the session began, the process, and MiB of its memory
Sample = tuple[float, int, float]


def soak(args: argparse.Namespace, recording: Path) -> tuple[list[Sample], dict[int, str], dict, dict]:
    """Run, watch, Ctrl-C: samples, the processes, the session's own figures, and how it ended."""
    names = read_rig(args.session / "rig.toml").names[: args.cameras]
    options = ["--loop", loop_s(args.session), "--record", recording, "--networks", args.networks]
    options += ["--groups", args.groups] if args.groups else []
    sources = [f"{name}=sim:{args.session}" for name in names]
    program = Program(live_command(args.session / "rig.toml", sources, *options))
    samples: list[Sample] = []
    try:
        program.wait_for(": ok")
        watch(program, samples, args.minutes)
        if program.process.poll() is not None:
            last = "".join(program.notes[-80:])
            raise SystemExit(f"the session ended by itself after {samples[-1][0]:.0f} s: {last}")
        pids, stopping_s = {pid for _, pid, _ in samples}, time.monotonic()
        figures = program.stopped()
        ended = {"stop_s": time.monotonic() - stopping_s, "left_over": sum(map(running, pids))}
        return samples, program.roles(), figures, ended
    finally:
        program.kill()


def watch(program: Program, samples: list[Sample], minutes: float) -> None:
    begun_s, pid = time.monotonic(), program.process.pid
    while program.process.poll() is None and (t_s := time.monotonic() - begun_s) < 60 * minutes:
        for each in (pid, *children_of(pid)):
            with contextlib.suppress(OSError, TypeError):  # it has ended, or is about to
                status = Path(f"/proc/{each}/status").read_text()
                samples.append((t_s, each, int(re.search(r"VmRSS:\s+(\d+)", status)[1]) / 1024))
        time.sleep(min(_EVERY_S, max(0.0, begun_s + 60 * minutes - time.monotonic())))


def growth(samples: list[Sample], roles: dict[int, str]) -> list[dict]:
    """Per process: memory at the end, and how fast it grew after the warm-up."""
    t_s, pids, memory_mb = np.array(samples).T
    late, rows = t_s >= _WARM_UP_SHARE * t_s[-1], []
    for pid in dict.fromkeys(pids.astype(int).tolist()):
        mine = late & (pids == pid)
        if mine.sum() >= _LEAST_SAMPLES:
            slope = float(np.polyfit(t_s[mine] / 3600, memory_mb[mine], 1)[0])
            rows.append({"process": roles.get(pid, "other"), "rss_mb": float(memory_mb[mine][-1]), "growth_mb_per_h": slope})
    return [*rows, {"process": "all", **{key: sum(row[key] for row in rows) for key in ("rss_mb", "growth_mb_per_h")}}]


def main() -> None:
    args = arguments(__doc__, minutes=60.0, cameras=4, groups=0, networks="blazepose_full", session=DEMO)
    with tempfile.TemporaryDirectory() as scratch:
        recording = Path(scratch) / "soak.mcap"
        samples, roles, figures, ended = soak(args, recording)
        recorded, size_mb = sum(1 for _ in read_poses(recording)), recording.stat().st_size / 2**20
    facts = {
        "minutes": figures["seconds"] / 60,
        "cameras": args.cameras,
        "networks": args.networks,
        **ended,
        "poses_recorded": recorded,
        "recording_mb": size_mb,
        "recording_dropped": figures["outputs"]["record"]["dropped"],
        **{name: figures[name] for name in ("poses", "outputs_lost", "used_share", "poses_per_s", "restarts")},
        "p95_ms": figures["latency"]["all_cameras_total_ms"]["p95"],
        "events": len(figures["events"]),
    }
    answer(args, {"Session": [facts], "Processes": growth(samples, roles)})


if __name__ == "__main__":
    main()
