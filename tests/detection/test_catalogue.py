"""The cards of networks that are fetched by name: complete, and each a network that the code can read."""

import numpy as np
import pytest
from checks import refusal

from posefuse.core import ModelError
from posefuse.detection.boxes import expected_shapes
from posefuse.detection.build import network_plugin
from posefuse.detection.card import PERSONS, TOP_DOWN, OnnxCard, list_cards, needed_cards, read_card
from posefuse.detection.download import UrlSource
from posefuse.detection.engines import OnnxNetwork
from posefuse.detection.files import fetch_all

graphs = pytest.importorskip("graphs", reason="the package onnx is not installed")
CARDS = {card.name: card for card in list_cards() if isinstance(card, OnnxCard)}
# Pose2Sim's words, and its networks
WORDS = {
    "lightweight": ("rtmpose_s", "yolox_tiny_humanart"),
    "balanced": ("rtmpose_m", "yolox_m_humanart"),
    "performance": ("rtmpose_x", "yolox_x_humanart"),
}
# trained on BGR: MMPose's RTMO, and the YOLOX of its projects
BGR = ("rtmo", "yolox")


@pytest.mark.parametrize("name", CARDS)
def test_a_card_states_where_it_comes_from_and_under_which_terms(name):
    card = CARDS[name]
    assert isinstance(card.source, UrlSource)
    urls = card.source.urls
    assert all(url.startswith("https://") for url in (*urls, card.published))
    assert card.licence and card.summary
    assert card.terms is not None and card.terms.stated_by.startswith("https://") and card.terms.data
    assert "agpl" not in card.licence.lower()
    assert (card.input.channels == "bgr") == name.startswith(BGR)
    # of the archives the first address has been dead for days
    assert len(urls) == 2 if card.source.member.startswith("end2end") else urls and card.source.member == ""


@pytest.mark.parametrize("word", WORDS)
def test_the_words_of_pose2sim_are_its_networks(word):
    own, persons = needed_cards(word)
    assert persons.name == WORDS[word][1]
    same = read_card(WORDS[word][0], OnnxCard)
    assert own.source == same.source and own.input == same.input and own.file_name == same.file_name


@pytest.mark.parametrize("name", CARDS)
def test_a_network_of_the_layout_it_names_can_be_read(tmp_path, name):
    """A constructed file with an input and outputs of the stated sizes; another number of keypoints is refused."""
    card = CARDS[name]
    sizes = {"n": 3, "h": card.input.size_wh[1] // 4, "w": card.input.size_wh[0] // 4}
    shapes = [tuple(sizes.get(part, part) for part in shape) for shape in expected_shapes(card)]
    outputs = {f"o{i}": np.zeros(shape, np.float32) for i, shape in enumerate(shapes)}
    network = OnnxNetwork(card, graphs.constant_network(tmp_path / "n.onnx", card.input.size_wh, outputs), "cpu", "f32", 1)
    assert network.processor == "cpu"
    if card.kind in TOP_DOWN:
        outputs["o0"] = outputs["o0"][:, 1:]
        other = graphs.constant_network(tmp_path / "other.onnx", card.input.size_wh, outputs)
        refusal(ModelError, "expected outputs of layout", OnnxNetwork, card, other, "cpu", "f32", 1)


@pytest.mark.parametrize("name", CARDS)
def test_nothing_is_fetched_before_its_terms_are_accepted(tmp_path, name):
    refusal(ModelError, rf"{name}: Apache-2.0.*posefuse models --accept-licence {name}", fetch_all, [CARDS[name]], tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_name_chooses_the_detector():
    for name, card in CARDS.items():
        if card.kind not in PERSONS:
            assert network_plugin(name) == ("onnx", {"card": name})
    assert network_plugin("blazepose_best") == ("blazepose", {"landmarks": "blazepose_best"})
    # refused where it is built, with the names there are
    assert network_plugin("rtmpose_xxl")[0] == "blazepose"
