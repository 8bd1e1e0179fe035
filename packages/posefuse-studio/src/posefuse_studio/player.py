"""One visitor's playback of one recording: where it stands, and what the elements of the page draw there."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

import posefuse as pf
from posefuse.api.playback import Playback
from posefuse.core import InputError, JointAngles
from posefuse.core.arrays import Array
from posefuse.outputs.drawing import person_rgb
from posefuse_studio.scene_messages import image_message, page_message, poses_message, setup_message
from posefuse_studio.state import Stream

TILE_PX = 480
# frames per second while playing: what several videos cost a small computer to decode
_PLAY_HZ = 12.0


def open_recording(path: Path, within: Path) -> Playback[pf.Recording]:
    """Read a recording and open its videos, if they lie in the folder `within`; takes seconds for a long one.

    Raises:
        PosefuseError: not a recording, or damaged.
    """
    recording = pf.read(path)
    _ = recording.views  # kept for every image that follows
    return recording.playback(within=within)


def angles_and_strikes(path: Path) -> tuple[JointAngles | None, Sequence[Mapping[str, Array]]]:
    """Angles of all people of a recording, straight from its points (None where there are none), and per person N when feet land.

    Strikes are by side, session seconds; none of a person who does not walk.
    """
    recording = pf.read(path)
    strikes = [gait.strike_s if gait else {} for gait in recording.gait()]
    try:
        return recording.joint_angles(fit="none"), strikes
    except InputError:
        return None, strikes


class ResultPlayer:
    """Moves over a recording; the newest place asked for wins.

    Args:
        playback: of the recording. stream: what it draws to.

    Attributes:
        recording: what is shown. times_s: (T,) its session seconds; begin_s, end_s: the first and the last.
        t_s: current position, session seconds. playing: whether playback runs. speed: of playback.
    """

    def __init__(self, playback: Playback[pf.Recording], stream: Stream) -> None:
        self.playback, self._stream = playback, stream
        self.recording = playback.recording
        self.times_s: Array = self.recording.poses.t_ns / 1e9
        self.begin_s, self.end_s = (float(self.times_s[0]), float(self.times_s[-1])) if len(self.times_s) else (0.0, 0.0)
        self.t_s, self.playing, self.speed = self.begin_s, False, 1.0
        self._wanted: float | None = None
        self._busy = False
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Draw what stays, and the first moment; call in the event loop."""
        recording = self.recording
        self._stream.publish("setup", setup_message(recording.rig, recording.poses.skeleton), keep=True)
        names = dict(zip(recording.poses.person_id.tolist(), recording.person_names, strict=True))
        self._stream.publish("labels", page_message("labels", content=names), keep=True)
        self.seek(self.playback.begin_ns / 1e9)

    def seek(self, t_s: float) -> None:
        """Go to a time; the 3D view follows at once, the videos as soon as they are decoded."""
        self.t_s = self._wanted = float(np.clip(t_s, self.begin_s, self.end_s))
        poses, i = self.recording.poses, self._step
        pose = poses_message(self.t_s, poses.person_id, poses.xyz_world[i], poses.cov_world[i])
        self._stream.publish("pose", pose, keep=True)
        if not self._busy:
            self._busy = True
            self._task = asyncio.create_task(self._show())

    def step(self, count: int) -> None:
        """Move by a number of time steps."""
        self.seek(float(self.times_s[np.clip(self._step + count, 0, len(self.times_s) - 1)]))

    async def toggle(self) -> None:
        """Stop, or move on until this is called again or the end is there."""
        self.playing = not self.playing
        if self.playing and self.t_s >= self.end_s:
            self.seek(self.begin_s)
        last = time.monotonic()
        while self.playing and self.t_s < self.end_s:
            await asyncio.sleep(1 / _PLAY_HZ)
            now = time.monotonic()
            self.seek(self.t_s + (now - last) * self.speed)
            last = now
        self.playing = False

    def close(self) -> None:
        """Stop and release the videos."""
        self.playing = False
        self.playback.close()

    @property
    def _step(self) -> int:
        return self.playback.step_at(round(self.t_s * 1e9))

    async def _show(self) -> None:
        try:
            while (t_s := self._wanted) is not None:
                self._wanted = None
                await asyncio.gather(*(self._show_camera(c, t_s) for c in range(len(self.playback.cameras))))
        finally:
            self._busy = False

    async def _show_camera(self, c: int, t_s: float) -> None:
        playback = self.playback
        seen = await asyncio.to_thread(playback.at, playback.cameras[c], round(t_s * 1e9), TILE_PX)
        if seen is None:
            image = image_message(t_s, c, b"", playback.shown_wh(c, TILE_PX))
        else:
            rgba = [(*person_rgb(person), 255) for person in self.recording.poses.person_id.tolist()]
            drawn = {"detected_px": seen.detected_px, "projected_px": seen.projected_px, "rgba": rgba}
            image = image_message(seen.t_ns / 1e9, c, seen.jpeg, seen.size_wh, **drawn)  # type: ignore[arg-type]
        self._stream.publish(("image", c), image, keep=True)
