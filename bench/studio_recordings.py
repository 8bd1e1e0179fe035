"""Seek in a recording of ten minutes: how long until every camera shows the moment, in Python and in a real browser.

    python bench/studio_recordings.py [--minutes 10] [--seeks 40] [--browser /usr/bin/chromium]

The videos are those of `examples/demo`, repeated without encoding them again; so is its result, every second time backwards.
Needs the extra ``studio``; with --browser also playwright and that browser.
"""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
from harness import DEMO, answer, arguments, tracked
from length import there_and_back
from studio_server import free_port, in_chromium, server

from posefuse.api.playback import Playback
from posefuse.api.recording import read, recording_of
from posefuse.pipeline.writing import session_of_recording

TILE_PX = 480


def main() -> None:
    args = arguments(__doc__, minutes=10.0, seeks=40, browser=Path)
    with tempfile.TemporaryDirectory() as folder:
        session, result = long_recording(Path(folder), args.minutes)
        rows = [{"seek": "in Python", **in_python(session, result, args.seeks)}]
        if args.browser is not None:
            rows.append({"seek": "in a browser", **in_browser(Path(folder), args.browser, args.seeks)})
    answer(args, {"Milliseconds until every camera shows the moment": rows}, minutes=args.minutes, cameras=4)


def long_recording(place: Path, minutes: float) -> tuple[Path, Path]:
    """(session, result) of so many minutes."""
    recording = tracked(DEMO)
    period_ns = int(np.median(np.diff(recording.poses.t_ns)))
    length_ns = int(recording.poses.t_ns[-1]) + period_ns
    session, result = place / "long", place / "result"
    (session / "videos").mkdir(parents=True)
    (session / "rig.toml").write_bytes((DEMO / "rig.toml").read_bytes())
    for video in sorted((DEMO / "videos").glob("*.mp4")):
        repeat(video, session / "videos" / video.name, round(minutes * 60e9 / length_ns), length_ns)
    made = {"session": "long", "inputs": {name: f"{name}.mp4" for name in recording.rig.names}}
    long = there_and_back(recording, minutes)
    recording_of(replace(long, provenance={**long.provenance, **made})).save(result)
    return session, result


def repeat(video: Path, out: Path, times: int, length_ns: int) -> None:
    """The packets of a video again and again, each time so much later."""
    with av.open(str(out), "w", format="mp4", options={"movie_timescale": "1000000"}) as container:
        stream = None
        for i in range(times):
            with av.open(str(video)) as source:
                if stream is None:
                    stream = container.add_stream_from_template(source.streams.video[0])
                    stream.time_base = source.streams.video[0].time_base
                shift = round(i * length_ns * 1e-9 / source.streams.video[0].time_base)
                for packet in source.demux(source.streams.video[0]):
                    if packet.dts is not None:
                        packet.pts, packet.dts, packet.stream = packet.pts + shift, packet.dts + shift, stream
                        container.mux(packet)


def in_python(session: Path, result: Path, seeks: int) -> dict[str, float]:
    """Milliseconds from a request to the images of all cameras, one after the other."""
    recording = read(result)
    _ = recording.views
    began = time.perf_counter()
    with Playback(recording, session_of_recording(recording, session)) as playback:
        opened_s, taken = time.perf_counter() - began, []
        for share in np.random.default_rng(1).random(seeks):
            t_ns = int(share * recording.poses.t_ns[-1])
            began = time.perf_counter()
            for camera in playback.cameras:
                playback.at(camera, t_ns, TILE_PX)
            taken.append(1000 * (time.perf_counter() - began))
    return {**spread(taken), "open_s": opened_s}


def in_browser(workspace: Path, browser: Path, seeks: int) -> dict[str, float]:
    """Milliseconds from a click on the timeline to the arrival of the last camera's image in the page."""
    port, taken = free_port(), list[float]()
    with server(workspace, port), in_chromium(port, str(browser)) as watched:
        page = watched.page()
        arrived: list[tuple[float, int]] = []
        page.on("websocket", lambda ws: ws.on("framereceived", lambda data: note(data, arrived)))
        page.goto(f"{watched.base}/recordings?open=result")
        plot = page.locator(".pf-timeline")
        plot.wait_for(timeout=120_000)
        page.wait_for_timeout(8_000)
        plot.scroll_into_view_if_needed()
        box = plot.bounding_box()
        assert box is not None
        for share in np.random.default_rng(2).uniform(0.06, 0.98, seeks):
            arrived.clear()
            began = time.perf_counter()
            # the bare click: the time until the element may be clicked is the tool's, not the page's
            page.mouse.click(box["x"] + float(share) * box["width"], box["y"] + 60)
            while {camera for _, camera in arrived} != set(range(4)) and time.perf_counter() - began < 5:
                page.wait_for_timeout(2)
            taken.append(1000 * (arrived[-1][0] - began))
    return spread(taken)


def note(data: bytes | str, arrived: list[tuple[float, int]]) -> None:
    """Remember an image message (`posefuse_studio.scene.messages`): when it came, of which camera."""
    if isinstance(data, bytes) and data[4:20] == b'{"kind": "image"':
        arrived.append((time.perf_counter(), json.loads(data[4 : 4 + int.from_bytes(data[:4], "little")])["camera"]))


def spread(values: list[float]) -> dict[str, float]:
    return {word: float(np.quantile(values, share)) for word, share in (("median", 0.5), ("p95", 0.95), ("most", 1.0))}


if __name__ == "__main__":
    main()
