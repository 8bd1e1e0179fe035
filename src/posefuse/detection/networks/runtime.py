"""One ONNX file run by OpenVINO or by ONNX Runtime: normalised inputs in, lists of outputs out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from posefuse.core import DependencyError, ModelError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.detection.openvino_cpu import Precision, compiled_for_cpu, openvino_core, openvino_package

from .card import NetworkCard, checked_file
from .crops import normalised
from .layouts import check_outputs

Engine = Literal["openvino", "onnxruntime"]
DEFAULT_PROVIDERS = ("CPUExecutionProvider",)


class Runner(Protocol):
    """A compiled network."""

    output_names: list[str]

    def run(self, inputs: Sequence[Array]) -> list[list[Array]]:
        """The outputs for each input (1, 3, H, W) float32."""
        ...


class OnnxNetwork:
    """A card's network, compiled, its outputs checked against the card's layout.

    Args:
        card: which network.
        engine: what runs it. precision: of OpenVINO. providers: of ONNX Runtime, best first.
        threads: CPU threads.

    Raises:
        ModelError: the file is missing, has another hash, cannot be read, or is not of the layout.
        DependencyError: ONNX Runtime is asked for and not installed.
    """

    def __init__(self, card: NetworkCard, engine: Engine, precision: Precision, providers: Sequence[str], threads: int) -> None:
        self.card = card
        path = checked_file(card)
        self._runner: Runner = (
            OpenVinoRunner(card, path, precision, threads)
            if engine == "openvino"
            else OnnxRuntimeRunner(card, path, providers, threads)
        )
        width, height = card.input.size_wh
        check_outputs(card, self._runner.output_names, self([np.zeros((height, width, 3), np.uint8)])[0])

    def __call__(self, crops: Sequence[Array]) -> list[list[Array]]:
        """The outputs, in the layout's order, for each RGB crop (H, W, 3) uint8 of the card's size."""
        return self._runner.run([normalised(crop, self.card.input) for crop in crops])


class OpenVinoRunner:
    """Runs on the CPU, as many images at once as there are threads."""

    def __init__(self, card: NetworkCard, path: Path, precision: Precision, threads: int) -> None:
        ov = openvino_package()
        try:
            model = openvino_core().read_model(path)
        except RuntimeError as error:
            raise ModelError(f"{path}: not a network OpenVINO can read ({_last_line(error)})") from None
        named = {name: port for port in model.outputs for name in port.get_names()}
        ports = [named[name] for name in _chosen(path, card.decoding.outputs, named)] if card.decoding.outputs else model.outputs
        self.output_names = [next(iter(port.get_names()), f"output {i}") for i, port in enumerate(ports)]
        if list(ports) != list(model.outputs):
            model = ov.Model([port.get_node().input_value(0) for port in ports], model.get_parameters(), path.stem)
        width, height = card.input.size_wh
        shape = model.input().partial_shape
        if not shape.compatible(ov.PartialShape([1, 3, height, width])):
            raise ModelError(f"{path}: expected an input (1, 3, {height}, {width}), got {shape.to_string()}")
        model.reshape([1, 3, height, width])
        self._queue = ov.AsyncInferQueue(compiled_for_cpu(model, precision, threads), threads)
        self._queue.set_callback(self._collect)

    def run(self, inputs: Sequence[Array]) -> list[list[Array]]:
        """See `Runner`."""
        results: list[list[Array]] = [[] for _ in inputs]
        for one, result in zip(inputs, results, strict=True):
            self._queue.start_async({0: one}, userdata=result)
        self._queue.wait_all()
        return results

    def _collect(self, request: Any, result: list[Array]) -> None:
        result.extend(np.array(request.get_output_tensor(k).data) for k in range(len(self.output_names)))


class OnnxRuntimeRunner:
    """Runs wherever an execution provider of ONNX Runtime does, one image after the other."""

    def __init__(self, card: NetworkCard, path: Path, providers: Sequence[str], threads: int) -> None:
        try:
            import onnxruntime as ort
        except ImportError:
            raise DependencyError("ONNX Runtime is not installed: pip install 'posefuse[onnx]', or engine=openvino") from None
        # of its builds for Windows
        ort.disable_telemetry_events()
        absent = [name for name in providers if name not in ort.get_available_providers()]
        if absent:
            there = choices(ort.get_available_providers())
            raise ModelError(f"ONNX Runtime has no execution provider {absent[0]!r} here; there are: {there}")
        options = ort.SessionOptions()
        options.intra_op_num_threads = threads
        try:
            self._session = ort.InferenceSession(str(path), options, providers=list(providers))
        except Exception as error:  # noqa: BLE001 - its errors share no base class
            raise ModelError(f"{path}: not a network ONNX Runtime can read ({_last_line(error)})") from None
        given = [port.name for port in self._session.get_outputs()]
        self.output_names = _chosen(path, card.decoding.outputs, given) if card.decoding.outputs else given
        self._input = self._session.get_inputs()[0]
        width, height = card.input.size_wh
        shape = self._input.shape
        fits = len(shape) == 4 and all(
            not isinstance(got, int) or got == wanted for got, wanted in zip(shape, (1, 3, height, width), strict=True)
        )
        if not fits:
            raise ModelError(f"{path}: expected an input (1, 3, {height}, {width}), got {tuple(shape)}")

    def run(self, inputs: Sequence[Array]) -> list[list[Array]]:
        """See `Runner`."""
        return [list(self._session.run(list(self.output_names), {self._input.name: one})) for one in inputs]


def _chosen(path: Path, wanted: Sequence[str], there: Sequence[str] | dict[str, Any]) -> list[str]:
    missing = [name for name in wanted if name not in there]
    if missing:
        raise ModelError(f"{path}: expected an output {missing[0]!r}; there are: {choices(sorted(there))}")
    return list(wanted)


def _last_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[-1] if lines else type(error).__name__
