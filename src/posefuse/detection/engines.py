"""Networks compiled for this machine by OpenVINO or ONNX Runtime: images in, outputs out.

OpenVINO is imported without its telemetry.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import DependencyError, ModelError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices

from .boxes import check_outputs
from .card import NetworkInput, OnnxCard
from .crops import normalised
from .device import CPU, Device, Precision, device_of, is_listed, last_line, onnxruntime, session_on


def openvino_package() -> Any:
    """The module `openvino`; everything that uses it takes it from here.

    Its import sends an event to a server of its makers and writes an identity into the user's home, by way of the package
    `openvino_telemetry`. It does without where it finds no such package.
    """
    sys.modules.setdefault("openvino_telemetry", None)  # type: ignore[arg-type]
    import openvino

    return openvino


@cache
def _core_and_process() -> tuple[Any, int]:
    return openvino_package().Core(), os.getpid()


def openvino_core() -> Any:
    """The one `openvino.Core` of this process.

    Raises:
        ModelError: the process was forked from one that has it already: OpenVINO would wait for threads that only that one has.
    """
    core, process = _core_and_process()
    if process != os.getpid():
        raise ModelError(
            "networks do not run in a process that was forked from one that has used them; start processes with the method spawn,"
            " e.g. multiprocessing.get_context('spawn')"
        )
    return core


def compiled_by_openvino(model: Any, device: Device, precision: Precision, streams: int) -> Any:
    """The `openvino.CompiledModel`.

    Threads are not pinned to cores. Left to itself OpenVINO pins the first stream to the first core, and does so in every
    process: two camera processes then share one core while the other is idle.

    Args:
        model: an `openvino.Model`.
        device: one that OpenVINO runs.
        precision: of the CPU; ``auto`` is bf16 where it computes that natively, else f32.
        streams: images worked on at once, one thread each.

    Raises:
        ModelError: OpenVINO has no such device here.
    """
    core = openvino_core()
    if device != CPU:
        if not any(name.partition(".")[0] == device.openvino for name in core.available_devices):
            there = choices(core.available_devices)
            raise ModelError(f"device {device.word}: OpenVINO has {there} here; {device.word} needs {device.cure}")
        return core.compile_model(model, device.openvino, {"PERFORMANCE_HINT": "THROUGHPUT"})
    if precision == "auto":
        precision = "bf16" if "BF16" in core.get_property("CPU", "OPTIMIZATION_CAPABILITIES") else "f32"
    options = {
        "NUM_STREAMS": streams,
        "INFERENCE_NUM_THREADS": streams,
        "INFERENCE_PRECISION_HINT": precision,
        "ENABLE_CPU_PINNING": False,
    }
    return core.compile_model(model, "CPU", options)


def devices_found() -> str:
    """What OpenVINO and ONNX Runtime say that they run on here; whether a provider works shows when it is used."""
    try:
        providers = ", ".join(name.removesuffix("ExecutionProvider") for name in onnxruntime().get_available_providers())
    except DependencyError:
        providers = "not installed"
    return f"OpenVINO: {', '.join(openvino_core().available_devices)}; ONNX Runtime: {providers}"


class BlazePoseNetwork:
    """A .tflite file, compiled.

    Requests of its own take 4 to 7 % less processor time per crop than `openvino.AsyncInferQueue`, which copies more.

    Args:
        path: the model file.
        outputs: names of the outputs to keep; what only other outputs need is never computed.
        takes: its input, square, the same range for all colours.
        precision, device: see `compiled_by_openvino`.
        streams: crops worked on at once, one thread each; a single one is worked on in the thread that asks.

    Raises:
        ModelError: a file that is no such network.
    """

    def __init__(
        self, path: Path, outputs: Sequence[str], takes: NetworkInput, precision: Precision, streams: int, device: Device = CPU
    ) -> None:
        ov = openvino_package()
        self.side_px = takes.size_wh[0]
        compiled = compiled_by_openvino(_pruned(path, outputs, takes), device, precision, streams)
        self._alone = streams == 1
        # twice as many as threads: one that has done a crop finds the next one waiting
        self._requests = [compiled.create_infer_request() for _ in range(1 if self._alone else 2 * streams)]
        self._crops = np.zeros((len(self._requests), 1, takes.size_wh[0], takes.size_wh[0], 3), np.uint8)
        for request, crop in zip(self._requests, self._crops, strict=True):
            # given once: OpenVINO's Python layer takes longer to accept an array than to copy a crop
            request.set_input_tensor(ov.Tensor(crop, shared_memory=True))
        self._shapes = [tuple(port.shape) for port in compiled.outputs]

    def __call__(self, crops: Sequence[Array]) -> list[Array]:
        """One array (B, ...) float32 per output, for B crops (side_px, side_px, 3) uint8; valid until the next call.

        Each crop is asked for while other threads work on those before it.
        """
        # a detector that was made before the process was forked is refused, too
        openvino_core()
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


def _pruned(path: Path, outputs: Sequence[str], takes: NetworkInput) -> Any:
    ov, whole = openvino_package(), _read_by_openvino(path)
    ports = {name: port for port in whole.outputs for name in port.get_names()}
    kept = [ports[name].get_node().input_value(0) for name in _chosen(path, outputs, ports)]
    model = ov.Model(kept, whole.get_parameters(), path.stem)
    shape = tuple(model.input().shape)
    if shape != (1, takes.size_wh[0], takes.size_wh[0], 3):
        raise ModelError(f"{path}: expected an input (1, {takes.size_wh[0]}, {takes.size_wh[0]}, 3), got {shape}")
    steps = ov.preprocess.PrePostProcessor(model)
    steps.input().tensor().set_element_type(ov.Type.u8)
    steps.input().preprocess().convert_element_type(ov.Type.f32).mean(takes.mean[0]).scale(takes.std[0])
    return steps.build()


# of images that a graphics card looks at in one call; a call of another number is filled up to the next of these
_BATCHES = (1, 2, 4, 8)


class OnnxNetwork:
    """A card's network, compiled, its outputs checked against the card's layout.

    Args:
        card: which network. path: its file.
        device: word of the processor, see `device`. precision: of OpenVINO on the CPU. threads: CPU threads.

    Attributes:
        processor: on which it runs, and for ``auto`` why not on a graphics card, for people.

    Raises:
        ModelError: the file cannot be read, or is not of the layout, or the device does not run it.
        DependencyError: ONNX Runtime is needed and not installed.
    """

    def __init__(self, card: OnnxCard, path: Path, device: str, precision: Precision, threads: int) -> None:
        self.card = card
        chosen = device_of(device)
        if chosen is None:
            self.processor = self._automatic(path, precision, threads)
        else:
            self.processor = self._on(chosen, path, precision, threads)

    def _automatic(self, path: Path, precision: Precision, threads: int) -> str:
        """On a graphics card of NVIDIA if one really runs it, else on the CPU, with the reason."""
        card = device_of("cuda")
        assert card is not None
        if not is_listed(card):
            return self._on(CPU, path, precision, threads)
        try:
            return self._on(card, path, precision, threads)
        except ModelError as error:
            return f"{self._on(CPU, path, precision, threads)} ({error})"

    def _on(self, device: Device, path: Path, precision: Precision, threads: int) -> str:
        """Compile it, and run it once: what does not run is no device."""
        self._runner: OpenVinoRunner | OnnxRuntimeRunner = (
            OpenVinoRunner(self.card, path, device, precision, threads)
            if device.openvino
            else OnnxRuntimeRunner(self.card, path, device, threads)
        )
        width, height = self.card.input.size_wh
        try:
            outputs = self([np.zeros((height, width, 3), np.uint8)])[0]
        except Exception as error:  # noqa: BLE001 - the errors of both libraries share no base class
            raise ModelError(f"device {device.word}: cannot run {path.name} ({last_line(error)}); needs {device.cure}") from None
        check_outputs(self.card, self._runner.output_names, outputs)
        return device.word

    def __call__(self, crops: Sequence[Array]) -> list[list[Array]]:
        """The outputs, in the layout's order, for each RGB crop (H, W, 3) uint8 of the card's size."""
        return self._runner.run([normalised(crop, self.card.input) for crop in crops])


class OpenVinoRunner:
    """Runs as many images at once as there are threads."""

    def __init__(self, card: OnnxCard, path: Path, device: Device, precision: Precision, threads: int) -> None:
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
        self._queue = ov.AsyncInferQueue(compiled_by_openvino(model, device, precision, threads), threads)
        self._queue.set_callback(self._collect)

    def run(self, inputs: Sequence[Array]) -> list[list[Array]]:
        """The outputs for each input (1, 3, H, W) float32."""
        openvino_core()
        results: list[list[Array]] = [[] for _ in inputs]
        for one, result in zip(inputs, results, strict=True):
            self._queue.start_async({0: one}, userdata=result)
        self._queue.wait_all()
        return results

    def _collect(self, request: Any, result: list[Array]) -> None:
        result.extend(np.array(request.get_output_tensor(k).data) for k in range(len(self.output_names)))


class OnnxRuntimeRunner:
    """Runs on a graphics card or another processor that ONNX Runtime serves, several images in one call where the file allows."""

    def __init__(self, card: OnnxCard, path: Path, device: Device, threads: int) -> None:
        self._session = session_on(device, str(path), threads)
        given = self._session.get_outputs()
        names = [port.name for port in given]
        self.output_names = _chosen(path, card.decoding.outputs, names) if card.decoding.outputs else names
        self._input = self._session.get_inputs()[0]
        width, height = card.input.size_wh
        shape = self._input.shape
        fits = len(shape) == 4 and all(
            not isinstance(got, int) or got == wanted for got, wanted in zip(shape, (1, 3, height, width), strict=True)
        )
        if not fits:
            raise ModelError(f"{path}: expected an input (1, 3, {height}, {width}), got {tuple(shape)}")
        firsts = [shape, *(port.shape for port in given if port.name in self.output_names)]
        self._batches = _BATCHES if all(len(one) > 0 and not isinstance(one[0], int) for one in firsts) else _BATCHES[:1]

    def run(self, inputs: Sequence[Array]) -> list[list[Array]]:
        """The outputs for each input (1, 3, H, W) float32."""
        results: list[list[Array]] = []
        while len(results) < len(inputs):
            results += self._together(inputs[len(results) : len(results) + self._batches[-1]])
        return results

    def _together(self, inputs: Sequence[Array]) -> list[list[Array]]:
        """In one call, filled up: every other number of images would be compiled once more."""
        size = next(size for size in self._batches if size >= len(inputs))
        batch = np.concatenate([*inputs, *[np.zeros_like(inputs[0])] * (size - len(inputs))])
        outputs = self._session.run(list(self.output_names), {self._input.name: batch})
        return [[output[i : i + 1] for output in outputs] for i in range(len(inputs))]


def _read_by_openvino(path: Path) -> Any:
    try:
        return openvino_core().read_model(path)
    except RuntimeError as error:
        raise ModelError(f"{path}: not a network OpenVINO can read ({last_line(error)})") from None


def _chosen(path: Path, wanted: Sequence[str], there: Sequence[str] | dict[str, Any]) -> list[str]:
    missing = [name for name in wanted if name not in there]
    if missing:
        raise ModelError(f"{path}: expected an output {missing[0]!r}; there are: {choices(sorted(there))}")
    return list(wanted)
