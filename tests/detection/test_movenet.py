"""MoveNet as it is published: what TensorFlow.js computes, and a person followed by its name. Skipped where it cannot be had."""

from pathlib import Path

import numpy as np
import pytest
from commands import figures

from posefuse.core import ModelError
from posefuse.detection.boxes import keypoints_of
from posefuse.detection.card import OnnxCard, needed_cards, read_card
from posefuse.detection.decode import keypoints_from_movenet
from posefuse.detection.engines import OnnxNetwork
from posefuse.detection.files import Trust, fetch_all
from posefuse.foundation.platform import default_cache_dir

# y, x, score of all keypoints that TensorFlow.js 4.22 computes from the same two files for the image of `noise_image`
FROM_TFJS = {
    "movenet_thunder": [
        [0.1670, 0.1307, 0.1079, 0.3246, 0.8184, 0.3371, 0.1755, 0.5898, 0.4778, 0.7427, 0.6208, 0.7374, 0.7175, 0.7823, 0.8189,
         0.8958, 0.8981],
        [0.4723, 0.5336, 0.3088, 0.6697, 0.9813, 0.6577, 0.3099, 0.5865, 0.2280, 0.4775, 0.1478, 0.5715, 0.3200, 0.5813, 0.3192,
         0.5423, 0.2588],
        [0.0085, 0.0121, 0.0201, 0.0185, 0.0977, 0.0223, 0.0046, 0.0388, 0.0311, 0.0178, 0.0225, 0.0299, 0.0378, 0.0183, 0.0279,
         0.0188, 0.0281],
    ],
    "movenet_lightning": [
        [0.4109, 0.3556, 0.3800, 0.3577, 0.4396, 0.4250, 0.4266, 0.4992, 0.4733, 0.5035, 0.5082, 0.4676, 0.4486, 0.5292, 0.5100,
         0.5357, 0.5891],
        [0.5326, 0.6005, 0.4673, 0.6690, 0.6628, 0.7252, 0.3480, 0.7444, 0.2664, 0.6090, 0.3814, 0.6760, 0.4536, 0.6073, 0.4086,
         0.6568, 0.5166],
        [0.0295, 0.0514, 0.0332, 0.0122, 0.1287, 0.0312, 0.0432, 0.0348, 0.0379, 0.0226, 0.0260, 0.0896, 0.0682, 0.0324, 0.0260,
         0.0366, 0.0168],
    ],
}  # fmt: skip


def noise_image(side_px: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (side_px, side_px, 3)).astype(np.uint8)


def fetched(name: str) -> Path:
    try:
        return fetch_all(needed_cards(name), default_cache_dir(), trust=Trust(terms=True))[0]
    except ModelError as error:
        pytest.skip(f"{name} cannot be had: {error}")


def test_keypoints_in_px_of_the_input() -> None:
    """Of an input of 40 x 20 px: its beginning, its middle, and a keypoint that is not there."""
    output = np.array([[[[0, 0, 0.9], [0.5, 0.5, 0.4], [0.1, 0.1, 0]]]], np.float32)
    seen = keypoints_from_movenet(output, (40, 20))
    np.testing.assert_allclose(seen.xy[0], [[-0.2, -0.2], [19.8, 9.8], [np.nan, np.nan]])
    np.testing.assert_allclose(seen.score[0], [0.9, 0.4, 0])
    assert np.isnan(seen.spread_px).all() and not seen.rival.any()


@pytest.mark.slow
@pytest.mark.parametrize("name", FROM_TFJS)
def test_it_computes_what_tensorflow_js_does(name: str) -> None:
    card, path = read_card(name, OnnxCard), fetched(name)
    side = card.input.size_wh[0]
    outputs = OnnxNetwork(card, path, "cpu", "f32", 1)([noise_image(side)])[0]
    np.testing.assert_allclose(outputs[0][0, 0].T, FROM_TFJS[name], atol=1e-4)
    assert keypoints_of(card, outputs).xy.shape == (1, 17, 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", FROM_TFJS)
def test_its_name_is_all_that_track_needs(
    name: str, models: None, demo_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fetched(name)
    options = ["--networks", name, "--end", "1.0", "--outputs", "trc"]
    found = figures(capsys, "track", demo_session, "--out", tmp_path / "out", *options)
    assert found["network"] == name and found["mpjpe_mm"] < 35
