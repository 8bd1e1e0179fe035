"""One network run by OpenVINO on the CPU: uint8 crops in, named outputs out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import ModelError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.detection.models import ModelInput
from posefuse.detection.openvino_cpu import Precision, compiled_for_cpu, openvino_core, openvino_package


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
    ov = openvino_package()
    try:
        whole = openvino_core().read_model(path)
    except RuntimeError as error:
        raise ModelError(f"{path}: not a network OpenVINO can read ({str(error).strip().splitlines()[-1]})") from None
    ports = {name: port for port in whole.outputs for name in port.get_names()}
    missing = [name for name in outputs if name not in ports]
    if missing:
        raise ModelError(f"{path}: expected an output {missing[0]!r}; there are: {choices(sorted(ports))}")
    kept = [ports[name].get_node().input_value(0) for name in outputs]
    model = ov.Model(kept, whole.get_parameters(), path.stem)
    shape = tuple(model.input().shape)
    if shape != (1, takes.side_px, takes.side_px, 3):
        raise ModelError(f"{path}: expected an input (1, {takes.side_px}, {takes.side_px}, 3), got {shape}")
    steps = ov.preprocess.PrePostProcessor(model)
    steps.input().tensor().set_element_type(ov.Type.u8)
    scale = 255.0 / (takes.high - takes.low)
    steps.input().preprocess().convert_element_type(ov.Type.f32).mean(-takes.low * scale).scale(scale)
    return steps.build()
