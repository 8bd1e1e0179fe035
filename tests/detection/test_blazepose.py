"""The default estimator on real images; skipped, by name, where its networks were never fetched."""

from pathlib import Path

import built
import numpy as np
import pytest
from checks import refusal

from posefuse.core import ConfigError, Detector, Frame, ModelError, Region, ShapeError
from posefuse.detection import BlazePoseConfig, region_from_keypoints
from posefuse.detection.blazepose import averaged
from posefuse.detection.card import CARDS_FOLDER, PersonCard, read_card
from posefuse.detection.engines import BlazePoseNetwork
from posefuse.detection.networks import DetectedPerson
from posefuse.sources import VideoConfig

CAMERA = "cam04"


@pytest.fixture(scope="module")
def detector(models):
    return BlazePoseConfig(streams=1).build()


def first_of(video: Path) -> Frame:
    return next(VideoConfig(video, video.stem).build().frames())


@pytest.fixture(scope="module")
def frame(shared_data) -> Frame:
    return first_of(shared_data / "pose2sim_single" / "videos" / f"{CAMERA}.mp4")


@pytest.fixture(scope="module")
def seen(detector, frame):
    return detector.detect([frame], [None])[0]


def test_it_finds_the_man_where_openpose_does(detector, seen, shared_data):
    from posefuse.formats.pose2d import read_openpose_folder

    assert isinstance(detector, Detector)
    theirs = read_openpose_folder(shared_data / "pose2sim_single" / "openpose_json" / "cam04_json", CAMERA).frame(0, 0)
    assert len(seen) >= 1
    names = [f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "hip", "knee", "ankle")]
    ours = seen.xy_img[0][detector.skeleton.indices(names)]
    apart = np.linalg.norm(theirs.xy_img[:, theirs.skeleton.indices(names)] - ours, axis=-1)
    assert np.nanmedian(apart, axis=1).min() < 0.05 * np.ptp(seen.xy_img[0, :, 1])
    assert (seen.sigma_px > 0).all() and (seen.score > 0).all()


def test_a_followed_person_costs_one_inference_and_no_search(detector, demo_session, monkeypatch):
    """What the speed of live rests on: a count of what goes through which network, so it holds on every machine."""
    frame = first_of(demo_session / "videos" / "cam01.mp4")
    (seen,) = detector.detect([frame], [None])
    there = region_from_keypoints(seen.xy_img[0], detector.skeleton)
    asked: list[int] = []

    def counted(network, crops):
        asked.append(len(crops))
        return run(network, crops)

    run = BlazePoseNetwork.__call__
    monkeypatch.setattr(BlazePoseNetwork, "__call__", counted)
    for regions, expected in ((([there],), 1), (([there, there],), 2), (([],), 0)):
        asked.clear()
        detector.detect([frame], list(regions))
        assert sum(asked) == expected
    asked.clear()
    detector.detect([frame], [None])
    assert sum(asked) > 1, "the whole image is searched, and whom it finds is looked at"


def test_a_region_gives_the_same_man_and_an_empty_one_no_person(detector, frame, seen):
    there = region_from_keypoints(seen.xy_img[0], detector.skeleton)
    nowhere = Region(centre_img=np.array([80.0, 80.0]), side_px=100.0)
    (both,) = detector.detect([frame], [[nowhere, there]])
    assert len(both) == 2
    assert np.isnan(both.xy_img[0]).all() and not both.score[0].any() and np.isnan(both.sigma_px[0]).all()
    assert np.median(np.linalg.norm(both.xy_img[1] - seen.xy_img[0], axis=-1)) < 5


def test_frames_in_one_call_do_not_disturb_each_other(detector, frame, seen):
    blank = built.frame("other", image=np.full((240, 320, 3), 90, np.uint8))
    no_person, again, none_asked = detector.detect([blank, frame, frame], [None, None, []])
    assert len(no_person) == 0 and len(none_asked) == 0
    assert np.array_equal(again.xy_img, seen.xy_img)


def test_an_image_on_its_side_is_searched_turned(detector, frame, seen):
    turned = built.frame(CAMERA, image=np.ascontiguousarray(np.rot90(frame.image)))
    (found,) = detector.detect([turned], [None])
    assert len(found) >= 1
    width = frame.image.shape[1]
    back = np.stack([width - 1 - found.xy_img[0, :, 1], found.xy_img[0, :, 0]], axis=-1)
    assert np.median(np.linalg.norm(back - seen.xy_img[0], axis=-1)) < 25


