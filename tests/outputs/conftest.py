"""A recording with everything an output must survive: several people, gaps, unseen views, interpolated points."""

from collections.abc import Callable, Iterator

import built
import numpy as np
import pytest
from built import recording_from_views

from posefuse.core import Frame, Kind, Recording, Rig, Skeleton

CORNERS = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
SKELETON = Skeleton("five", ("nose", *CORNERS), tuple((CORNERS[a], CORNERS[b]) for a, b in ((0, 1), (0, 2), (1, 3), (2, 3))))
BODY = np.array([[0.1, 0, 1.7], [0, 0.2, 1.4], [0, -0.2, 1.4], [0, 0.15, 0.9], [0, -0.15, 0.9]])


@pytest.fixture
def make_recording(ring_rig: Callable[..., Rig]) -> Callable[..., Recording]:
    return lambda times=7, people=(0,), cameras=3: _recording(ring_rig(cameras), times, people)


def _recording(rig: Rig, times: int, people: tuple[int, ...]) -> Recording:
    walk = np.arange(times)[:, None, None, None] * [0.03, 0, 0] + np.arange(len(people))[:, None, None] * [0, 0.8, 0]
    xyz = BODY + walk
    xyz[times // 2, 0, 0] = np.nan
    kind = np.where(np.isfinite(xyz[..., 0]), Kind.FUSED, Kind.MISSING)
    kind[-1, 0, 1] = Kind.INTERPOLATED
    xy = np.stack([camera.project(xyz) for camera in rig], axis=2)
    score = np.where(np.isfinite(xy).all(axis=-1), 0.8, 0)
    score[0, :, -1], xy[0, :, -1] = 0, np.nan
    t_ns = 2_000_000_000 + np.arange(times) * 40_000_000
    poses = built.poses(xyz, skeleton=SKELETON, cov=np.diag([1e-4, 4e-4, 9e-4]), t_ns=t_ns, ids=people, kind=kind)
    return recording_from_views(
        rig, poses, xy, score, np.where(score > 0, 2.0, np.nan), {"config": {"fuse": "all"}, "rig_id": rig.id}
    )


@pytest.fixture
def grey_frames() -> Callable[..., Iterator[tuple[int, list[Frame | None]]]]:
    """Frame sets whose grey value is 100 + camera; the first camera lacks its frame at time step 1."""

    def make(recording: Recording) -> Iterator[tuple[int, list[Frame | None]]]:
        for i, t_ns in enumerate(recording.poses.t_ns.tolist()):
            frames: list[Frame | None] = []
            for c, camera in enumerate(recording.rig):
                image = np.full((camera.size_wh[1], camera.size_wh[0], 3), 100 + c, np.uint8)
                frames.append(built.frame(camera.name, t_ns, image, seq=i))
            yield t_ns, [None, *frames[1:]] if i == 1 else frames

    return make
