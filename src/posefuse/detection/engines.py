"""Networks compiled for this machine by OpenVINO or ONNX Runtime: images in, outputs out.

OpenVINO is imported without its telemetry.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from posefuse.core import DependencyError, ModelError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices

from .boxes import check_outputs
from .card import ModelInput, NetworkCard, checked_file
from .crops import normalised

Precision = Literal["auto", "f32", "bf16"]


def openvino_package() -> Any:
    """The module `openvino`; everything that uses it takes it from here.

    Its import sends an event to a server of its makers and writes an identity into the user's home, by way of the package
    `openvino_telemetry`. It does without where it finds no such package.
    """
    sys.modules.setdefault("openvino_telemetry", None)  # type: ignore[arg-type]
    import openvino

    return openvino


@cache
def openvino_core() -> Any:
    """The one `openvino.Core` of this process."""
    return openvino_package().Core()


def compiled_for_cpu(model: Any, precision: Precision, streams: int) -> Any:
    """The `openvino.CompiledModel`.

    Threads are not pinned to cores. Left to itself OpenVINO pins the first stream to the first core, and does so in every
    process: two camera processes then share one core while the other is idle.

    Args:
        model: an `openvino.Model`.
        precision: ``auto`` is bf16 where the CPU computes it natively, else f32.
        streams: images worked on at once, one thread each.
    """
    core = openvino_core()
    if precision == "auto":
        precision = "bf16" if "BF16" in core.get_property("CPU", "OPTIMIZATION_CAPABILITIES") else "f32"
    options = {
        "NUM_STREAMS": streams,
        "INFERENCE_NUM_THREADS": streams,
        "INFERENCE_PRECISION_HINT": precision,
        "ENABLE_CPU_PINNING": False,
    }
    return core.compile_model(model, "CPU", options)


class BlazePoseNetwork:
    """A .tflite file compiled for this CPU.

    Args:
        path: the model file.
        outputs: names of the outputs to keep; what only other outputs need is never computed.
        takes: size and value range of its input.
        precision: ``auto`` is bf16 where the CPU computes it natively, else f32.
        streams: crops worked on at once, one thread each; a single one is worked on in the thread that asks.

    Raises:
        ModelError: a file that is no such network.
    """

    def __init__(self, path: Path, outputs: Sequence[str], takes: ModelInput, precision: Precision, streams: int) -> None:
        ov = openvino_package()
        self.side_px = takes.side_px
        compiled = compiled_for_cpu(_pruned(path, outputs, takes), precision, streams)
        self._alone = streams == 1
        # twice as many as threads: one that has done a crop finds the next one waiting
        self._requests = [compiled.create_infer_request() for _ in range(1 if self._alone else 2 * streams)]
        self._crops = np.zeros((len(self._requests), 1, takes.side_px, takes.side_px, 3), np.uint8)
        for request, crop in zip(self._requests, self._crops, strict=True):
            # given once: OpenVINO's Python layer takes longer to accept an array than to copy a crop
            request.set_input_tensor(ov.Tensor(crop, shared_memory=True))
        self._shapes = [tuple(port.shape) for port in compiled.outputs]

    def __call__(self, crops: Sequence[Array]) -> list[Array]:
        """One array (B, ...) float32 per output, for B crops (side_px, side_px, 3) uint8; valid until the next call.

        Each crop is asked for while other threads work on those before it.
        """
        if self._alone and len(crops) == 1:
            self._start(0, crops[0])
            # heatmaps are large, and little of them is looked at: not copied
            return [self._requests[0].get_output_tensor(k).data for k in range(len(self._shapes))]
        results = [np.empty((len(crops), *shape[1:]), np.float32) for shape in self._shapes]
        size = len(self._requests)
        for i in range(len(crops) + size):
            if i >= size:
                self._take((i - size) % size, [result[i - size] for result in results])
            if i < len(crops):
                self._start(i % size, crops[i])
        return results

    def _start(self, place: int, crop: Array) -> None:
        # a call that was stopped left it at work
        self._requests[place].wait()
        self._crops[place, 0] = crop
        if self._alone:
            self._requests[place].infer(share_outputs=True)
        else:
            self._requests[place].start_async()

    def _take(self, place: int, results: Sequence[Array]) -> None:
        """Wait for the request and copy its outputs."""
        request = self._requests[place]
        request.wait()
        for k, result in enumerate(results):
            result[:] = request.get_output_tensor(k).data[0]


def _pruned(path: Path, outputs: Sequence[str], takes: ModelInput) -> Any:
    ov, whole = openvino_package(), _read_by_openvino(path)
    ports = {name: port for port in whole.outputs for name in port.get_names()}
    kept = [ports[name].get_node().input_value(0) for name in _chosen(path, outputs, ports)]
    model = ov.Model(kept, whole.get_parameters(), path.stem)
    shape = tuple(model.input().shape)
    if shape != (1, takes.side_px, takes.side_px, 3):
        raise ModelError(f"{path}: expected an input (1, {takes.side_px}, {takes.side_px}, 3), got {shape}")
    steps = ov.preprocess.PrePostProcessor(model)
    steps.input().tensor().set_element_type(ov.Type.u8)
    scale = 255.0 / (takes.high - takes.low)
    steps.input().preprocess().convert_element_type(ov.Type.f32).mean(-takes.low * scale).scale(scale)
    return steps.build()


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
        ov, model = openvino_package(), _read_by_openvino(path)
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
        # where a driver or a library is missing it continues on the processor without an error
        if providers[0] not in self._session.get_providers():
            raise ModelError(
                f"ONNX Runtime cannot use {providers[0]} here, only {choices(self._session.get_providers())}; "
                "check the driver and libraries that it needs"
            )
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


def _read_by_openvino(path: Path) -> Any:
    try:
        return openvino_core().read_model(path)
    except RuntimeError as error:
        raise ModelError(f"{path}: not a network OpenVINO can read ({_last_line(error)})") from None


def _chosen(path: Path, wanted: Sequence[str], there: Sequence[str] | dict[str, Any]) -> list[str]:
    missing = [name for name in wanted if name not in there]
    if missing:
        raise ModelError(f"{path}: expected an output {missing[0]!r}; there are: {choices(sorted(there))}")
    return list(wanted)


def _last_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[-1] if lines else type(error).__name__
