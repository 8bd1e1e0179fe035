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
from posefuse.detection.openvino_cpu import Precision, compiled_for_cpu, openvino_core


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
        import openvino as ov

        self.side_px = takes.side_px
        compiled = compiled_for_cpu(_pruned(path, outputs, takes), precision, streams)
        self._request = compiled.create_infer_request() if streams == 1 else None
        self._crop = np.zeros((1, takes.side_px, takes.side_px, 3), np.uint8)
        if self._request is not None:
            # given once: OpenVINO's Python layer takes longer to accept an array than to copy a crop
            self._request.set_input_tensor(ov.Tensor(self._crop, shared_memory=True))
        self._queue = ov.AsyncInferQueue(compiled, streams) if streams > 1 else None
        if self._queue is not None:
            self._queue.set_callback(self._collect)
        self._shapes = [tuple(port.shape) for port in compiled.outputs]

    def __call__(self, crops: Sequence[Array]) -> list[Array]:
        """One array (B, ...) float32 per output, for B crops (side_px, side_px, 3) uint8; valid until the next call."""
        if self._request is not None and len(crops) == 1:
            self._crop[0] = crops[0]
            # heatmaps are large, and little of them is looked at: not copied
            self._request.infer(share_outputs=True)
            return [self._request.get_output_tensor(k).data for k in range(len(self._shapes))]
        results = [np.empty((len(crops), *shape[1:]), np.float32) for shape in self._shapes]
        for i, crop in enumerate(crops):
            if self._queue is not None:
                self._queue.start_async({0: crop[None]}, userdata=(results, i))
            elif self._request is not None:
                self._crop[0] = crop
                self._request.infer(share_outputs=True)
                self._collect(self._request, (results, i))
        if self._queue is not None:
            self._queue.wait_all()
        return results

    @staticmethod
    def _collect(request: object, userdata: tuple[list[Array], int]) -> None:
        results, i = userdata
        for k, result in enumerate(results):
            result[i] = request.get_output_tensor(k).data[0]  # type: ignore[attr-defined]


def _pruned(path: Path, outputs: Sequence[str], takes: ModelInput) -> Any:
    import openvino as ov
    from openvino.preprocess import PrePostProcessor

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
    steps = PrePostProcessor(model)
    steps.input().tensor().set_element_type(ov.Type.u8)
    scale = 255.0 / (takes.high - takes.low)
    steps.input().preprocess().convert_element_type(ov.Type.f32).mean(-takes.low * scale).scale(scale)
    return steps.build()
