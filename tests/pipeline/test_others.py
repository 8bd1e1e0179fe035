"""People seen but not asked for."""

import numpy as np
from built import detections

from posefuse.association import AssociateSettings
from posefuse.core import DetectionBatch, Detections2D, LookKind, Observations
from posefuse.core.skeleton import COCO17
from posefuse.pipeline.track import others_line, others_seen

K = len(COCO17)
BODY = np.random.default_rng(4).uniform([0, 0], [60, 200], (K, 2))


def view(camera: str, *left_px: float) -> Detections2D:
    xy = np.stack([BODY + [x, 0] for x in left_px]) if left_px else np.zeros((0, K, 2))
    return detections(camera, xy, score=1.0, sigma_px=1.0, box_img=np.zeros((len(xy), 4)))


def log(search: list[Detections2D], second: list[Detections2D], kept: list[list[int]]) -> Observations:
    """One time step: a search, then a second look whose detections are the people `kept`."""
    looks = ((LookKind.SEARCH, search), (LookKind.SECOND, second))
    batches = [DetectionBatch(step=0, t_ns=0, kind=kind, detections=tuple(views)) for kind, views in looks]
    no_person = [np.full(len(one), -1) for one in search]
    return Observations.from_batches(COCO17, ("a", "b", "c"), batches, [no_person, [np.array(ids) for ids in kept]])


def test_who_was_found_but_is_not_in_the_result() -> None:
    search = [view("a", 0, 300, 600), view("b", 300, 2), view("c", 0)]
    made = log(search, [view("a", 1), view("b", 3), view("c", 1)], [[0], [0], [0]])
    assert others_seen(made, AssociateSettings()) == {"a": 2, "b": 1}


def test_a_body_found_twice_is_no_other() -> None:
    made = log([view("a", 0, 1.5), view("b"), view("c")], [view("a", 1), view("b"), view("c")], [[0], [], []])
    assert others_seen(made, AssociateSettings()) == {}


def test_one_line_names_the_cameras_and_one_camera_alone_is_not_reported() -> None:
    line = others_line({"a": 2, "b": 1}, 1)
    assert line == "up to 2 more people were seen than the 1 followed: a (2), b (1); `people=N` follows more"
    assert others_line({"a": 3}, 1) is None
    assert others_line({}, 1) is None
