"""Tiny ONNX networks with known outputs: constants of each layout, and one that really finds colour-coded keypoints."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

OPSET, IR = 17, 8


class ListsCuda:
    """Imitates ONNX Runtime on a machine with graphics cards: it lists CUDA, and the real one runs the network on the CPU.

    Attributes:
        cards: number of the card of each session. batches: images in each call of a session, the first call left out.
    """

    def __init__(self) -> None:
        self._real = pytest.importorskip("onnxruntime", reason="the extra onnx is not installed")
        self.cards: list[int] = []
        self.batches: list[int] = []
        self.SessionOptions = self._real.SessionOptions

    def disable_telemetry_events(self) -> None: ...

    def get_available_providers(self) -> list[str]:
        return ["CUDAExecutionProvider", "CPUExecutionProvider"]

    def InferenceSession(self, path: str, options: object, providers: list) -> object:
        [(name, numbered)] = providers
        self.cards.append(int(numbered["device_id"]))
        session = self._real.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        run, calls = session.run, []

        def counted(names: list[str], feed: dict[str, np.ndarray]) -> list[np.ndarray]:
            calls.append(len(next(iter(feed.values()))))
            self.batches += calls[-1:] if len(calls) > 1 else []
            return run(names, feed)

        session.run, session.get_providers = counted, lambda: [name]
        return session


class Graph:
    """An ONNX graph in the making."""

    def __init__(self, size_wh: tuple[int, int]) -> None:
        width, height = size_wh
        self.size_wh = size_wh
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []
        self.input = helper.make_tensor_value_info("input", TensorProto.FLOAT, ["batch", 3, height, width])

    def constant(self, values: np.ndarray) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(values), name))
        return name

    def floats(self, values: object) -> str:
        return self.constant(np.asarray(values, np.float32))

    def integers(self, *values: int) -> str:
        return self.constant(np.array(values, np.int64))

    def add(self, op: str, *inputs: str, name: str = "", **attributes: object) -> str:
        name = name or f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(op, list(inputs), [name], **attributes))
        return name

    def save(self, path: Path, outputs: list[str]) -> Path:
        infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in outputs]
        graph = helper.make_graph(self.nodes, "tiny", [self.input], infos, self.constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)
        path.write_bytes(model.SerializeToString())
        return path


def constant_network(path: Path, size_wh: tuple[int, int], outputs: dict[str, np.ndarray]) -> Path:
    """Says the same whatever it sees."""
    graph = Graph(size_wh)
    zero = graph.add("Mul", graph.add("ReduceMax", "input", keepdims=0), graph.floats(0.0))
    for name, values in outputs.items():
        graph.add("Add", graph.floats(values), zero, name=name)
    return graph.save(path, list(outputs))


def identity_network(path: Path, size_wh: tuple[int, int]) -> Path:
    """Heatmaps of three keypoints that are its input."""
    graph = Graph(size_wh)
    graph.add("Identity", "input", name="heatmaps")
    return graph.save(path, ["heatmaps"])


def _similarity(graph: Graph, colours: np.ndarray, reach: float) -> str:
    """(1, K, H, W): exp(-|pixel - colour|^2 / reach^2) for colours (K, 3) in the input's own units."""
    squares = graph.add("Mul", "input", "input")
    both = graph.add("Concat", "input", squares, axis=1)
    weight = np.concatenate([2 * colours, -np.ones_like(colours)], axis=1) / reach**2
    kernel = graph.floats(weight[:, :, None, None])
    return graph.add("Exp", graph.add("Conv", both, kernel, graph.floats(-(colours**2).sum(1) / reach**2)))


def _mean(graph: Graph, similarity: str, axis: int, count: int) -> tuple[str, str]:
    """(1, K, 1) mean position of the similarity along an axis, every keypoint its own, and how much of it there is."""
    mass = graph.add("ReduceSum", similarity, graph.integers(axis), keepdims=0)
    total = graph.add("Add", graph.add("ReduceSum", mass, graph.integers(2), keepdims=1), graph.floats(1e-6))
    at = graph.add("ReduceSum", graph.add("Mul", mass, graph.floats(np.arange(count))), graph.integers(2), keepdims=1)
    return graph.add("Div", at, total), total


def _there(graph: Graph, total: str) -> str:
    """Of score 0 where there is nothing of this colour."""
    return graph.add("Div", total, graph.add("Add", total, graph.floats(4.0)))


def _profile(graph: Graph, similarity: str, axis: int, count: int, bins: int, sigma: float) -> str:
    """(1, K, bins) Gaussian of height 1 at the mean position of the similarity along an axis."""
    mean, total = _mean(graph, similarity, axis, count)
    away = graph.add("Sub", graph.floats(np.arange(bins) * count / bins), mean)
    shape = graph.add("Exp", graph.add("Div", graph.add("Mul", away, away), graph.floats(-2 * sigma**2)))
    return graph.add("Mul", shape, _there(graph, total))


