"""How processor time per time step grows with cameras and people: the rig monitor, and people who are found all at once.

    python bench/wide.py [--write docs/reliability.md]

Cameras stand on a circle. The rig monitor gets one person's 12 keypoints; people stand 1.6 m apart on a grid, seen by 8 cameras
with 1.5 px of noise, and are all found in one time step.
"""

import time

import numpy as np
from harness import answer, arguments
from scenes import ring

from posefuse.association import AssociateSettings, assign
from posefuse.core import SKELETONS, Detections2D, Rig
from posefuse.core.values import keypoint_boxes
from posefuse.health.misalignment import instant_of, sums_of

COCO = SKELETONS["coco17"]


def ring_of(count: int, radius_m: float) -> Rig:
    return ring(count, (1280, 960), 600.0, radius_m=radius_m, height_m=3.0, begin_rad=0.3)


def monitor_ms(cameras: int) -> float:
    rig, rng = ring_of(cameras, 4.5), np.random.default_rng(0)
    xyz = rng.normal(0, 0.4, (12, 3)) + [0, 0, 1]
    xy = np.stack([camera.project(xyz) for camera in rig]) + rng.normal(0, 2, (cameras, 12, 2))
    now = instant_of(rig, 0, xy)
    began = time.thread_time()
    for _ in range(20):
        sums_of(rig, now, np.zeros((12, 3)))
    return (time.thread_time() - began) / 20 * 1e3


def people_found(people: int, cameras: int = 8) -> dict:
    rig, rng = ring_of(cameras, 12.0), np.random.default_rng(0)
    side = int(np.ceil(np.sqrt(people)))
    body = rng.normal(size=(17, 3)) * [0.15, 0.2, 0.1] + np.linspace(1.6, 0.1, 17)[:, None] * [0, 0, 1]
    places = 1.6 * (np.stack(np.unravel_index(np.arange(people), (side, side)), axis=1) - (side - 1) / 2)
    xyz = body + np.concatenate([places, np.zeros((people, 1))], axis=1)[:, None]
    found = []
    for camera in rig:
        xy = camera.project(xyz[rng.permutation(people)]) + rng.normal(0, 1.5, (people, 17, 2))
        ones = np.ones(xy.shape[:2])
        boxes = keypoint_boxes(xy, ones)
        found.append(
            Detections2D(camera=camera.name, t_ns=0, skeleton=COCO, xy_img=xy, score=ones, sigma_px=2 * ones, box_img=boxes)
        )
    settings = AssociateSettings(max_people=people)
    assign(found, rig, settings, 0)
    began = time.thread_time()
    assigned = assign(found, rig, settings, 0)
    spent_ms = (time.thread_time() - began) * 1e3
    return {"people": people, "found": len(assigned.person_id), "ms": spent_ms}


if __name__ == "__main__":
    monitored = [{"cameras": cameras, "ms": monitor_ms(cameras)} for cameras in (4, 8, 16, 32)]
    together = [people_found(people) for people in (4, 8, 16, 32, 64)]
    answer(arguments(__doc__), {"Rig monitor": monitored, "People found at once": together})
