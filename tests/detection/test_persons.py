"""The person detector's outputs: drawn people come back as the regions they were made from."""

import itertools

import numpy as np
import pytest

from posefuse.core import Region
from posefuse.detection.card import PersonCard, read_card
from posefuse.detection.crops import crop_from_img
from posefuse.detection.search import SquareFinder, regions_from_outputs

CARD = read_card("blazepose_persons", PersonCard)
SIDE = CARD.input.size_wh[0]
FIRST_OF_LAST_GRID = 28 * 28 * 2 + 14 * 14 * 2
WHOLE = Region(centre_img=np.array([111.5, 111.5]), side_px=224.0)


def empty():
    return np.zeros((2254, 12), np.float32), np.full((2254, 1), -9.0, np.float32)


def draw(boxes, logits, anchor, hips, rim, logit=3.0, size=90.0):
    """A person at anchor number `anchor` of the 7 x 7 grid; points in crop px from the corner."""
    cell = anchor // 6
    centre = (np.array([cell % 7, cell // 7]) + 0.5) * SIDE / 7
    row = FIRST_OF_LAST_GRID + anchor
    boxes[row, :4] = [*(hips - centre), size, size]
    boxes[row, 4:] = np.concatenate([hips - centre, rim - centre, [0, 0], [0, 0]])
    logits[row] = logit


def found(boxes, logits, looked_at):
    return regions_from_outputs(boxes, logits, CARD.decoding, looked_at, SIDE)


@pytest.mark.parametrize("looked_at", [WHOLE, Region(centre_img=np.array([320.0, 240.0]), side_px=800.0, angle_rad=0.7)])
def test_a_drawn_person_comes_back_as_its_region(looked_at):
    boxes, logits = empty()
    hips, rim = np.array([100.0, 120.0]), np.array([110.0, 70.0])
    draw(boxes, logits, 6 * 24 + 1, hips, rim)
    ((score, region),) = found(boxes, logits, looked_at)
    affine = crop_from_img(looked_at, SIDE)
    back = affine[:, :2] @ region.centre_img + affine[:, 2]
    scale = looked_at.side_px / SIDE
    assert np.allclose(back, hips - 0.5, atol=1e-4)
    assert region.side_px == pytest.approx(2.5 * np.linalg.norm(rim - hips) * scale, rel=1e-5)
    assert region.angle_rad == pytest.approx(looked_at.angle_rad + np.arctan2(10, 50), abs=1e-5)
    assert score == pytest.approx(1 / (1 + np.exp(-3.0)))


def test_votes_for_one_person_are_merged_and_two_people_stay_two():
    boxes, logits = empty()
    one, other = np.array([60.0, 110.0]), np.array([170.0, 120.0])
    draw(boxes, logits, 6 * 20, one, one - [0, 60], logit=2.0)
    draw(boxes, logits, 6 * 20 + 1, one + [4, 0], one - [-4, 60], logit=2.0)
    draw(boxes, logits, 6 * 26, other, other - [0, 50], logit=4.0)
    people = found(boxes, logits, WHOLE)
    assert len(people) == 2
    assert np.allclose(people[0][1].centre_img, other - 0.5, atol=1e-4)
    assert np.allclose(people[1][1].centre_img, one + [2, 0] - 0.5, atol=1e-4)


@pytest.mark.parametrize(("logit", "count"), [(-0.2, 0), (0.2, 1)])
def test_no_person_is_found_below_the_threshold(logit, count):
    boxes, logits = empty()
    draw(boxes, logits, 70, np.array([90.0, 90.0]), np.array([90.0, 40.0]), logit=logit)
    assert len(found(boxes, logits, WHOLE)) == count


def inside(square, xy_img, least=0):
    affine = crop_from_img(square, 1000)
    seen = xy_img @ affine[:, :2].T + affine[:, 2]
    return ((seen > least) & (seen < 1000)).all(-1)


@pytest.mark.parametrize(("size_wh", "up_rad"), [((640, 480), 0.0), ((1080, 1920), -0.5), ((3840, 1000), 1.2)])
def test_the_search_begins_with_the_whole_image_and_its_tiles_leave_no_gap(size_wh, up_rad):
    plan = list(SquareFinder.stages(size_wh, up_rad))
    assert len(plan[0]) == 1 and plan[0][0].side_px == max(size_wh) and plan[0][0].angle_rad == 0
    corners = np.array([[0, 0], [size_wh[0] - 1, 0], [0, size_wh[1] - 1], [size_wh[0] - 1, size_wh[1] - 1]])
    for square in itertools.chain(*plan[:-2]):
        assert inside(square, corners, least=-1).all()
    assert {square.angle_rad for squares in plan for square in squares} == {0.0, up_rad}
    spread = np.random.default_rng(0).uniform([0, 0], size_wh, (500, 2))
    for squares in plan[-2:]:
        assert np.any([inside(square, spread) for square in squares], axis=0).mean() > 0.9
