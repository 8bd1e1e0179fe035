"""Every layout, from networks with known outputs, against positions worked out again: rotated, rectangular crops, to 0.05 px."""

import hashlib

import built
import cv2
import numpy as np
import pytest
from checks import refusal

from posefuse.core import SKELETONS, ConfigError, Frame, ModelError, Region, Skeleton
from posefuse.detection import device as devices
from posefuse.detection.boxes import keypoints_of
from posefuse.detection.card import OnnxCard, read_card
from posefuse.detection.crops import letterbox_from_img, region_of_box
from posefuse.detection.engines import OnnxNetwork
from posefuse.detection.networks import OnnxConfig
from posefuse.detection.search import BoxFinder

graphs = pytest.importorskip("graphs", reason="the package onnx is not installed")
# ONNX Runtime on its own CPU provider stands for a processor that it serves
DEVICES = ["cpu", "coreml"]
# every axis of another size: input 144 x 208, image 517 x 391, 26 keypoints
SIZE, IMAGE_WH = (144, 208), (517, 391)
COUNT = len(SKELETONS["halpe_26"])
TOLERANCE_PX = 0.05
REGION = Region(centre_img=np.array([260.3, 171.8]), side_px=301.0, angle_rad=0.37)


def frame() -> Frame:
    return built.frame("cam", image=np.random.default_rng(0).integers(0, 256, (IMAGE_WH[1], IMAGE_WH[0], 3), dtype=np.uint8))


def marks(seed: int) -> np.ndarray:
    """Keypoints (K, 2) of the input, not on its bins."""
    return np.random.default_rng(seed).uniform([12, 12], np.array(SIZE) - 13, (COUNT, 2))


def gaussian(at: np.ndarray, count: int, sigma: float) -> np.ndarray:
    return np.exp(-((np.arange(count) - at[..., None]) ** 2) / (2 * sigma**2))


def raw_px(xy_input: np.ndarray, udp: bool = False) -> np.ndarray:
    """Where points of the input lie in the image: a map through three points of the rotated rectangle, as its makers state it."""
    spans = np.array([SIZE[0] - 1, SIZE[1] - 1] if udp else SIZE, np.float64)
    half = np.array([REGION.side_px * SIZE[0] / SIZE[1], REGION.side_px]) / 2
    turn = np.array([[np.cos(REGION.angle_rad), -np.sin(REGION.angle_rad)], [np.sin(REGION.angle_rad), np.cos(REGION.angle_rad)]])
    image = np.array([REGION.centre_img, REGION.centre_img + turn @ [half[0], 0], REGION.centre_img + turn @ [0, half[1]]])
    inside = np.array([spans / 2, spans / 2 + [spans[0] / 2, 0], spans / 2 + [0, spans[1] / 2]])
    affine = cv2.getAffineTransform(inside.astype(np.float32), image.astype(np.float32))
    return xy_input @ affine[:, :2].T + affine[:, 2]


def detect(card, device="cpu", regions=((REGION,),)):
    detector = OnnxConfig(card=str(card), device=device, precision="f32", streams=1).build()
    return detector.detect([frame()] * len(regions), list(regions))


def written(folder, kind, outputs, rest="", size=SIZE):
    """The card of a network that always gives these outputs; no test here searches: its person detector says nothing."""
    network = graphs.constant_network(folder / "n.onnx", size, outputs)
    top = 'persons = "persons.toml"\n' * (kind in ("simcc", "heatmap")) + 'keypoints = "halpe_26"'
    return graphs.write_card(folder / "card.toml", kind, network, size, top, rest)


def network_of(card):
    card = read_card(card, OnnxCard)
    return OnnxNetwork(card, card.folder / card.file, "cpu", "f32", 1)


