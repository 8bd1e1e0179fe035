"""A small session with videos and its result on disk: three cameras, one second, a grey level per frame."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import built
import numpy as np

from posefuse.api.recording import recording_of
from posefuse.core import Kind, Recording, Rig
from posefuse.core.skeleton import COCO17
from posefuse.formats.rig import write_rig
from posefuse.formats.video import VideoWriter
from posefuse.foundation.parsing import plain
from posefuse.pipeline.config import TrackConfig

COUNT, PERIOD_NS, SIZE_WH = 30, 33_333_333, (96, 72)


def grey(camera: int, i: int) -> int:
    """What every pixel of a frame says of itself."""
    return 20 + 60 * camera + 2 * i


def saved_session(folder: Path, ring_rig: Callable[..., Rig]) -> tuple[Path, Path]:
    """The session and the result below a folder."""
    rig, session = ring_rig(3, size_wh=SIZE_WH), folder / "walk"
    (session / "videos").mkdir(parents=True)
    write_rig(session / "rig.toml", rig)
    for c, camera in enumerate(rig):
        with VideoWriter(session / "videos" / f"{camera.name}.mp4", SIZE_WH, 30.0, crf=5) as video:
            for i in range(COUNT):
                video.write(np.full((SIZE_WH[1], SIZE_WH[0], 3), grey(c, i), np.uint8), i * PERIOD_NS)
    recording_of(walk(rig)).save(folder / "result")
    return session, folder / "result"


def walk(rig: Rig) -> Recording:
    """A person who glides along, with exact views."""
    body = np.random.default_rng(1).normal(size=(len(COCO17), 3)) * [0.3, 0.3, 0.4] + [0, 0, 1.0]
    xyz = (body + np.arange(COUNT)[:, None, None] * [0.02, 0.0, 0.0])[:, None]
    xyz[:10, 0, 3] = np.nan
    known = np.isfinite(xyz[..., 0])
    kind = np.where(known, Kind.SMOOTHED, Kind.MISSING)
    poses = built.poses(
        xyz, 0.02, t_ns=np.arange(COUNT) * PERIOD_NS, kind=kind, n_views=len(rig) * known, reproj_px=np.where(known, 2.5, np.nan)
    )
    inputs, config = {name: f"{name}.mp4" for name in rig.names}, plain(dataclasses.asdict(TrackConfig(names=("Ada",))))
    return built.recording(rig, poses, session="walk", recorded="2026-03-01T09:30:00Z", inputs=inputs, config=config)
