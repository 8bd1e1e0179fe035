"""A simulated camera for the live pipeline: the frames of a rendered session at the pace of the clock, as from a real camera.

A camera that cannot keep up loses frames, as real ones do: `seq` shows the gaps.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from posefuse.core import Frame, Rig, SourceError
from posefuse.core.errors import choices
from posefuse.formats.image_folders import DepthFolder
from posefuse.formats.npz import read_arrays
from posefuse.formats.truth import read_truth
from posefuse.sources import VideoConfig

from .session import SessionPaths


@dataclass(frozen=True)
class SimulatedConfig:
    """One simulated camera.

    Attributes:
        path: a session folder with H.264 videos.
        camera: its name.
        paced: wait for the clock; False gives every frame as fast as it can be decoded.
        zero_ns: monotonic time at which the session clock shows 0, so that several cameras agree; None is when the first
            frame is asked for.
    """

    path: Path
    camera: str
    paced: bool = True
    zero_ns: int | None = None

    @staticmethod
    def cameras(path: Path) -> tuple[str, ...]:
        """Names of the cameras of a rendered session; raises SourceError or InputError for anything else."""
        return _rig(path).names

    def build(self) -> SimulatedSource:
        """Read the session; raises SourceError for an unknown camera, or a scene; InputError for unusable files."""
        return SimulatedSource(self)


class SimulatedSource:
    """Frames of one simulated camera, stamped by its own clock; each call of `frames` starts from the beginning."""

    def __init__(self, config: SimulatedConfig) -> None:
        self._config, self.camera, self._paths = config, config.camera, SessionPaths(Path(config.path))
        rig = _rig(Path(config.path))
        if self.camera not in rig.names:
            raise SourceError(f"{config.path}: no camera {self.camera!r}; there are: {choices(rig.names)}")
        self.size_wh = rig[self.camera].size_wh
        self._index = rig.names.index(self.camera)

    def frames(self) -> Iterator[Frame]:
        """Frames in time order; paced ones are skipped once the next one is due."""
        shots, folder = read_arrays(self._paths.shots), self._paths.depth(self.camera)
        seq, stamp_ns = shots[f"seq{self._index}"], shots[f"stamp{self._index}_ns"]
        video = VideoConfig(self._paths.video(self.camera), self.camera, threads=False).build().frames()
        depths = DepthFolder(folder) if folder.is_dir() else None
        zero_ns = self._config.zero_ns if self._config.zero_ns is not None else time.monotonic_ns()
        for k, t_ns in enumerate(stamp_ns.tolist()):
            if self._config.paced:
                if k + 1 < len(seq) and time.monotonic_ns() - zero_ns > stamp_ns[k + 1]:
                    continue
                time.sleep(max(0, zero_ns + t_ns - time.monotonic_ns()) / 1e9)
            image = next(frame.image for frame in video if frame.seq == k)
            depth = depths.at(t_ns, self.size_wh) if depths else None
            yield Frame(
                camera=self.camera, seq=int(seq[k]), t_ns=t_ns, received_ns=time.monotonic_ns() - zero_ns, image=image,
                depth=depth,
            )  # fmt: skip

    def close(self) -> None:
        """Nothing stays open between calls of `frames`."""


def _rig(path: Path) -> Rig:
    """The exact cameras of a session."""
    if path.is_file():
        raise SourceError(f"{path}: expected the folder of a session; of a scene: `posefuse simulate SCENE.yaml --out SESSION`")
    return read_truth(SessionPaths(path).truth).rig
