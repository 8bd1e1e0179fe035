"""A simulated camera for the live pipeline: frames come at the pace of the clock, as from a real one.

Either drawn as they fall due (`scene`), or read from a rendered session (`session`). A camera that cannot keep up loses
frames, as real ones do: `seq` shows the gaps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from posefuse.core import Camera, Frame, SourceError
from posefuse.core.arrays import Array
from posefuse.core.depth import DepthImage
from posefuse.core.errors import choices
from posefuse.formats.image_folders import DepthFolder
from posefuse.formats.npz import read_arrays
from posefuse.formats.truth import read_truth
from posefuse.sources import VideoConfig

from .build import LiveScene, live_scene
from .render.model import render_model
from .render.shot import CameraShooter, shot_image
from .render.stage import RenderStage, working_backend
from .scene import read_scene
from .session import SessionPaths

# numbers (F,), stamps (F,) in ns, and the image and depth of the frame at a place, asked for in order
_Film = tuple[Array, Array, Callable[[int], tuple[Array, DepthImage | None]]]


@dataclass(frozen=True)
class SimulatedConfig:
    """One simulated camera.

    Attributes:
        path: a scene file, to draw frames as they fall due; or a session folder with H.264 videos, to play them.
        camera: its name.
        paced: wait for the clock; False gives every frame as fast as it can be made.
        zero_ns: monotonic time at which the session clock shows 0, so that several cameras agree; None is when the first
            frame is asked for.
    """

    path: Path
    camera: str
    paced: bool = True
    zero_ns: int | None = None

    @staticmethod
    def cameras(path: Path) -> tuple[str, ...]:
        """Names of the cameras of a scene file or a rendered session; raises SourceError or InputError for unusable files."""
        return read_truth(SessionPaths(path).truth).rig.names if path.is_dir() else live_scene(read_scene(path)).rig.names

    def build(self) -> SimulatedSource:
        """Read the scene or session; raises SourceError for an unknown camera, InputError for unusable files."""
        return SimulatedSource(self)


class SimulatedSource:
    """Frames of one simulated camera, stamped by its own clock. Ends with the scene; `frames` starts again from the beginning."""

    def __init__(self, config: SimulatedConfig) -> None:
        self._config, self.camera, path = config, config.camera, Path(config.path)
        live = None if path.is_dir() else live_scene(read_scene(path))
        rig = read_truth(SessionPaths(path).truth).rig if live is None else live.rig
        if self.camera not in rig.names:
            raise SourceError(f"{path}: no camera {self.camera!r}; there are: {choices(rig.names)}")
        camera = rig[self.camera]
        self.size_wh = camera.size_wh
        self._open = partial(_played, SessionPaths(path), camera) if live is None else partial(_drawn, live)
        self._index = rig.names.index(self.camera)

    def frames(self) -> Iterator[Frame]:
        """Frames in time order; paced ones are skipped once the next one is due."""
        with self._open(self._index) as (seq, stamp_ns, image_at):
            zero_ns = self._config.zero_ns if self._config.zero_ns is not None else time.monotonic_ns()
            for k, t_ns in enumerate(stamp_ns):
                if self._config.paced:
                    if k + 1 < len(seq) and time.monotonic_ns() - zero_ns > stamp_ns[k + 1]:
                        continue
                    time.sleep(max(0, zero_ns + int(t_ns) - time.monotonic_ns()) / 1e9)
                image, depth = image_at(k)
                yield Frame(
                    camera=self.camera, seq=int(seq[k]), t_ns=int(t_ns), received_ns=time.monotonic_ns() - zero_ns, image=image,
                    depth=depth,
                )  # fmt: skip

    def close(self) -> None:
        """Nothing stays open between calls of `frames`."""


@contextmanager
def _drawn(live: LiveScene, i: int) -> Iterator[_Film]:
    """Frames of camera number `i` drawn when asked for; OpenGL lives in the thread that asks."""
    camera, shots = live.rig.cameras[i], live.shots[i]
    backend = working_backend()
    stage = RenderStage(render_model(live, [camera], backend), backend)
    try:
        shooter = CameraShooter(camera, live.placed[i].sensor, stage)

        def drawn(k: int) -> tuple[Array, DepthImage | None]:
            shot = shot_image(live, i, k, shooter)
            return shot.image, shot.depth

        yield shots.seq, shots.stamp_ns, drawn
    finally:
        stage.close()


@contextmanager
def _played(paths: SessionPaths, camera: Camera, i: int) -> Iterator[_Film]:
    """Frames of the video of camera number `i`, decoded in order."""
    shots = read_arrays(paths.shots)
    frames = VideoConfig(paths.video(camera.name), camera.name, threads=False).build().frames()
    stamp_ns, folder = shots[f"stamp{i}_ns"], paths.depth(camera.name)
    depths = DepthFolder(folder) if folder.is_dir() else None

    def played(k: int) -> tuple[Array, DepthImage | None]:
        image = next(frame.image for frame in frames if frame.seq == k)
        return image, depths.at(int(stamp_ns[k]), camera.size_wh) if depths else None

    yield shots[f"seq{i}"], stamp_ns, played
