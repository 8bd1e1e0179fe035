"""OpenVINO on this machine's CPU, imported without its telemetry: precision and threads of every network."""

from __future__ import annotations

import sys
from functools import cache
from typing import Any, Literal

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