def simcc_card(folder, xy, subpixel="taylor", sigma_bins=5.0):
    outputs = {
        "simcc_x": 0.8 * gaussian(2 * xy[:, 0], 2 * SIZE[0], sigma_bins)[None],
        "simcc_y": 0.9 * gaussian(2 * xy[:, 1], 2 * SIZE[1], 1.3 * sigma_bins)[None],
    }
    return written(folder, "simcc", outputs, f'[decoding]\noutputs = ["simcc_x", "simcc_y"]\nsubpixel = "{subpixel}"')


@pytest.fixture(autouse=True)
def persons(tmp_path, monkeypatch):
    monkeypatch.setitem(devices._PROVIDERS, "coreml", "CPUExecutionProvider")
    network = graphs.constant_network(tmp_path / "persons.onnx", (96, 64), {"dets": np.zeros((1, 2, 5))})
    graphs.write_card(tmp_path / "persons.toml", "detections", network, (96, 64))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("subpixel", ["taylor", "dark"])
def test_simcc(tmp_path, device, subpixel):
    if device == "coreml":
        pytest.importorskip("onnxruntime", reason="the extra onnx is not installed")
    xy = marks(1)
    (seen,) = detect(simcc_card(tmp_path, xy, subpixel), device)
    assert np.abs(seen.xy_img[0] - raw_px(xy)).max() < TOLERANCE_PX
    assert np.allclose(seen.score[0], np.minimum(0.8, 0.9), atol=0.02)


def test_simcc_spread_is_reported_per_axis_and_a_wider_one_makes_it_less_sure(tmp_path):
    xy = marks(3)
    network = network_of(simcc_card(tmp_path, xy, sigma_bins=5.0))
    seen = keypoints_of(network.card, network([np.zeros((SIZE[1], SIZE[0], 3), np.uint8)])[0])
    inside = ((xy > 15) & (xy < np.array(SIZE) - 16)).all(-1)
    assert np.allclose(seen.spread_px[0, inside, 0], 2.5, rtol=0.03)
    assert np.allclose(seen.spread_px[0, inside, 1], 3.25, rtol=0.03)
    narrow = detect(tmp_path / "card.toml")[0].sigma_px
    wide = detect(simcc_card(tmp_path, xy, sigma_bins=8.0))[0].sigma_px
    assert (wide[0, inside] > 1.2 * narrow[0, inside]).all()


@pytest.mark.parametrize("udp", [False, True])
@pytest.mark.parametrize("subpixel", ["taylor", "dark"])
def test_heatmaps(tmp_path, udp, subpixel):
    xy, cells = marks(4), (36, 52)
    scale = (np.array(cells) - 1) / (np.array(SIZE) - 1) if udp else np.array(cells) / SIZE
    at = xy * scale
    maps = gaussian(at[:, 1], cells[1], 2.0)[:, :, None] * gaussian(at[:, 0], cells[0], 2.0)[:, None]
    rest = f'[decoding]\nsubpixel = "{subpixel}"\nblur_cells = 5\nudp = {str(udp).lower()}'
    (seen,) = detect(written(tmp_path, "heatmap", {"heatmaps": 0.7 * maps[None]}, rest))
    off = np.abs(seen.xy_img[0] - raw_px(xy, udp))
    # the blur ends at the heatmap's rim
    inner = ((xy > 24) & (xy < np.array(SIZE) - 25)).all(-1)
    assert off[inner if subpixel == "dark" else slice(None)].max() < TOLERANCE_PX and inner.sum() > 10
    assert np.isfinite(seen.sigma_px).all()


def letterboxed(xy_img: np.ndarray, size_wh: tuple[int, int]) -> np.ndarray:
    """Input px of raw px: scaled to fit, in the upper left corner."""
    return xy_img * min(size_wh[0] / IMAGE_WH[0], size_wh[1] / IMAGE_WH[1])