def colour_simcc(path: Path, size_wh: tuple[int, int], colours: np.ndarray, reach: float, sigma_px: float = 2.0) -> Path:
    """SimCC network that marks discs of the given colours (K, 3), which are in units of its normalised input."""
    graph = Graph(size_wh)
    similar = _similarity(graph, colours, reach)
    x = _profile(graph, similar, 2, size_wh[0], 2 * size_wh[0], sigma_px)
    y = _profile(graph, similar, 3, size_wh[1], 2 * size_wh[1], sigma_px)
    graph.add("Identity", x, name="simcc_x")
    graph.add("Identity", y, name="simcc_y")
    return graph.save(path, ["simcc_x", "simcc_y"])


def colour_heatmaps(path: Path, size_wh: tuple[int, int], colours: np.ndarray, reach: float, cells: int = 4) -> Path:
    """The same with heatmaps of a quarter of the size."""
    graph = Graph(size_wh)
    similar = _similarity(graph, colours, reach)
    x = _profile(graph, similar, 2, size_wh[0], size_wh[0] // cells, 2.0 * cells)
    y = _profile(graph, similar, 3, size_wh[1], size_wh[1] // cells, 2.0 * cells)
    columns, rows = graph.add("Unsqueeze", x, graph.integers(2)), graph.add("Unsqueeze", y, graph.integers(3))
    graph.add("Mul", rows, columns, name="heatmaps")
    return graph.save(path, ["heatmaps"])


def colour_one_stage(path: Path, size_wh: tuple[int, int], colours: np.ndarray, reach: float, layout: str) -> Path:
    """One person per image from the same marks, as RTMO or a YOLO-pose head gives them."""
    graph = Graph(size_wh)
    similar = _similarity(graph, colours, reach)
    (x, total), (y, _) = _mean(graph, similar, 2, size_wh[0]), _mean(graph, similar, 3, size_wh[1])
    points, there = (x, y), _there(graph, total)
    marks = graph.add("Concat", *points, there, axis=2)  # (1, K, 3)
    xy = graph.add("Concat", *points, axis=2)
    low = graph.add("ReduceMin", xy, axes=[1], keepdims=0)
    high = graph.add("ReduceMax", xy, axes=[1], keepdims=0)
    score = graph.add("ReduceMean", there, axes=[1], keepdims=0)
    if layout == "rtmo":
        box = graph.add("Concat", low, high, score, axis=1)
        graph.add("Unsqueeze", box, graph.integers(1), name="dets")
        graph.add("Unsqueeze", marks, graph.integers(1), name="keypoints")
        return graph.save(path, ["dets", "keypoints"])
    centre = graph.add("Mul", graph.add("Add", low, high), graph.floats(0.5))
    flat = graph.add("Reshape", marks, graph.integers(1, 3 * len(colours)))
    row = graph.add("Concat", centre, graph.add("Sub", high, low), score, flat, axis=1)
    graph.add("Unsqueeze", row, graph.integers(2), name="output0")
    return graph.save(path, ["output0"])


def write_card(path: Path, kind: str, network: Path, size_wh: tuple[int, int], top: str = "", rest: str = "") -> Path:
    """A card for a network file next to it: `top` are keys of the card itself, `rest` continues in [input]."""
    sha256 = hashlib.sha256(network.read_bytes()).hexdigest()
    lines = [
        f'kind = "{kind}"', f'file = "{network.name}"', f'sha256 = "{sha256}"', 'licence = "none: made by a test"', top,
        "[input]", f"size_wh = [{size_wh[0]}, {size_wh[1]}]", rest,
    ]  # fmt: skip
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def bright_person(path: Path, size_wh: tuple[int, int], threshold: float) -> Path:
    """Person detector of layout detections: the box about all that is brighter than a threshold."""
    graph = Graph(size_wh)
    brightest = graph.add("ReduceMax", "input", axes=[1], keepdims=0)
    marked = graph.add("Cast", graph.add("Greater", brightest, graph.floats(threshold)), to=TensorProto.FLOAT)
    first, last = [], []
    for axis, count in ((1, size_wh[0]), (2, size_wh[1])):
        line = graph.add("ReduceMax", marked, axes=[axis], keepdims=0)
        ends = (line, graph.add("Mul", line, graph.floats(np.arange(1, count + 1))))
        for kept, values in zip((first, last), ends, strict=True):
            index = graph.add("ArgMax", values, axis=1, keepdims=1)
            kept.append(graph.add("Cast", index, to=TensorProto.FLOAT))
    score = graph.add("ReduceMax", graph.add("ReduceMax", marked, axes=[1], keepdims=0), axes=[1], keepdims=1)
    graph.add("Unsqueeze", graph.add("Concat", *first, *last, score, axis=1), graph.integers(1), name="dets")
    return graph.save(path, ["dets"])
