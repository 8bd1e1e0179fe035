"""Processors that networks run on, each named by one word.

ONNX Runtime continues on the CPU, without an error, where the driver or the libraries of a processor are missing. So a device
that is named is either used or refused, and `auto` takes a graphics card only after a network ran on it.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from typing import Any, Literal

from posefuse.core import ConfigError, DependencyError, ModelError
from posefuse.core.errors import choices

Precision = Literal["auto", "f32", "bf16"]

_PROVIDERS = {
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "directml": "DmlExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
}
_CURES = {
    "cuda": "a driver of NVIDIA and pip install 'posefuse[gpu]', in place of onnxruntime",
    "tensorrt": "a driver of NVIDIA, TensorRT, and pip install 'posefuse[gpu]', in place of onnxruntime",
    "directml": "Windows and the package onnxruntime-directml, in place of onnxruntime",
    "coreml": "macOS and pip install 'posefuse[onnx]'",
}
_OPENVINO = {"cpu": "CPU", "openvino:gpu": "GPU", "openvino:npu": "NPU"}
_NUMBERED = ("cuda", "tensorrt", "directml")
WORDS = ("auto", "cpu", "cuda[:N]", "tensorrt[:N]", "directml[:N]", "coreml", "openvino:gpu", "openvino:npu")


@dataclass(frozen=True)
class Device:
    """A processor.

    Attributes:
        word: as the user names it, e.g. ``cuda:1``.
        openvino: its name there; None: ONNX Runtime runs it.
        provider: of ONNX Runtime; None: OpenVINO runs it. number: of several alike; None: there is only one.
    """

    word: str
    openvino: str | None = None
    provider: str | None = None
    number: int | None = None

    @property
    def cure(self) -> str:
        """What it needs, for people."""
        return _CURES.get(self.word.partition(":")[0], "its driver")


CPU = Device("cpu", openvino="CPU")


def device_of(word: str) -> Device | None:
    """The device of a word; None for ``auto``. Raises ConfigError, with the words there are."""
    if word == "auto":
        return None
    if word in _OPENVINO:
        return Device(word, openvino=_OPENVINO[word])
    found = re.fullmatch(rf"({'|'.join(_NUMBERED)})(?::(\d{{1,3}}))?|coreml", word)
    if not found:
        raise ConfigError(f"device: expected one of {choices(WORDS)}, got {word!r}")
    if found[1] is None:
        return Device(word, provider=_PROVIDERS[word])
    number = int(found[2] or 0)
    return Device(f"{found[1]}:{number}", provider=_PROVIDERS[found[1]], number=number)


def openvino_device(word: str) -> Device:
    """As `device_of`, for networks that only OpenVINO runs; raises ConfigError for other devices."""
    device = device_of(word) or CPU
    if device.openvino is None:
        raise ConfigError(f"device: BlazePose's networks run on {choices(_OPENVINO)}, got {word!r}; ONNX networks run there")
    return device


def onnxruntime() -> Any:
    """The module `onnxruntime`; raises DependencyError with the extra that brings it.

    Its import, with 1.31 on Linux too, would send events to its makers and write an identity into the home of the user.
    """
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    try:
        import onnxruntime as ort
    except ImportError:
        raise DependencyError(
            "ONNX Runtime is not installed: pip install 'posefuse[onnx]', or 'posefuse[gpu]' for NVIDIA"
        ) from None
    # of earlier builds for Windows, which know no such variable
    ort.disable_telemetry_events()
    return ort


def is_listed(device: Device) -> bool:
    """Whether the installed ONNX Runtime was built for this device; whether it works there is another question."""
    try:
        return device.provider in onnxruntime().get_available_providers()
    except DependencyError:
        return False


def session_on(device: Device, path: str, threads: int) -> Any:
    """An `onnxruntime.InferenceSession` that runs on this device and on no other.

    Raises:
        DependencyError: ONNX Runtime is not installed. ModelError: it cannot read the file, or cannot use the device here.
    """
    ort = onnxruntime()
    if not is_listed(device):
        there = choices(ort.get_available_providers())
        raise ModelError(f"device {device.word}: this ONNX Runtime has {there}; {device.word} needs {device.cure}")
    if device.provider == _PROVIDERS["cuda"] and hasattr(ort, "preload_dlls"):
        # CUDA's libraries lie in packages of their own, where no loader looks
        ort.preload_dlls()
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    numbered = {} if device.number is None else {"device_id": str(device.number)}
    try:
        session = ort.InferenceSession(path, options, providers=[(device.provider, numbered)])
    except Exception as error:  # noqa: BLE001 - its errors share no base class
        raise ModelError(f"{path}: ONNX Runtime cannot run it on {device.word} ({last_line(error)})") from None
    used = session.get_providers()
    if not used or used[0] != device.provider:
        raise ModelError(f"device {device.word}: ONNX Runtime runs on {choices(used)} instead; {device.word} needs {device.cure}")
    return session


def last_line(error: Exception) -> str:
    """The end of an error's text, where libraries say what it was."""
    lines = str(error).strip().splitlines()
    return lines[-1] if lines else type(error).__name__
