"""Where things are in the folder of a simulated session."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .scene_files import SCENE_FILE


@dataclass(frozen=True)
class SessionPaths:
    """Where things are in a session folder."""

    folder: Path

    @property
    def rig(self) -> Path:
        """The exact cameras."""
        return self.folder / "rig.toml"

    @property
    def videos(self) -> Path:
        """One video or image folder per camera."""
        return self.folder / "videos"

    @property
    def scene(self) -> Path:
        """Every setting."""
        return self.folder / SCENE_FILE

    @property
    def truth(self) -> Path:
        """`core.Truth`."""
        return self.folder / "truth" / "truth.npz"

    @property
    def shots(self) -> Path:
        """True and stamped times of every frame."""
        return self.folder / "truth" / "shots.npz"

    @property
    def props(self) -> Path:
        """Exact poses and pixels of the props."""
        return self.folder / "truth" / "props.npz"

    @property
    def parts(self) -> Path:
        """Finished runs of frames of an unfinished session."""
        return self.folder / "parts"

    def depth(self, camera: str) -> Path:
        """The depth images of a camera."""
        return self.folder / "depth" / camera

    def video(self, camera: str) -> Path:
        """The H.264 video of a camera."""
        return self.videos / f"{camera}.mp4"
