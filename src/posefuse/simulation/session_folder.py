"""The folder of a simulated session: its paths, and what becomes of a session that is there already."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from posefuse.core import InputError
from posefuse.foundation.output_folder import check_replaceable

from .scene import Scene
from .scene_files import SCENE_FILE, scene_text

COMMAND = "simulate"
MARKER_TEXT = "This session is not finished. Simulate the same scene into this folder to continue.\n"


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
    def incomplete(self) -> Path:
        """Marks a session that is not finished."""
        return self.folder / "INCOMPLETE"

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


def is_resumed(paths: SessionPaths, scene: Scene, replace: bool) -> bool:
    """Whether an unfinished session of this scene is there.

    Raises:
        InputError: anything else is there, unless it is a session of posefuse and may be moved aside (`replace`).
    """
    if not _is_unfinished(paths):
        check_replaceable(paths.folder, command=COMMAND, replace=replace)
        return False
    if not paths.scene.is_file() or paths.scene.read_text(encoding="utf-8") == scene_text(scene):
        return True
    if not replace:
        raise InputError(
            f"{paths.folder}: holds an unfinished session of another scene; choose another folder, or move it aside "
            "with `replace=True`"
        )
    return False


def _is_unfinished(paths: SessionPaths) -> bool:
    """Whether the marker is there, and is ours."""
    try:
        return paths.incomplete.read_text(encoding="utf-8") == MARKER_TEXT
    except (OSError, ValueError):
        return False
