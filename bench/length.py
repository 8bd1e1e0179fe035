"""How processor time and memory of `track`, `report` and `compare` grow with the length of a recording of one person.

    python bench/length.py [SESSION] [--minutes 1 4 8] [--only report compare] [--write docs/reliability.md]

The session (default: examples/demo) is tracked once; a result folder is taken as it is. Its observations are then put one
after the other, every second time backwards, so that the person moves on without a jump. `solve` is `posefuse solve RESULT`:
all but decoding and detection. `bodies` is the same with `--body on`. `track` is `posefuse track` of the session's videos of
its first and third camera, put end to end, with `blazepose_lite` and `--people 1`. Each command is a process of its own;
memory is the largest that its system call reports; that of an hour is what the two longest recordings make of it along a
straight line.
"""

import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
from harness import DEMO, POSEFUSE, answer, arguments, note, retimed, tracked

from posefuse.core import Observations, Recording
from posefuse.formats.recording import ABOUT_FILE, read_recording, write_recording

_TRACK = ("--networks", "blazepose_lite", "--people", "1", "--outputs", "trc")
COMMANDS = ("track", "solve", "bodies", "report", "compare")


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
    last = len(log.step_t_ns) - 1
    ends_ns = int(log.step_t_ns[0] + log.step_t_ns[-1])
    back = retimed(log, order, last - log.frame_step[order], ends_ns - log.step_t_ns[::-1])
    return replace(back, frame_t_ns=ends_ns - log.frame_t_ns[order])


def _later(log: Observations, later_ns: int) -> Observations:
    return replace(log, step_t_ns=log.step_t_ns + later_ns, frame_t_ns=log.frame_t_ns + later_ns)


def end_to_end(session: Path, minutes: float, folder: Path) -> None:
    """A session of two of the videos, each repeated to this length."""
    (folder / "videos").mkdir(parents=True)
    shutil.copy(session / "rig.toml", folder)
    for file in sorted((session / "videos").iterdir())[:3:2]:
        with av.open(str(file)) as clip, av.open(str(folder / "videos" / file.name), "w") as long:
            [stream] = clip.streams.video
            out = long.add_stream_from_template(stream)
            packets = [(bytes(one), one.pts, one.dts, one.duration, one.is_keyframe) for one in clip.demux(stream) if one.size]
            span = max(pts + duration for _, pts, _, duration, _ in packets)
            for i in range(round(minutes * 60 / float(span * stream.time_base))):
                for content, pts, dts, duration, is_keyframe in packets:
                    packet = av.Packet(content)
                    packet.stream, packet.time_base, packet.is_keyframe = out, stream.time_base, is_keyframe
                    packet.pts, packet.dts, packet.duration = pts + i * span, dts + i * span, duration
                    long.mux(packet)


# a small process of its own: memory of a command counts from that of the process that starts it
_MEASURE = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
sys.exit(done.returncode)
"""


def measured(command: list[str]) -> tuple[float, float]:
    """Processor seconds and MiB of a command."""
    words = [sys.executable, "-c", _MEASURE, *POSEFUSE, *command]
    cpu_s, memory_mib = subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True).stdout.split()
    return float(cpu_s), float(memory_mib)


def main() -> None:
    args = arguments(
        __doc__,
        positional=("session",),
        session=DEMO,
        minutes=(1.0, 4.0, 8.0),
        only=dict.fromkeys(COMMANDS),
    )
    rows: dict[str, dict] = {name: {"command": name} for name in args.only}
    used_mib: dict[str, list[float]] = {name: [] for name in args.only}
    is_result = (args.session / ABOUT_FILE).is_file()
    recording = read_recording(args.session) if is_result else tracked(args.session)
    with tempfile.TemporaryDirectory() as scratch:
        long, out = Path(scratch) / "long", Path(scratch) / "out"
        solve = ["solve", str(long), "--out", str(out), "--outputs", "trc", "--set"]
        commands = {
            "track": ["track", str(long / "session"), "--out", str(out), *_TRACK],
            "solve": [*solve, "body=off"],
            "bodies": [*solve, "body=on"],
            "report": ["report", str(long), "--out", str(out)],
            "compare": ["compare", str(long), str(long), "--out", str(out)],
        }
        for minutes in args.minutes:
            long.mkdir()
            write_recording(long, there_and_back(recording, minutes))
            if "track" in args.only:
                end_to_end(args.session, minutes, long / "session")
            for name in args.only:
                cpu_s, memory_mib = measured(commands[name])
                rows[name][f"{minutes:g} min"] = f"{cpu_s:.0f} s, {memory_mib:.0f} MiB"
                used_mib[name].append(memory_mib)
                note(f"{name} {minutes:g} min: {cpu_s:.0f} s, {memory_mib:.0f} MiB")
                shutil.rmtree(out, ignore_errors=True)
            shutil.rmtree(long)
    for name, memory_mib in used_mib.items():
        slope_mib = (memory_mib[-1] - memory_mib[-2]) / (args.minutes[-1] - args.minutes[-2])
        rows[name]["an hour"] = f"{memory_mib[-1] + slope_mib * (60 - args.minutes[-1]):.0f} MiB"
    answer(args, {"Processor time and memory": list(rows.values())})


if __name__ == "__main__":
    main()