def people(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Three people: keypoints (3, K, 2) and boxes (3, 4) in raw px; the last is the second one again, a little off."""
    rng = np.random.default_rng(seed)
    first = rng.uniform([20, 40], [180, 350], (COUNT, 2))
    second = rng.uniform([260, 30], [500, 380], (COUNT, 2))
    xy = np.stack([first, second, second + 4])
    return xy, np.concatenate([xy.min(1), xy.max(1)], axis=-1)


def test_rtmo(tmp_path):
    size = (320, 224)
    xy, box = people(6)
    score = np.array([0.6, 0.9, 0.8])
    dets = np.concatenate([letterboxed(box.reshape(3, 2, 2), size).reshape(3, 4), score[:, None]], axis=-1)
    points = np.concatenate([letterboxed(xy, size), np.full((3, COUNT, 1), 0.7)], axis=-1)
    card = written(tmp_path, "rtmo", {"dets": dets[None], "keypoints": points[None]}, size=size)
    there = Region(centre_img=xy[0].mean(0), side_px=400.0)
    nowhere = Region(centre_img=np.array([900.0, 900.0]), side_px=60.0)
    everybody, chosen, none_asked = detect(card, regions=(None, (nowhere, there), ()))
    assert len(everybody) == 2, "the same person twice is one"
    assert np.abs(everybody.xy_img - xy[[1, 0]]).max() < TOLERANCE_PX
    assert np.isnan(chosen.xy_img[0]).all() and np.abs(chosen.xy_img[1] - xy[0]).max() < TOLERANCE_PX
    assert len(none_asked) == 0 and np.allclose(everybody.score, 0.7)


@pytest.mark.parametrize("end_to_end", [False, True])
def test_yolo_pose(tmp_path, end_to_end):
    size = (352, 192)
    xy, box = people(7)
    ratio = min(size[0] / IMAGE_WH[0], size[1] / IMAGE_WH[1])
    shown = np.rint(np.array(IMAGE_WH) * ratio)
    corner = np.rint((np.array(size) - shown) / 2 - 0.1)
    points = np.concatenate([xy * ratio + corner, np.full((3, COUNT, 1), 0.65)], axis=-1).reshape(3, -1)
    corners = (box.reshape(3, 2, 2) * ratio + corner).reshape(3, 4)
    score = np.array([[0.9], [0.8], [0.7]])
    if end_to_end:
        rows = np.concatenate([corners, score, np.zeros((3, 1)), points], axis=-1)[None]
    else:
        middle = np.concatenate([(corners[:, :2] + corners[:, 2:]) / 2, corners[:, 2:] - corners[:, :2]], axis=-1)
        rows = np.concatenate([middle, score, points], axis=-1).T[None]
    rest = f'letterbox = "centre"\n[decoding]\nend_to_end = {str(end_to_end).lower()}'
    (seen,) = detect(written(tmp_path, "yolo_pose", {"output0": rows}, rest, size), regions=(None,))
    assert np.abs(seen.xy_img - xy[:2]).max() < TOLERANCE_PX


def test_a_person_detector(tmp_path):
    size, box = (160, 96), np.array([201.0, 57.0, 333.0, 371.0])
    inside = letterboxed(box.reshape(2, 2), size).ravel()
    # the second is of another class, the third the first again, the fourth no person
    dets = np.array([[*inside, 0.9], [*inside, 0.95], [*(inside + 1.5), 0.8], [1, 1, 9, 9, 0.1]])
    outputs = {"dets": dets[None], "labels": np.array([[0, 1, 0, 0]], np.float32)}
    network = graphs.constant_network(tmp_path / "n.onnx", size, outputs)
    finder = BoxFinder(network_of(graphs.write_card(tmp_path / "c.toml", "detections", network, size)), (192, 256), 1.25)
    ((region,),) = finder.people([(frame(), next(finder.stages(frame().size_wh, 0.0)))])
    expected = region_of_box(box, (192, 256), 1.25)
    assert np.abs(region.centre_img - expected.centre_img).max() < TOLERANCE_PX
    assert region.side_px == pytest.approx(1.25 * 314.0, abs=TOLERANCE_PX)


def test_a_wide_box_sets_the_side_by_its_width():
    region = region_of_box(np.array([0.0, 0.0, 300.0, 100.0]), (192, 256), 1.25)
    assert region.side_px == pytest.approx(1.25 * 300 * 256 / 192)


@pytest.mark.parametrize("device", DEVICES)
def test_what_the_network_is_given_is_what_its_maker_defines(tmp_path, device):
    if device == "coreml":
        pytest.importorskip("onnxruntime", reason="the extra onnx is not installed")
    network = graphs.identity_network(tmp_path / "n.onnx", SIZE)
    rest = 'channels = "bgr"\nmean = [10.0, 20.0, 30.0]\nstd = [2.0, 4.0, 8.0]'
    card = graphs.write_card(
        tmp_path / "card.toml", "heatmap", network, SIZE, 'persons = "persons.toml"\nkeypoints = "three"', rest
    )
    SKELETONS["three"] = Skeleton("three", ("a", "b", "c"))
    try:
        crop = np.random.default_rng(0).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
        (outputs,) = OnnxNetwork(read_card(card, OnnxCard), network, device, "f32", 1)([crop])
    finally:
        del SKELETONS["three"]
    blue, green, red = outputs[0][0]
    for got, channel, mean, std in ((blue, 2, 10, 2), (green, 1, 20, 4), (red, 0, 30, 8)):
        assert np.allclose(got, (crop[..., channel].astype(float) - mean) / std, atol=1e-4)


def test_a_turned_image_fits_into_its_letterbox(tmp_path):
    network = graphs.constant_network(tmp_path / "n.onnx", (320, 224), {"dets": np.zeros((1, 1, 5))})
    takes = read_card(graphs.write_card(tmp_path / "c.toml", "detections", network, (320, 224)), OnnxCard).input
    for angle in (0.0, 0.4, -1.2, np.pi):
        affine = letterbox_from_img(IMAGE_WH, takes, angle)
        corners = np.array([[0, 0], [IMAGE_WH[0], 0], [0, IMAGE_WH[1]], IMAGE_WH]) @ affine[:, :2].T + affine[:, 2]
        assert corners.min() > -1e-6 and (corners.max(0) < np.array(takes.size_wh) + 1e-6).all()
        up = affine[:, :2] @ [np.sin(angle), -np.cos(angle)]
        assert up[0] == pytest.approx(0, abs=1e-9) and up[1] < 0


def test_a_wrong_card_is_reported_in_one_line(tmp_path):
    xy = marks(8)
    card = simcc_card(tmp_path, xy)
    text = card.read_text()

    def message(changed: str, error=ModelError) -> str:
        card.write_text(changed)
        return refusal(error, "", OnnxConfig(card=str(card), streams=1).build)

    assert "no file" in message(text.replace("n.onnx", "absent.onnx"))
    other = "0" * 64
    sha = text.split('sha256 = "')[1][:64]
    error = message(text.replace(sha, other))
    assert sha in error and other in error
    error = message(text.replace('"halpe_26"', '"coco17"'))
    assert f"(1, 17, {2 * SIZE[0]})" in error and f"(1, {COUNT}, {2 * SIZE[0]})" in error
    assert "input" in message(text.replace(f"size_wh = [{SIZE[0]}, {SIZE[1]}]", "size_wh = [96, 64]"))
    assert "'absent'" in message(text.replace('"simcc_x", ', '"absent", '))
    assert "halpe_26" in message(text.replace('"halpe_26"', '"halpe"'), ConfigError)
    assert "licence" in message(text.replace("licence", "license"), ConfigError)
    assert "yolo_pose" in message(text.replace('"simcc"', '"simc"'), ConfigError)
    (tmp_path / "n.onnx").write_bytes(b"not a network")
    assert "not a network" in message(text.replace(sha, hashlib.sha256(b"not a network").hexdigest()))
