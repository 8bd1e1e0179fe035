"""Networks of the user by model card: ONNX files through OpenVINO or ONNX Runtime."""

from .card import LAYOUTS, NetworkCard, checked_file, read_network_card
from .config import OnnxConfig
from .detector import OneStageDetector, TopDownDetector

__all__ = [
    "LAYOUTS", "NetworkCard", "OneStageDetector", "OnnxConfig", "TopDownDetector", "checked_file",
    "read_network_card",
]  # fmt: skip
