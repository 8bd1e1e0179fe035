"""The processor that is named is used or refused; `auto` takes a graphics card only after a network ran on it."""

import os
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from checks import assert_same, refusal
from running import python

from posefuse.cli.main import main
from posefuse.core import ConfigError, DependencyError, ModelError
from posefuse.detection.build import DetectorChoice, build_detector, fetch_networks
from posefuse.detection.card import OnnxCard, read_card
from posefuse.detection.device import device_of, openvino_device
from posefuse.detection.engines import OnnxNetwork
from posefuse.detection.networks import OnnxConfig
from posefuse.formats.rig import write_rig
from posefuse.foundation import plugins
from posefuse.foundation.settings import settings
from posefuse.sources import ImagesConfig

graphs, discs = (pytest.importorskip(name, reason="the package onnx is not installed") for name in ("graphs", "discs"))

SIZE = (96, 64)
CPU, CUDA = "CPUExecutionProvider", "CUDAExecutionProvider"


class Runtime:
    """Imitates ONNX Runtime: which providers it lists, which a session then really has, and how that session fails."""

    SessionOptions = SimpleNamespace

    def __init__(self, listed=(CUDA, CPU), used=(CUDA, CPU), create=None, run=None):
        self.get_available_providers, self.get_providers = lambda: list(listed), lambda: list(used)
        self.asked, self.create, self.run_error = [], create, run

    def disable_telemetry_events(self): ...

    def InferenceSession(self, path, options, providers):
        self.asked.append(providers)
        if self.create:
            raise RuntimeError(self.create)
        return self

    def get_outputs(self):
        return [SimpleNamespace(name="dets", shape=["batch", "n", 5])]

    def get_inputs(self):
        return [SimpleNamespace(name="input", shape=["batch", 3, SIZE[1], SIZE[0]])]

    def run(self, names, feed):
        if self.run_error:
            raise RuntimeError(self.run_error)
        return [np.zeros((len(feed["input"]), 2, 5), np.float32)]


@pytest.fixture
def card(tmp_path):
    network = graphs.constant_network(tmp_path / "n.onnx", SIZE, {"dets": np.zeros((1, 2, 5))})
    return read_card(graphs.write_card(tmp_path / "card.toml", "detections", network, SIZE), OnnxCard)


@pytest.fixture
def network(card, monkeypatch):
    def made(device, runtime):
        monkeypatch.setitem(sys.modules, "onnxruntime", runtime)
        return OnnxNetwork(card, card.folder / card.file, device, "f32", 1)

    return made


