"""Every plug-in of ours passes the public checks, and the checks can fail."""

from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace

import built
import numpy as np
import pytest
from checks import assert_same, refusal
from made_up_session import made_up_messages, made_up_start
from videos import ScriptedSource

import posefuse as pf
from posefuse.core import (
    DependencyError,
    Detections2D,
    Frame,
    Kind,
    LiveMessage,
    LivePose,
    LiveStart,
    ModelError,
    Recording,
    Region,
    Source,
    SourceError,
)
from posefuse.core.skeleton import COCO17
from posefuse.detection.build import DetectorChoice, build_detector
from posefuse.evaluation.contracts import ContractError, check_detector, check_live_output, check_output, check_source
from posefuse.formats.truth import read_truth
from posefuse.foundation import plugins
from posefuse.foundation.plugins import GROUPS, build_plugin, list_plugins, plugin_config
from posefuse.outputs.frames import write_each

T, N, K = 6, 2, len(COCO17)
LIVE_OUTPUTS = [plugin.name for plugin in list_plugins("live_outputs")]
SINKS = [plugin.name for plugin in list_plugins("outputs")]


@pytest.fixture
def recording(ring_rig) -> Recording:
    rig, rng = ring_rig(3), np.random.default_rng(0)
    xyz = rng.normal(size=(T, N, K, 3)) * 0.3 + [0, 0, 1]
    xyz[2, 1, 4] = np.nan
    known = np.isfinite(xyz[..., 0])
    poses = built.poses(xyz, rate_hz=25.0, kind=np.where(known, Kind.SMOOTHED, Kind.MISSING))
    return built.recording(rig, poses, score=1.0, sigma_px=1.0, posefuse="test", rig_id=rig.id)


def test_every_plugin_of_ours_can_be_imported() -> None:
    listed = [plugin for kind in GROUPS for plugin in list_plugins(kind)]
    assert {"video", "images", "blazepose", "oracle", "trc", "c3d", "overlay", "rerun", "osc", "lsl"} <= {p.name for p in listed}
    assert [p for p in listed if p.package == "posefuse" and p.reason] == []


@pytest.mark.parametrize("name", SINKS)
def test_sinks(name: str, recording: Recording, tmp_path: Path) -> None:
    if name == "rerun":
        pytest.importorskip("rerun", reason="the extra viewer is not installed")
    if name == "mcap":
        pytest.importorskip("rosbags", reason="the extra ros is not installed")
    check_output(build_plugin("outputs", name, {}), recording, tmp_path)


def test_the_video_source(demo_session: Path) -> None:
    check_source(video(demo_session, "cam00"))


def video(demo_session: Path, camera: str) -> Source:
    return build_plugin("sources", "video", {"path": demo_session / "videos" / f"{camera}.mp4", "camera": camera})


@pytest.mark.usefixtures("models")
def test_the_blazepose_detector(demo_session: Path) -> None:
    people = [next(iter(video(demo_session, camera).frames())) for camera in ("cam00", "cam02")]
    no_person = replace(people[0], image=np.full_like(people[0].image, 90))
    check_detector(build_plugin("detectors", "blazepose", {}), [*people, no_person])


def test_the_oracle_detector(demo_session: Path) -> None:
    path = demo_session / "truth" / "truth.npz"
    oracle = build_plugin("detectors", "oracle", {"truth": path, "seed": 3})
    view = read_truth(path).views[1]
    image = np.zeros((480, 640, 3), np.uint8)
    check_detector(oracle, [built.frame(view.camera, int(view.t_ns[i]), image, seq=i) for i in (0, 7)])


def test_the_source_check_can_fail() -> None:
    check_source(ScriptedSource("a", (0, 10, 20)))
    for broken, rule in (
        (ScriptedSource("a", ()), "at least one frame"),
        (ScriptedSource("a", (0, 0)), "t_ns increases"),
        (ScriptedSource("a", (0,), of="b"), "camera is the source's"),
        (ScriptedSource("a", (0,), shown_wh=(9, 6)), "stated size"),
        (object(), "lacks a member"),
    ):
        refusal(ContractError, rule, check_source, broken)