def seen_in_the_mirror(detector, frame, there):
    """Px (K, 2) and sigma (K,) of the first person that the detector finds in the mirrored image, mirrored back."""
    width = frame.image.shape[1]
    mirrored = built.frame(CAMERA, image=np.ascontiguousarray(frame.image[:, ::-1]))
    centre = np.array([width - 1 - there.centre_img[0], there.centre_img[1]])
    region = Region(centre_img=centre, side_px=there.side_px, angle_rad=-there.angle_rad)
    (found,) = detector.detect([mirrored], [[region]])
    mirror = detector.skeleton.mirror
    return found.xy_img[0][mirror] * [-1, 1] + [width - 1, 0], found.sigma_px[0][mirror]


def test_a_mirrored_image_gives_the_mirrored_man(detector, frame, seen):
    there = region_from_keypoints(seen.xy_img[0], detector.skeleton)
    back, _ = seen_in_the_mirror(detector, frame, there)
    (direct,) = detector.detect([frame], [[there]])
    off = (back - direct.xy_img[0]) * 256 / there.side_px
    # half a heatmap cell off, as between the two ways to count cells, would show as 4 px
    assert abs(np.median(off[:, 0])) < 0.8
    assert np.median(np.abs(off)) < 2.5


def test_a_network_that_also_looks_in_the_mirror_knows_no_left_and_right(tmp_path, frame, seen):
    card, lines = tmp_path / "both.toml", (CARDS_FOLDER / "blazepose_full.toml").read_text().splitlines(keepends=True)
    card.write_text("mirrored = true\n" + "".join(line for line in lines if not line.startswith("joint_centres")))
    (tmp_path / "blazepose_full.noise.toml").write_text((CARDS_FOLDER / "blazepose_full.noise.toml").read_text())
    detector = BlazePoseConfig(landmarks=str(card)).build()
    assert detector.joint_centres is None
    there = region_from_keypoints(seen.xy_img[0], detector.skeleton)
    back, sigma_px = seen_in_the_mirror(detector, frame, there)
    (direct,) = detector.detect([frame], [[there]])
    # what is left is the sampling of the crops
    assert np.median(np.abs(back - direct.xy_img[0])) * 256 / there.side_px < 0.1
    assert np.allclose(sigma_px, direct.sigma_px[0], rtol=0.3)
    assert not np.array_equal(direct.xy_img, seen.xy_img)


def test_looks_are_averaged_by_their_certainty_and_disagreement_is_doubt():
    keypoints = np.zeros((2, 2))
    sure = DetectedPerson(keypoints, np.ones(2), np.array([1.0, 1.0]), 0.9)
    unsure = DetectedPerson(keypoints + [3.0, 0.0], np.ones(2), np.array([2.0, 1e6]), 0.8)
    blind = DetectedPerson(keypoints + 100, np.zeros(2), np.ones(2), 0.1)
    assert averaged([sure]) is sure
    assert averaged([sure, blind]) is sure
    both = averaged([sure, unsure, blind])
    assert np.allclose(both.xy, [[0.6, 0.0], [0.0, 0.0]], atol=1e-6)
    # two that agree are no surer than the surer of them; the first keypoint has 1.6 of their own variance, then disagreement
    assert np.allclose(both.sigma_px**2, [0.8 * 1 + 0.2 * 4 + (0.8 * 0.36 + 0.2 * 5.76) / 2, 2.0])
    assert both.presence == pytest.approx(0.85)


def test_what_is_no_landmark_network_is_refused(tmp_path):
    card = tmp_path / "both.toml"
    card.write_text('kind = "landmark_ensemble"\n')
    refusal(ConfigError, "kind", read_card, card)
    finder = BlazePoseConfig(landmarks="blazepose_persons")
    refusal(ModelError, "expected kind heatmap_landmarks, got person_ssd", finder.build)


def test_misuse_is_an_error(detector, frame):
    refusal(ShapeError, "regions for each of 1 frames", detector.detect, [frame], [])
    refusal(ModelError, "expected kind person_ssd", read_card, "blazepose_full", PersonCard)