BROKEN = {
    "runs on the CPU instead": (Runtime(used=(CPU,)), "runs on CPUExecutionProvider instead"),
    "cannot be created": (Runtime(create="driver 470 is too old"), "driver 470 is too old"),
    "fails at the first image": (Runtime(run="out of memory"), "out of memory"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_graphics_card_that_does_not_run_is_refused_by_name_and_left_by_auto_with_the_reason(network, fault):
    runtime, words = BROKEN[fault]
    message = refusal(ModelError, words, network, "cuda:1", runtime)
    assert "cuda:1" in message
    found = network("auto", runtime)
    assert found.processor.startswith("cpu (") and words in found.processor
    assert len(found([np.zeros((SIZE[1], SIZE[0], 3), np.uint8)])) == 1


def test_a_device_that_is_not_installed_is_refused_with_its_cure_and_auto_takes_the_processor(network):
    runtime = Runtime(listed=(CPU,), used=(CPU,))
    refusal(ModelError, r"cuda:0.*needs a driver of NVIDIA and pip install 'posefuse\[gpu\]'", network, "cuda", runtime)
    assert network("auto", runtime).processor == "cpu"
    refusal(DependencyError, r"posefuse\[onnx\]", network, "cuda", None)
    assert network("auto", None).processor == "cpu"


def test_the_number_of_the_card_is_passed_on(network):
    runtime = Runtime()
    assert network("cuda:1", runtime).processor == "cuda:1"
    assert network("auto", runtime).processor == "cuda:0"
    assert runtime.asked == [[(CUDA, {"device_id": "1"})], [(CUDA, {"device_id": "0"})]]


@pytest.fixture
def real(monkeypatch):
    """The real runtime, which says that it has graphics cards."""
    monkeypatch.setitem(sys.modules, "onnxruntime", runtime := graphs.ListsCuda())
    return runtime


def test_images_go_in_batches_of_few_sizes_and_give_what_each_gives_alone(tmp_path, real):
    card = read_card(discs.card_of("simcc", tmp_path), OnnxCard)
    network = OnnxNetwork(card, tmp_path / card.file, "cuda:1", "f32", 1)
    crops = list(np.random.default_rng(0).integers(0, 256, (11, 256, 192, 3), dtype=np.uint8))
    together, alone = network(crops), [network([crop])[0] for crop in crops]
    assert real.cards == [1] and real.batches == [8, 4] + [1] * 11
    assert_same(together, alone, atol=1e-5)


def test_people_are_searched_for_in_the_images_of_all_cameras_in_one_call(tmp_path, real, ring_rig):
    discs.draw(rig := ring_rig(4, size_wh=(720, 560)), discs.true_xyz()[:1], tmp_path / "images")
    frames = [next(ImagesConfig(tmp_path / "images" / name, name, 25.0).build().frames()) for name in rig.names]
    empty = replace(frames[0], camera="empty", image=np.zeros_like(frames[0].image))
    detector = OnnxConfig(card=str(discs.card_of("simcc", tmp_path)), device="cuda", up_rad={"empty": 1.0}).build()
    real.batches.clear()
    together = detector.detect([*frames, empty], [None] * 5)
    # where people may be, who they are; again where no person was found, the other way up; and once more where people are
    assert real.batches == [8, 4, 1, 4]
    for frame, found in zip([*frames, empty], together, strict=True):
        (alone,) = detector.detect([frame], [None])
        assert len(alone) == len(found) == (frame is not empty)
        assert_same(found, alone, atol=1e-5)


@pytest.mark.parametrize("word", ["gpu", "cuda:", "cuda:x", "cpu:1", "cuda:0,cuda:1", "coreml:0", "CUDA", "", "openvino:tpu"])
def test_another_word_is_refused_with_those_there_are(word):
    refusal(ConfigError, r"device: expected one of .*cuda\[:N\].*got ", device_of, word)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork processes")
def test_a_process_forked_from_one_that_has_used_networks_is_refused_them():
    """It waited without end, as with Python's own pools of processes on Linux before 3.14."""
    forked = (
        "import os; from posefuse.detection.engines import openvino_core as core; core(); os.fork() == 0 and core(); os.wait()"
    )
    assert "ModelError: networks do not run in a process that was forked" in python("-c", forked).stderr


def test_openvino_names_what_it_has():
    assert openvino_device("auto").word == openvino_device("cpu").word == "cpu"
    refusal(ConfigError, "BlazePose's networks run on", openvino_device, "cuda")


def test_a_processor_that_openvino_lacks_is_refused(network):
    refusal(ModelError, r"openvino:npu: OpenVINO has .*CPU", network, "openvino:npu", None)


# --- plug-ins of other packages


@settings
class TakesDevice:
    device: str = "auto"

    def build(self):
        return SimpleNamespace(skeleton=None, joint_centres=None, detect=None, device=self.device)


@settings
class TakesNone:
    def build(self):
        raise AssertionError("work began")


def test_a_plug_in_gets_the_device_or_it_is_refused_before_any_work(monkeypatch, ring_rig, tmp_path, capsys):
    others, lab, here = plugins.entry_points, SimpleNamespace(name="lab"), plugins.GROUPS["detectors"]
    found = (("takes", TakesDevice), ("lacks", TakesNone))
    entries = [SimpleNamespace(name=name, dist=lab, load=lambda config=config: config) for name, config in found]
    monkeypatch.setattr(plugins, "entry_points", lambda group: entries if group == here else others(group=group))
    assert build_detector(DetectorChoice(name="takes", options={"device": "mps"}), ring_rig(2)).device == "mps"
    choice = DetectorChoice(name="lacks", options={"device": "mps"})
    refusal(ConfigError, r"detector lacks \(lab\) takes no device", fetch_networks, choice)
    session, out = tmp_path / "session", tmp_path / "out"
    (session / "videos").mkdir(parents=True)
    write_rig(session / "rig.toml", ring_rig(2))
    for camera in ring_rig(2).names:
        (session / "videos" / f"{camera}.mp4").touch()
    assert main(["track", str(session), "--out", str(out), "--set", "detector.name=lacks", "--device", "cuda"]) == 1
    assert "detector lacks (lab) takes no device" in capsys.readouterr().err and not list(out.glob("*"))
