"""The default estimator on real images; skipped, by name, where its networks were never fetched."""

import os

import av
import numpy as np
import pytest

from posefuse.core import Detector, Frame, ModelError, Region, ShapeError
from posefuse.detect import BlazePoseConfig, default_cache_dir, list_cards, region_from_keypoints, status

CAMERA = "cam04"


@pytest.fixture(scope="module")
def detector():
    if any(status(card, default_cache_dir(os.environ)) != "ready" for card in list_cards()):
        pytest.skip("networks are not in the model cache; run: posefuse models")
    return BlazePoseConfig(streams=1).build()


@pytest.fixture(scope="module")
def frame(shared_data) -> Frame:
    with av.open(str(shared_data / "pose2sim_single" / "videos" / f"{CAMERA}.mp4")) as container:
        image = next(container.decode(video=0)).to_ndarray(format="rgb24")
    return Frame(CAMERA, 0, 0, 0, image)


@pytest.fixture(scope="module")
def seen(detector, frame):
    return detector.detect([frame], [None])[0]


def test_it_finds_the_man_where_openpose_does(detector, seen, shared_data):
    from posefuse.detect import read_openpose_folder

    assert isinstance(detector, Detector)
    theirs = read_openpose_folder(shared_data / "pose2sim_single" / "openpose_json" / "cam04_json", CAMERA).frame(0, 0)
    assert len(seen) >= 1
    names = [f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "hip", "knee", "ankle")]
    ours = seen.xy_img[0][detector.skeleton.indices(names)]
    apart = np.linalg.norm(theirs.xy_img[:, theirs.skeleton.indices(names)] - ours, axis=-1)
    assert np.nanmedian(apart, axis=1).min() < 0.05 * np.ptp(seen.xy_img[0, :, 1])
    assert (seen.sigma_px > 0).all() and (seen.score > 0).all()


def test_a_region_gives_the_same_man_and_an_empty_one_nobody(detector, frame, seen):
    there = region_from_keypoints(seen.xy_img[0], detector.skeleton)
    nowhere = Region(np.array([80.0, 80.0]), 100.0)
    (both,) = detector.detect([frame], [[nowhere, there]])
    assert len(both) == 2
    assert np.isnan(both.xy_img[0]).all() and not both.score[0].any() and np.isnan(both.sigma_px[0]).all()
    assert np.median(np.linalg.norm(both.xy_img[1] - seen.xy_img[0], axis=-1)) < 5


def test_frames_in_one_call_do_not_disturb_each_other(detector, frame, seen):
    blank = Frame("other", 0, 0, 0, np.full((240, 320, 3), 90, np.uint8))
    nobody, again, none_asked = detector.detect([blank, frame, frame], [None, None, []])
    assert len(nobody) == 0 and len(none_asked) == 0
    assert np.array_equal(again.xy_img, seen.xy_img)


def test_an_image_on_its_side_is_searched_turned(detector, frame, seen):
    turned = Frame(CAMERA, 0, 0, 0, np.ascontiguousarray(np.rot90(frame.image)))
    (found,) = detector.detect([turned], [None])
    assert len(found) >= 1
    width = frame.image.shape[1]
    back = np.stack([width - 1 - found.xy_img[0, :, 1], found.xy_img[0, :, 0]], axis=-1)
    assert np.median(np.linalg.norm(back - seen.xy_img[0], axis=-1)) < 25


def test_a_mirrored_image_gives_the_mirrored_man(detector, frame, seen):
    there = region_from_keypoints(seen.xy_img[0], detector.skeleton)
    width = frame.image.shape[1]
    mirrored = Frame(CAMERA, 0, 0, 0, np.ascontiguousarray(frame.image[:, ::-1]))
    region = Region(np.array([width - 1 - there.centre_img[0], there.centre_img[1]]), there.side_px, -there.angle_rad)
    (found,) = detector.detect([mirrored], [[region]])
    back = found.xy_img[0][detector.skeleton.mirror] * [-1, 1] + [width - 1, 0]
    (direct,) = detector.detect([frame], [[there]])
    off = (back - direct.xy_img[0]) * 256 / there.side_px
    # half a heatmap cell off, as between the two ways to count cells, would show as 4 px
    assert abs(np.median(off[:, 0])) < 0.8
    assert np.median(np.abs(off)) < 2.5


def test_misuse_is_an_error(detector, frame, tmp_path):
    with pytest.raises(ShapeError, match="regions for each of 1 frames"):
        detector.detect([frame], [])
    with pytest.raises(ModelError, match="expected kind person_ssd"):
        BlazePoseConfig(persons="blazepose_full").build()
    with pytest.raises(ModelError, match="no such wheel"):
        BlazePoseConfig(cache=tmp_path, models=tmp_path / "nowhere.whl").build()
