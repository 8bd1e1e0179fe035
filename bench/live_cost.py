"""Where the processor time of a live session goes: per frame captured, per image used, per output tick.

    python bench/live_cost.py [--networks blazepose_lite] [--cameras 8] [--seconds 6] [--session examples/demo] [--record]
    python bench/live_cost.py --empty --seconds 20
    python bench/live_cost.py --videos

What the threads of a running `posefuse live` take is counted (Linux: /proc), the start-up left out; several programs on the
machine lengthen that, as they share caches and cores. Milliseconds of processor time, not of the clock. ``--empty`` shows the
cameras their own rooms without the person, with a camera's noise. ``--videos`` counts instead what keeping a video takes, with
the camera's own packets copied and with images encoded. Tables on stderr, one JSON object on stdout.
"""

import tempfile
import time
from pathlib import Path

import numpy as np
from harness import DEMO, Row, answer, arguments, live_command
from live import TWIN, twins
from live_program import Program, thread_seconds

from posefuse.formats.kept_video import KeptVideo
from posefuse.formats.pixels import RgbPixels
from posefuse.formats.rig import read_rig
from posefuse.formats.video import VideoWriter
from posefuse.sources.video import VideoConfig

# of a session that is not counted: its beginning; of an empty room, until it is searched rarely
_LEAD_S, _EMPTY_LEAD_S = 1.5, 16.0


def empty_rooms(session_folder: Path, folder: Path, seconds: float) -> dict[str, Path]:
    """Videos by camera: the median of its images over time, which the person who walks is not in, with noise of 4 levels."""
    rng, made = np.random.default_rng(0), {}
    for video in sorted((session_folder / "videos").glob("*.mp4")):
        images = [frame.image for frame in VideoConfig(video, video.stem).build().frames()][::12]
        room = np.median(images, axis=0)
        noisy = [(room + 4 * rng.normal(size=room.shape)).clip(0, 255).astype(np.uint8) for _ in range(15)]
        made[video.stem] = folder / video.name
        with VideoWriter(made[video.stem], (room.shape[1], room.shape[0]), 30.0, crf=20, preset="ultrafast") as writer:
            for i in range(round(30 * seconds)):
                writer.write(noisy[i % len(noisy)], round(i * 1e9 / 30))
    return made


def session(rig: Path, sources: list[str], seconds: float, lead_s: float, *options: object) -> dict[str, list[Row]]:
    """Cores by what the threads of a live session of these sources do; and its own figures."""
    program = Program(live_command(rig, sources, *options))
    try:
        program.wait_for(": ok")
        time.sleep(lead_s)
        before, begun_s = thread_seconds(program.process.pid), time.monotonic()
        time.sleep(seconds)
        after, took_s = thread_seconds(program.process.pid), time.monotonic() - begun_s
        role = program.roles()
        if not any(role.get(pid) == "cameras" for pid, _ in after):
            raise SystemExit("the videos ended before the measurement: fewer --seconds")
        figures = program.stopped()
    finally:
        program.kill()
    cores: dict[str, float] = {}
    for (pid, thread), total_s in after.items():
        name = role.get(pid, "other")
        name += {"cameras": ": detection" if thread == pid else ": capture"}.get(name, "")
        cores[name] = cores.get(name, 0.0) + (total_s - before.get((pid, thread), 0.0)) / took_s
    captured, used = (sum(c[key] for c in figures["cameras"].values()) / figures["seconds"] for key in ("captured", "used"))
    facts = {
        "cores_in_all": sum(cores.values()),
        "ms_per_frame_captured": 1000 * cores.get("cameras: capture", 0.0) / captured,
        "ms_per_image_used": 1000 * sum(cores.values()) / used if used else None,
        "ms_per_tick_of_fusion": 1000 * cores["fusion"] / figures["poses_per_s"],
        "used_share": figures["used_share"],
        "latency_ms": figures["latency"]["all_cameras_total_ms"],
        "tick_late_p99_ms": figures["latency"]["output"]["behind_due_ms"]["p99"],
    }
    return {"In a session": [{"in a session": name, "cores": value} for name, value in cores.items()], "Session": [facts]}


def writing(video: Path, encoded: bool, folder: Path) -> Row:
    """Milliseconds of processor time per frame, and kilobytes."""
    frames = list(VideoConfig(video, "camera", keep_encoded=encoded).build().frames())
    path = folder / f"{'copied' if encoded else 'encoded'}.mp4"
    begun_s = time.process_time()
    with KeptVideo(path) as kept:
        for frame in frames:
            kept.write(frame.encoded or RgbPixels(frame.image), frame.t_ns)
    cpu_ms = 1000 * (time.process_time() - begun_s) / len(frames)
    return {"how": kept.how, "cpu_ms_per_frame": cpu_ms, "kb_per_frame": path.stat().st_size / 1000 / len(frames)}


def main() -> None:
    args = arguments(
        __doc__, networks="blazepose_lite", cameras=8, seconds=6.0, session=DEMO, empty=False, record=False, videos=False
    )
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        if args.videos:
            video = sorted((args.session / "videos").glob("*.mp4"))[0]
            answer(args, {"Keeping a video": [writing(video, encoded, scratch) for encoded in (True, False)]})
            return
        rig, lead_s = scratch / "rig.toml", _EMPTY_LEAD_S if args.empty else _LEAD_S
        sources = twins(args.session, rig, args.cameras // 4 - 1)
        if args.empty:
            rooms = empty_rooms(args.session, scratch, args.seconds + lead_s + 2)
            sources = [f"{name}=video:{rooms[name.replace(TWIN, '')]}" for name in read_rig(rig).names]
        options = ["--networks", args.networks, *(["--record", scratch / "session.mcap"] if args.record else [])]
        tables = session(rig, sources, args.seconds, lead_s, *options)
    answer(args, tables, cameras=args.cameras, networks=args.networks)


if __name__ == "__main__":
    main()
