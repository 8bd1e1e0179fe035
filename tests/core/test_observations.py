"""The log keeps every detection as it was made, and is checked once."""

from dataclasses import replace

import numpy as np
import pytest
from built import observations_from_views, random_detections
from checks import assert_same, refusal

from posefuse.core import DetectionBatch, LookKind, Observations, ShapeError, ViewSequence
from posefuse.core.skeleton import COCO17
from posefuse.core.view_sequences import ViewsInParts, people_in, views_over_time

K, NAMES = len(COCO17), ("left", "middle", "right")


def batches(steps: int, seed: int = 0) -> list[DetectionBatch]:
    """Now and then a search as well; cameras without a frame, and frames without a detection."""
    rng, made = np.random.default_rng(seed), []
    for step in range(steps):
        for kind in LookKind if step % 3 == 0 else (LookKind.EXPECTED,):
            here = [name for c, name in enumerate(NAMES) if (step + c) % 4]
            found = tuple(random_detections(rng, name, step * 100 + c, int(rng.integers(0, 4))) for c, name in enumerate(here))
            made.append(DetectionBatch(step=step, t_ns=step * 100, kind=kind, detections=found))
    return made


def test_every_detection_comes_back_as_it_was_made() -> None:
    made = batches(9)
    log = Observations.from_batches(COCO17, NAMES, made)
    wanted = [one for batch in made for one in batch.detections]
    assert len(log) == sum(map(len, wanted))
    assert_same([log.detections(i) for i in range(len(wanted))], wanted)
    images = len({(one.camera, one.t_ns) for one in wanted})  # three time steps were looked at four times
    assert images < len(wanted)
    assert repr(log) == f"Observations({len(log)} detections in {images} images of 3 cameras, coco17, 9 time steps)"


def test_the_parts_of_a_log_are_the_log() -> None:
    whole, tail = batches(8), batches(5, seed=1)
    first = Observations.from_batches(COCO17, NAMES, whole)
    later = [replace(batch, step=batch.step + 8, t_ns=batch.t_ns + 800) for batch in tail]
    joined = Observations.from_batches(COCO17, NAMES, [*whole, *later])
    second = Observations.from_batches(COCO17, NAMES, tail)
    second = replace(second, step_t_ns=second.step_t_ns + 800)
    assert_same(Observations.concatenate([first, second]), joined)
    alone = Observations.from_batches(COCO17, NAMES, [replace(batch, step=batch.step - 8) for batch in later])
    assert_same(joined.part(slice(8, None)), alone)
    assert joined.part(slice(None, None, 3)).step_t_ns.tolist() == [0, 300, 600, 900, 1200]
    assert len(joined) == sum(len(joined.of(name)) for name in NAMES)
    assert joined.of("right").camera_names == ("right",)
    refusal(ShapeError, "no camera 'up'; there are: left, middle, right", joined.of, "up")


def test_views_of_cameras_synchronised_are_what_was_seen() -> None:
    rng = np.random.default_rng(0)
    score = rng.uniform(0.1, 1, (6, 2, 3, K))
    score[2:4, 1], score[5, :, 0] = 0, 0
    xy = np.where(score[..., None] > 0, rng.normal(size=(*score.shape, 2)), np.nan).astype(np.float32)
    sigma = np.where(score > 0, 1.5, np.nan)
    about = {"t_ns": np.arange(6) * 10, "skeleton": COCO17, "camera_names": NAMES, "person_id": [7, 3]}
    views = ViewSequence(**about, xy_img=xy, score=score.astype(np.float32), sigma_px=sigma)
    back = views_over_time(observations_from_views(views), [7, 3])
    assert_same(back, views)
    ids, counts = people_in(observations_from_views(views))
    assert (ids.tolist(), counts.tolist()) == ([3, 7], [4, 6])


@pytest.mark.parametrize("times", ["steps", "between"])
def test_views_in_parts_are_the_views(times: str) -> None:
    log = Observations.from_batches(COCO17, NAMES, batches(23))
    first = np.diff(log.detection_frame, prepend=-1) > 0
    followed = first & (log.frame_look[log.detection_frame] == LookKind.EXPECTED)
    log = log.with_person_ids(np.where(followed, np.arange(len(log)) % 2, -1))
    log = replace(log, step_t_ns=log.step_t_ns * 1_000_000, frame_t_ns=log.frame_t_ns * 1_000_000)
    t_ns = None if times == "steps" else log.step_t_ns + 40_000_000
    parts = ViewsInParts(log, [1, 0], t_ns, 250_000_000)
    whole = parts.part(slice(None))
    assert (whole.score > 0).any(axis=(1, 3)).sum() > 20
    for part in (slice(0, 23), slice(0, 1), slice(5, 12), slice(22, 30), slice(30, 40)):
        assert_same(parts.part(part), whole.part(part))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n_detections": lambda log: log.n_detections + 1}, "counts that add up to the"),
        ({"frame_camera": lambda log: log.frame_camera + 3}, r"frame_camera: expected values from 0 to 2, got 3 to 5"),
        ({"frame_step": lambda log: log.frame_step - 2}, "frame_step: expected values from -1 to 8"),
        ({"step_t_ns": lambda log: log.step_t_ns[::-1]}, "strictly increasing"),
        ({"person_id": lambda log: np.zeros(len(log))}, "a person at most once in one camera"),
        ({"score": lambda log: log.score[:-1]}, "score: expected axis R"),
        ({"skeleton": lambda _: replace(COCO17, keypoints=COCO17.keypoints[:-1], bones=())}, "has 16 keypoints, arrays have 17"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict, message: str) -> None:
    refusal(ShapeError, "a batch for every time step", Observations.from_batches, COCO17, NAMES, batches(9)[5:])
    log = Observations.from_batches(COCO17, NAMES, batches(9))
    refusal(ShapeError, message, lambda: replace(log, **{name: make(log) for name, make in change.items()}))