class Guesser:
    """A detector that sees a fixed person per region, and may break one rule."""

    skeleton = COCO17

    def __init__(self, fault: str = "") -> None:
        self.fault = fault
        self.joint_centres = Path("nowhere.toml") if fault == "table" else None

    def detect(self, frames, regions):
        if self.fault == "broken":
            raise ValueError("the lens fell off")
        answers = [self._one(frame, 0 if given is None else len(given)) for frame, given in zip(frames, regions, strict=True)]
        return answers[:-1] if self.fault == "short" else answers

    def _one(self, frame: Frame, people: int) -> Detections2D:
        xy, score = np.ones((people, K, 2)), np.ones((people, K))
        xy[:, 0], score[:, 0] = 0.0 if self.fault == "invented" else np.nan, 0.0
        camera, sigma_px = "other" if self.fault == "camera" else frame.camera, float(self.fault != "sigma")
        score = 2 * score if self.fault == "score" else score
        return built.detections(camera, xy, frame.t_ns, score=score, sigma_px=sigma_px)


def test_the_detector_check_can_fail() -> None:
    frames = [built.frame("a", 5), built.frame("b", 6)]
    check_detector(Guesser(), frames)
    for fault, rule in (
        ("short", "one answer per frame"),
        ("invented", "score 0 is NaN"),
        ("score", "\\[0, 1\\]"),
        ("sigma", "sigma_px > 0"),
        ("camera", "frame's camera"),
        ("table", "joint_centres is a core.JointCentres, or None"),
    ):
        refusal(ContractError, rule, check_detector, Guesser(fault), frames)


@dataclass(frozen=True)
class GuesserConfig:
    fault: str = ""

    def build(self) -> Guesser:
        return Guesser(self.fault)


class NoSettings:
    """It has no `build`, and is no dataclass."""


@pytest.fixture
def of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """What another package announces."""
    ours = plugins.entry_points
    theirs = [EntryPoint(name, f"{__name__}:{name}", "posefuse.detectors") for name in ("GuesserConfig", "NoSettings")]
    monkeypatch.setattr(plugins, "entry_points", lambda group: [*ours(group=group), *(e for e in theirs if e.group == group)])


@pytest.mark.usefixtures("of_others")
def test_a_detector_of_another_package_that_breaks_a_rule_is_named_in_one_line(ring_rig) -> None:
    frames = [built.frame("a", 5), built.frame("b", 6)]
    images, regions = [frame.image for frame in frames], [[Region(centre_img=np.ones(2), side_px=2.0)], []]
    for fault, words in (
        ("short", "GuesserConfig: .*one answer per frame"),
        ("invented", "GuesserConfig: .*score 0 is NaN"),
        ("sigma", "GuesserConfig: .*sigma_px > 0"),
        ("camera", "GuesserConfig: .*frame's camera"),
        ("broken", "GuesserConfig: ValueError: the lens fell off; .*check_detector"),
    ):
        detector = build_detector(DetectorChoice(name="GuesserConfig", options={"fault": fault}), ring_rig(2))
        refusal(ModelError, words, detector.detect, frames, regions)
        refusal(ModelError, words, pf.detector("GuesserConfig", {"fault": fault}), images, regions)
    check_detector(build_detector(DetectorChoice(name="GuesserConfig"), ring_rig(2)), frames)


@pytest.mark.usefixtures("of_others")
def test_what_is_no_settings_class_is_listed_with_the_reason() -> None:
    [listed] = [plugin for plugin in list_plugins("detectors") if plugin.name == "NoSettings"]
    assert (plugins.option_names(listed), "a settings class with build()" in listed.reason) == ([], True)
    refusal(DependencyError, "NoSettings .*a settings class with build", plugin_config, "detectors", "NoSettings", {})


class Writer:
    """A sink that may break one rule."""

    name = "writer"

    def __init__(self, fault: str = "") -> None:
        self.fault = fault

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        (folder / "a.txt").write_text("" if self.fault == "empty" else "x")
        if self.fault == "unnamed":
            (folder / "b.txt").write_text("x")
        return [] if self.fault == "silent" else [folder / "a.txt"]


def test_the_sink_check_can_fail(recording: Recording, tmp_path: Path) -> None:
    for fault, rule in (("empty", "not empty"), ("unnamed", "not named: \\['b.txt'\\]"), ("silent", "returns the files")):
        (tmp_path / fault).mkdir()
        refusal(ContractError, rule, check_output, Writer(fault), recording, tmp_path / fault)
    (tmp_path / "good").mkdir()
    check_output(Writer(), recording, tmp_path / "good")


