"""What keeping the cameras' videos costs a live session.

    python bench/live_videos.py [--session examples/demo] [--seconds 8] [--repeat 3] [--only-writing]

Processor time per frame of 640 x 480 px, with the camera's own packets copied and with images encoded, measured alone; then the
share of frames that a session of four such cameras at 30 frames/s uses, with and without ``--videos``, in turns: so a machine
that others use does not favour one of them. A table on stderr, one JSON object on stdout.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from posefuse.formats.kept_video import KeptVideo
from posefuse.formats.pixels import RgbPixels
from posefuse.sources.video import VideoConfig

NETWORK = "blazepose_full"


def writing(video: Path, encoded: bool, folder: Path) -> dict:
    """Milliseconds of processor time per frame, and kilobytes."""
    frames = list(VideoConfig(video, "camera", keep_encoded=encoded).build().frames())
    path = folder / f"{'copied' if encoded else 'encoded'}.mp4"
    begun_s = time.process_time()
    with KeptVideo(path) as kept:
        for frame in frames:
            kept.write(frame.encoded or RgbPixels(frame.image), frame.t_ns)
    spent_s = time.process_time() - begun_s
    return {
        "how": kept.how,
        "cpu_ms_per_frame": 1000 * spent_s / len(frames),
        "kb_per_frame": path.stat().st_size / 1000 / len(frames),
    }


def session(folder: Path, seconds: float, videos: Path | None) -> dict:
    """Frames used, processor time, frames written and dropped of one `posefuse live`."""
    command = [sys.executable, "-m", "posefuse.cli.main", "live", str(folder / "rig.toml"), "--json", "--networks", NETWORK]
    command += ["--duration", str(seconds)]
    for path in sorted((folder / "videos").glob("*.mp4")):
        command += ["--source", f"{path.stem}=video:{path}"]
    command += ["--videos", str(videos)] if videos else []
    figures = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    kept = figures.get("videos", {}).values()
    return {
        "used_share": figures["used_share"],
        "cpu_children_share": figures["cpu_children_share"],
        "p50_ms": figures["latency"]["all_cameras_total_ms"]["p50"],
        "written": sum(one["written"] for one in kept),
        "dropped": sum(one["dropped"] for one in kept),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--session", type=Path, default=Path(__file__).resolve().parents[1] / "examples" / "demo")
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--only-writing", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        video = sorted((args.session / "videos").glob("*.mp4"))[0]
        rows = [writing(video, encoded, Path(scratch)) for encoded in (True, False)]
        runs: dict[str, list[dict]] = {"without": [], "with": []}
        for i in range(0 if args.only_writing else args.repeat):
            runs["without"].append(session(args.session, args.seconds, None))
            runs["with"].append(session(args.session, args.seconds, Path(scratch) / f"kept{i}"))
    medians = {
        name: {key: statistics.median(run[key] for run in found) for key in found[0]} for name, found in runs.items() if found
    }
    for found in (rows, [{"videos": name, **row} for name, row in medians.items()]):
        if found:
            table = Table(*found[0])
            for row in found:
                table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()))
            Console(stderr=True, width=140).print(table)
    print(json.dumps({"writing": rows, "sessions": medians}, indent=2))


if __name__ == "__main__":
    main()
