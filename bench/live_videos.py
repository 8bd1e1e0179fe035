"""What keeping the cameras' videos costs a live session.

    python bench/live_videos.py [--session examples/demo] [--seconds 8] [--repeat 3] [--only-writing]

Processor time per frame of 640 x 480 px, with the camera's own packets copied and with images encoded, measured alone; then the
share of frames that a session of four such cameras at 30 frames/s uses, with and without ``--videos``, in turns: so a machine
that others use does not favour one of them. A table on stderr, one JSON object on stdout.
"""

import tempfile
import time
from pathlib import Path

from harness import DEMO, answer, arguments, live, medians, sources_of

from posefuse.formats.kept_video import KeptVideo
from posefuse.formats.pixels import RgbPixels
from posefuse.sources.video import VideoConfig


def writing(video: Path, encoded: bool, folder: Path) -> dict:
    """Milliseconds of processor time per frame, and kilobytes."""
    frames = list(VideoConfig(video, "camera", keep_encoded=encoded).build().frames())
    path = folder / f"{'copied' if encoded else 'encoded'}.mp4"
    begun_s = time.process_time()
    with KeptVideo(path) as kept:
        for frame in frames:
            kept.write(frame.encoded or RgbPixels(frame.image), frame.t_ns)
    cpu_ms = 1000 * (time.process_time() - begun_s) / len(frames)
    return {"how": kept.how, "cpu_ms_per_frame": cpu_ms, "kb_per_frame": path.stat().st_size / 1000 / len(frames)}


def session(folder: Path, seconds: float, *options: object) -> dict:
    """Frames used, processor time, frames written and dropped of one `posefuse live`."""
    figures = live(folder / "rig.toml", sources_of(folder), "--networks", "blazepose_full", "--duration", seconds, *options)
    kept = figures.get("videos", {}).values()
    return {
        **{name: figures[name] for name in ("used_share", "cpu_children_share")},
        "p50_ms": figures["latency"]["all_cameras_total_ms"]["p50"],
        **{name: sum(one[name] for one in kept) for name in ("written", "dropped")},
    }


def main() -> None:
    args = arguments(__doc__, session=DEMO, seconds=8.0, repeat=3, only_writing=False)
    with tempfile.TemporaryDirectory() as scratch:
        video = sorted((args.session / "videos").glob("*.mp4"))[0]
        tables = {"Writing": [writing(video, encoded, Path(scratch)) for encoded in (True, False)]}
        runs: dict[str, list[dict]] = {"without": [], "with": []}
        for i in range(0 if args.only_writing else args.repeat):
            runs["without"].append(session(args.session, args.seconds))
            runs["with"].append(session(args.session, args.seconds, "--videos", Path(scratch) / f"kept{i}"))
    sessions = [{"videos": name, **medians(found)} for name, found in runs.items() if found]
    answer(args, tables | ({"Sessions": sessions} if sessions else {}))


if __name__ == "__main__":
    main()