def test_an_output_that_names_no_file_of_the_folder_fails_alone(recording: Recording, tmp_path: Path) -> None:
    (elsewhere := tmp_path.parent / f"{tmp_path.name}.txt").touch()
    for named in (None, ["a.txt"], [tmp_path / "missing.txt"], [elsewhere]):
        broken = SimpleNamespace(name="broken", write=lambda recording, folder, named=named: named)
        outcome = write_each([broken, Writer()], recording, tmp_path)
        assert (outcome.files, [*outcome.failed]) == ((tmp_path / "a.txt",), ["broken"])
        assert "expected the path of a file that it made in the folder given" in str(outcome.failed["broken"])


# what an output cannot do without, and the package that must be there
LIVE_OPTIONS = {
    "record": ("mcap", lambda folder: {"path": folder / "live.mcap"}),
    "ros2": ("cyclonedds", lambda folder: {"domain_id": 9, "local_only": True}),
    "osc": ("numpy", lambda folder: {"to": ["127.0.0.1:9"]}),
    "json": ("numpy", lambda folder: {"to": ["127.0.0.1:9"], "axes": "y_up"}),
    "rerun": ("rerun", lambda folder: {"file": folder / "live.rrd"}),
    "lsl": ("pylsl", lambda folder: {}),
    "ros1": ("rospy", lambda folder: {}),
}


def session() -> list[LiveMessage]:
    return [made_up_start(1), *made_up_messages()]


@pytest.mark.parametrize("name", LIVE_OUTPUTS)
def test_live_outputs(name: str, tmp_path: Path) -> None:
    package, options = LIVE_OPTIONS.get(name, ("numpy", lambda folder: {}))
    pytest.importorskip(package, reason=f"{package} is not usable here")
    try:
        check_live_output(plugin_config("live_outputs", name, options(tmp_path)), session(), tmp_path)
    except SourceError as error:
        if name != "ros1":
            raise
        pytest.skip(f"no ROS 1 master: {error}")


@dataclass(frozen=True)
class Notebook:
    """A live output that may break one rule."""

    path: Path
    fault: str = ""
    takes = (LivePose,)
    keeps_all = True

    def build(self):
        return NotebookOutput(self)


class NotebookOutput:
    name, where = "notebook", ""

    def __init__(self, config: Notebook) -> None:
        self.config, self.file = config, None
        if config.fault == "nameless":
            self.name = ""

    def take(self, message) -> None:
        if isinstance(message, LiveStart):
            name = "one" if self.config.fault == "overwrites" else f"part{message.part}"
            self.file = (self.config.path / name).open("w")
            self.file.write(f"part {message.part}")
        elif self.config.fault == "crowd" and len(message.pose.person_id) > 1:
            raise ValueError("one person only")

    def close(self) -> None:
        if self.file is None:
            return
        self.file.close()
        if self.config.fault == "once":
            self.file = object()


def test_the_live_output_check_can_fail(tmp_path: Path) -> None:
    for fault, rule in (
        ("nameless", "has a name"),
        ("once", "close\\(\\) may be called twice"),
        ("overwrites", "leaves the files of the first as they are"),
        ("crowd", "take\\(\\) bears every LivePose of a session .*one person only"),
    ):
        (tmp_path / fault).mkdir()
        refusal(ContractError, rule, check_live_output, Notebook(tmp_path / fault, fault), session(), tmp_path / fault)
    refusal(ContractError, "begins with a LiveStart", check_live_output, Notebook(tmp_path), session()[1:], tmp_path)
    (tmp_path / "good").mkdir()
    check_live_output(Notebook(tmp_path / "good"), session(), tmp_path / "good")


def test_a_live_config_that_cannot_be_sent_is_reported() -> None:
    broken = Notebook(lambda: None)
    refusal(ContractError, "comes out of pickle", check_live_output, broken, [], Path())
    refusal(ContractError, "lacks a member", lambda: check_live_output(object(), [], Path()))


def raised(text: str) -> None:
    raise ValueError(text)


def test_the_checks_that_tests_share_can_fail() -> None:
    one = built.pose(np.zeros((1, K, 3)))
    assert_same(one, built.pose(np.zeros((1, K, 3))))
    bit, gap = one.xyz_world + 1e-300, np.where(np.arange(K)[:, None] == 3, np.nan, one.xyz_world)
    changes = ({"t_ns": 1}, {"xyz_world": bit}, {"xyz_world": gap})
    for other in (*(replace(one, **change) for change in changes), built.pose(np.zeros((2, K, 3))), None):
        with pytest.raises(AssertionError):
            assert_same([one], [other])
    for text in ("two\nlines", "another word"):
        with pytest.raises(AssertionError):
            refusal(ValueError, "lines", raised, text)
    assert refusal(ValueError, "l.ne", raised, "one line") == "one line"
