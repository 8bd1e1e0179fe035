"""The parts of the live pipeline that are values: no process, no clock."""

import itertools
import socket
import threading
import time
from dataclasses import replace
from importlib.metadata import EntryPoint

import built
import numpy as np
import pytest
from built import admitted, camera_state
from checks import refusal
from videos import ScriptedSource

from posefuse.api.live_run import LiveRun
from posefuse.cli import main as cli
from posefuse.cli.stopping import NO_PERSON_CODE
from posefuse.core import CameraHealth, DependencyError, Detections2D, Skeleton, SourceError
from posefuse.foundation import plugins
from posefuse.foundation.channel import Channel, ChannelClosed
from posefuse.foundation.settings import settings
from posefuse.health.camera_monitor import Monitor
from posefuse.realtime.capture import Capture, Caught, LiveInput, take_all
from posefuse.realtime.inputs import inputs_from_arguments
from posefuse.realtime.latency import Histogram, Latencies, ViewTimes
from posefuse.realtime.messages import Expected, SeenView, SessionClock
from posefuse.sources.live.stream import StampClock

S = 1_000_000_000
SKELETON = Skeleton("five", ("a", "b", "c", "d", "e"))
PERIOD_NS = S // 30


def seen_at(camera: str, t_ns: int, received_ns: int, still: int = 0) -> SeenView:
    empty, times = (
        Detections2D.empty(camera, t_ns, SKELETON),
        dict.fromkeys(("received_ns", "started_ns", "detected_ns"), received_ns),
    )
    return SeenView(detections=empty, state=None, still=still, **times)


# --- what is expected next


def test_what_is_expected_is_carried_on_to_the_time_of_a_frame() -> None:
    xyz, velocity = np.random.default_rng(3).normal(size=(2, 5, 3)), np.full((2, 5, 3), 0.5)
    np.testing.assert_allclose(Expected(7 * S, xyz, velocity).at(7 * S + S // 10), xyz + 0.05)


# --- which camera is ill


def of_two() -> Monitor:
    """Of two cameras that were well for a second."""
    monitor = Monitor(("a", "b"))
    run_frames(monitor, {"a": (0, 0), "b": (0, 0)}, 100 * S, 1)
    return monitor


def run_frames(monitor: Monitor, cameras: dict[str, tuple[int, int]], start_ns: int, seconds: float) -> dict[str, list]:
    """Frames at 30 Hz; `cameras` says by how much a stamp is off, and 1 when the image stands still."""
    used: dict[str, list] = {name: [] for name in cameras}
    for i in range(round(seconds * 30)):
        for name, (off_ns, still) in cameras.items():
            t_ns = start_ns + i * PERIOD_NS
            view = seen_at(name, t_ns + off_ns, t_ns + 20_000_000, still * (i + 1))
            used[name].append(admitted(monitor, view, t_ns + 40_000_000))
    return used


def test_a_frozen_camera_is_left_out_and_named_and_comes_back() -> None:
    monitor = of_two()
    used = run_frames(monitor, {"a": (0, 1), "b": (0, 0)}, 101 * S, 2)
    # half a second at 30 Hz, and it stands since the frame before
    assert [view is not None for view in used["a"]] == [i + 1 < 15 for i in range(60)]
    assert None not in used["b"]
    verdicts = monitor.judge(103 * S, {})
    assert (verdicts["a"].state, verdicts["b"].state) == ("frozen", "ok")
    back = run_frames(monitor, {"a": (0, 0), "b": (0, 0)}, 103 * S, 0.1)
    assert back["a"][0] is not None
    assert monitor.judge(103 * S + S // 10, {})["a"].state == "ok"


def test_when_nothing_moves_anywhere_no_camera_is_blamed_away() -> None:
    monitor = Monitor(("a", "b"))
    used = run_frames(monitor, {"a": (0, 1), "b": (0, 1)}, 100 * S, 3)
    assert None not in (used["a"][-1], used["b"][-1])


@pytest.mark.parametrize("jump_s", [3600, -3600, 2, -2, -1])
def test_a_clock_that_jumps_is_refused_named_and_put_right(jump_s: int) -> None:
    monitor = of_two()
    used = run_frames(monitor, {"a": (jump_s * S, 0), "b": (0, 0)}, 101 * S, 1)["a"]
    assert used[0] is None
    assert monitor.judge(101 * S + S // 2, {})["a"].state == "clock"
    # back by itself, at the times the camera had before
    assert [view.t_ns for view in used[-2:]] == [101 * S + 28 * PERIOD_NS, 101 * S + 29 * PERIOD_NS]
    assert monitor.judge(104 * S, {})["a"].state != "clock"


def test_frames_that_are_late_for_a_moment_are_refused_and_no_clock_is_put_right() -> None:
    monitor = of_two()
    used = run_frames(monitor, {"a": (-S, 0), "b": (0, 0)}, 102 * S, 2)["a"]
    assert used == [None] * 60
    verdict = monitor.judge(104 * S, {})["a"]
    assert (verdict.state, verdict.text) == ("late", "frames come 1.0 s later than usual; they are not used")
    assert monitor.refused("a") == {"late": 60}
    back = run_frames(monitor, {"a": (0, 0), "b": (0, 0)}, 104 * S, 0.1)["a"]
    assert [view.t_ns for view in back] == [104 * S + i * PERIOD_NS for i in range(3)]
    # a clock that was set back stays so
    assert run_frames(monitor, {"a": (-S, 0), "b": (0, 0)}, 106 * S, 4)["a"][-1].t_ns == 106 * S + 119 * PERIOD_NS


@pytest.mark.parametrize(("rate_hz", "state"), [(1200, "flood"), (240, "ok")])
def test_a_flood_is_named_and_its_views_are_used(rate_hz: int, state: str) -> None:
    monitor = of_two()
    for i in range(rate_hz):
        now_ns = 101 * S + i * S // rate_hz
        monitor.take_state(camera_state("a", 30 + i, 30 + i), now_ns)
        assert admitted(monitor, seen_at("a", now_ns - 40_000_000, now_ns - 20_000_000), now_ns) is not None
    assert monitor.judge(102 * S, {})["a"].state == state
    assert not monitor.refused("a")


def test_silence_ends_and_dead_processes_are_named() -> None:
    monitor = Monitor(("a", "b", "c"))
    run_frames(monitor, {"a": (0, 0), "b": (0, 0), "c": (0, 0)}, 100 * S, 1)
    monitor.take_state(camera_state("b", 30, 30, state="ended", text="the source has ended"), 101 * S)
    verdicts = monitor.judge(103 * S, {"c": CameraHealth("dead", "process 1 ended by signal SIGKILL")})
    assert [verdicts[name].state for name in "abc"] == ["silent", "ended", "dead"]
    assert "SIGKILL" in verdicts["c"].text
    assert {event.name for event in monitor.events} == {"a", "b", "c"}


def test_counts_continue_when_a_process_was_restarted() -> None:
    monitor = Monitor(("a",))
    for captured in (10, 40, 5, 9):
        monitor.take_state(camera_state("a", captured, captured, replaced=1), captured * S)
    assert (monitor.source("a").captured, monitor.source("a").replaced) == (49, 2)


# --- where the time went


def test_quantiles_agree_with_numpy_to_a_bin() -> None:
    values = np.random.default_rng(5).gamma(3.0, 9.0, 5000)
    histogram = Histogram()
    for value in values.tolist():
        histogram.add(value)
    for share in (0.5, 0.95, 0.99):
        assert histogram.quantile_ms(share) == pytest.approx(np.quantile(values, share), abs=0.25)
    assert histogram.figures()["mean"] == pytest.approx(values.mean())
    assert np.isnan(Histogram().quantile_ms(0.5))


def test_stages_add_up_to_the_total() -> None:
    latencies = Latencies(("a", "b"))
    latencies.view_out(ViewTimes("a", 0, 3_000_000, 5_000_000, 14_000_000, 15_000_000), 21_000_000)
    figures = latencies.figures()["cameras_ms"]
    spans = {stage: row["mean"] for stage, row in figures["a"].items()}
    assert spans == {"capture": 3.0, "wait": 2.0, "2D": 9.0, "fuse": 1.0, "output": 6.0, "total": 21.0}
    assert figures["b"]["total"]["n"] == 0


# --- between processes


def loopback_pair() -> tuple[socket.socket, socket.socket]:
    """As Windows makes a socket pair."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        one = socket.create_connection(server.getsockname())
        return one, server.accept()[0]


PAIRS = {"as here": None, "loopback": loopback_pair}


@pytest.fixture(params=PAIRS)
def channels(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> tuple[Channel, Channel]:
    if PAIRS[request.param]:
        monkeypatch.setattr("posefuse.foundation.channel.message_sockets", PAIRS[request.param])
    return Channel.pair()


def received(channel: Channel, other: Channel) -> object:
    """The next message; what the other end still has to send goes out whenever it is used."""
    assert other.receive() is None
    return channel.receive() if channel.wait(0.2) else None


def test_a_channel_keeps_messages_whole_and_is_bounded(channels: tuple[Channel, Channel]) -> None:
    one, two = channels
    assert two.receive() is None
    assert one.send({"x": 1}) and one.send(b"y" * 50_000)
    assert received(two, one) == {"x": 1}
    assert len(received(two, one)) == 50_000
    sent = 0
    while one.send(b"z" * 10_000):
        sent += 1
        assert sent < 10_000
    assert not one.send(b"z" * 10_000)
    while received(two, one) is not None:
        sent -= 1
    assert sent == 0
    one.close()
    for use in (two.receive, lambda: two.send(1)):
        with pytest.raises(ChannelClosed):
            use()


def test_half_a_message_is_never_given_out(channels: tuple[Channel, Channel]) -> None:
    """A writer that is killed midway: what came whole is received, then the end."""
    one, two = channels
    sent, whole = 0, []
    while one.send(bytes([sent % 251]) * 30_011):
        sent += 1
    one.close()
    with pytest.raises(ChannelClosed):
        while two.wait(5.0):
            whole += [message] if (message := two.receive()) is not None else []
    assert sent - 1 <= len(whole) <= sent
    assert all(message == bytes([n % 251]) * 30_011 for n, message in enumerate(whole))


def test_a_channel_waits_for_room_when_asked_to(channels: tuple[Channel, Channel]) -> None:
    one, two = channels
    sent = 0
    while one.send(b"z" * 10_000):
        sent += 1
    reader = threading.Timer(0.1, lambda: [two.receive() for _ in range(sent // 2)])
    reader.start()
    assert one.send(b"last", wait_s=10.0)
    reader.join(10.0)


# --- what the user says


def test_sources_are_named_per_camera(ring_rig, demo_session) -> None:
    rig = ring_rig(4)
    film = demo_session / "videos" / "cam01.mp4"
    entries = inputs_from_arguments([f"cam01=video:{film}", "cam00=rtsp://host/s", "cam03=usb:/dev/video7@640x480@30"], rig)
    assert [(entry.camera, entry.kind, entry.reopen) for entry in entries] == [
        ("cam00", "rtsp", True), ("cam01", "video", False), ("cam03", "usb", True)
    ]  # fmt: skip
    assert len(inputs_from_arguments([f"sim:{demo_session}"], rig)) == 4
    first, second = inputs_from_arguments(["cam01=realsense:A1@1280x720@15", "cam00=realsense:any"], rig)
    assert (first.config.serial, first.config.size, first.reopen) == ("any", "640x480", True)
    assert (second.config.serial, second.config.size) == ("A1", "1280x720@15")


@settings
class Thermal:
    """A camera of another package."""

    camera: str
    where: str
    zero_ns: int = 0

    def build(self) -> ScriptedSource:
        return ScriptedSource(self.camera, (0, 10))


def test_a_source_of_another_package_is_named_as_ours(ring_rig, monkeypatch: pytest.MonkeyPatch) -> None:
    theirs = [
        EntryPoint("thermal", f"{__name__}:Thermal", "posefuse.sources"),
        EntryPoint("gone", "no_such:C", "posefuse.sources"),
    ]
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry for entry in theirs if entry.group == group])
    [entry] = inputs_from_arguments(["cam01=thermal:10.0.0.7:80/a"], ring_rig(2))
    assert (entry.camera, entry.kind, entry.reopen) == ("cam01", "thermal", True)
    assert entry.config == Thermal(camera="cam01", where="10.0.0.7:80/a")
    assert entry.open(None).camera == "cam01"
    refusal(SourceError, "webcam.*usb.*sim, gone, thermal;", inputs_from_arguments, ["cam00=webcam:0"], ring_rig(2))
    refusal(DependencyError, "gone .*no_such", inputs_from_arguments, ["cam00=gone:0"], ring_rig(2))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["cam9=video:x.mp4"], "cam9.*cam00, cam01"),
        (["cam00=webcam:0"], "webcam.*usb"),
        (["video:x.mp4"], "CAMERA=KIND:WHERE"),
        (["cam00=video:x.mp4", "cam00=video:y.mp4"], "has a source already"),
        (["cam00=video:x.mp4", "cam01=video:x.mp4"], "cam01=video:x.mp4: camera cam00 has the same one"),
        (["cam00=usb:0", "cam01=usb:0"], "camera cam00 has the same one"),
    ],
)
def test_an_impossible_source_is_refused_with_a_list_of_sources(ring_rig, arguments: list[str], words: str) -> None:
    refusal(SourceError, words, inputs_from_arguments, arguments, ring_rig(2))


def test_a_source_of_another_size_than_calibrated_is_refused(ring_rig, demo_session) -> None:
    rig = ring_rig(2, size_wh=(1280, 720))
    [entry] = inputs_from_arguments([f"cam01=video:{demo_session / 'videos' / 'cam01.mp4'}"], rig)
    refusal(SourceError, "640x480 px, it was calibrated at 1280x720", entry.open, rig["cam01"])


def test_only_the_newest_frame_waits(ring_rig) -> None:
    news = threading.Condition()
    captures = [Capture(LiveInput(camera.name, "test", None, False), camera, news) for camera in ring_rig(2)]
    assert take_all(captures) == []
    frames = [built.frame("cam00", i * PERIOD_NS, seq=i) for i in range(3)]
    for frame in frames:
        captures[0].put(Caught(frame, 0))
    captures[1].put(Caught(replace(frames[0], camera="cam01"), 0))
    taken = take_all(captures)
    assert [caught.frame.camera for _, caught in taken] == ["cam00", "cam01"]
    assert taken[0][1].frame.image is frames[2].image
    assert take_all(captures) == []
    state = captures[0].state()
    assert (state.captured, state.used, state.replaced) == (3, 1, 2)


def test_a_video_begins_again_at_every_turn(ring_rig, demo_session) -> None:
    [entry] = inputs_from_arguments([f"cam00=video:{demo_session / 'videos' / 'cam00.mp4'}"], ring_rig(2))
    capture = Capture(replace(entry, loop_s=0.3), ring_rig(2)["cam00"], threading.Condition())
    capture.begin(time.monotonic_ns())
    taken, end_s = [], time.monotonic() + 20
    while len({caught.shift_ns for caught in taken}) < 3 and time.monotonic() < end_s:
        time.sleep(0.01)
        taken += [caught] if (caught := capture.take()) else []
    capture.close()
    turns, times = {caught.shift_ns for caught in taken}, [caught.t_ns for caught in taken]
    assert len(turns) == 3 and times == sorted(times)
    # half a second between two showings, which keeps the rig watch from comparing across it
    assert all(later_ns % (8 * S // 10) == 0 for later_ns in turns)
    assert all(caught.frame.t_ns < 3 * S // 10 for caught in taken)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--output", "nothing"), "no plug-in 'nothing' among live_outputs; there are: "),
        (("--output", "osc"), "live_outputs osc: to: missing"),
        (("--output", "lsl", "--set", "outputs.lsl.speed=3"), "unknown key 'speed'"),
        (("--set", "outputs.osc.to=[]"), "to:"),
        *((("--people", text), "--people") for text in ("0", "-1", "65")),
        *((("--duration", text), "duration_s") for text in ("nan", "-5", "0", "inf")),
        *((("--loop", text), "loop_s") for text in ("nan", "0", "-1", "inf")),
        (("--osc", "127.0.0.1:9", "--set", "outputs.osc.axes=sideways"), "axes"),
        (("--record", "walk.mp4"), "walk.mp4: expected a name that ends in .mcap"),
        (("--osc", "nonsense"), "host:port"),
        (("--record", "/nowhere/x.mcap"), "there is no folder /nowhere"),
        (("--axes", "y_up"), "no output of this session has axes"),
        (("--domain", "5"), "--domain 5: no source and no output is in ROS 2; leave it out, or add one"),
        (("--peer", "10.0.0.7", "--peer", "10.0.0.8", "--record", "walk.mcap"), "--peer 10.0.0.7 10.0.0.8: no source"),
        (("--local-only", "--osc", "127.0.0.1:9"), "--local-only: no source"),
        (("--sim-time",), "--sim-time: no source"),
        (("--record", "walk"), "walk: expected a name that ends in .mcap"),
        (("--record", "walk.mcap", "--videos", "walk.mcap"), "the folder of --videos"),
        (("--record", "kept/walk.mcap", "--videos", "kept"), "the folder of --videos"),
        (("--record", "earlier/a.2.mcap"), "by its name it is a later part of a.mcap"),
        (("--record", "earlier/b.mcap"), "by its name, b.3.mcap is a later part of it"),
        (("--source", "cam00=video:"), "expected where it is after video:"),
        (
            ("--source", "cam00=usb:0", "--source", "cam01=usb:1", "--loop", "4"),
            "--loop 4: no source is a video or a simulated session",
        ),
        ((), "expected sources for at least 2 cameras, got 0"),
    ],
)
def test_options_that_cannot_be_are_one_line_before_anything_starts(
    options, words, demo_session, tmp_path, monkeypatch, capsys
) -> None:
    """Options of `posefuse live` go through the same validation as the settings file, and no network is fetched."""
    monkeypatch.setattr("posefuse.api.live_run.fetch_networks", lambda *_: pytest.fail("networks were fetched"))
    monkeypatch.chdir(tmp_path)
    kept = [tmp_path / name for name in ("kept", "earlier", "earlier/a.mcap", "earlier/b.3.mcap")]
    for place in kept:
        place.touch() if place.suffix else place.mkdir()
    source = () if not options or options[0] == "--source" else ("--source", f"sim:{demo_session}")
    assert cli.main(["live", str(demo_session / "rig.toml"), *source, *options]) == 1
    out, err = capsys.readouterr()
    assert out == "" and words in err
    assert err.count("\n") == 1 and "Traceback" not in err
    assert sorted(tmp_path.rglob("*")) == sorted(kept)


@pytest.mark.parametrize("people", [False, True])
def test_a_report_is_suggested_only_where_a_person_was_tracked(people, tmp_path, monkeypatch, capsys) -> None:
    (record := tmp_path / "walk.mcap").touch()
    run = LiveRun(figures={"videos": {}}, stopped_by="", failed=False, people=people, blocks=())
    monkeypatch.setattr("posefuse.track_live", lambda *_, **options: run)
    assert cli.main(["live", "rig.toml", "--source", "sim:none", "--record", str(record)]) == (0 if people else NO_PERSON_CODE)
    assert ("posefuse report" in capsys.readouterr().err) == people


def test_where_ros_2_is_has_no_effect_on_a_recording_without_its_topics(demo_session, tmp_path, capsys) -> None:
    assert cli.main(["record", "--source", f"sim:{demo_session}", "--out", str(tmp_path / "new"), "--domain", "5"]) == 1
    assert "--domain 5: no source and no output is in ROS 2" in capsys.readouterr().err and not (tmp_path / "new").exists()


# --- times of streams


def test_stamps_are_placed_at_the_least_delay_and_follow_drift() -> None:
    rng = np.random.default_rng(2)
    delay_ns, drift = 30_000_000, 100e-6
    clock, errors = StampClock(), []
    for i in range(60 * 30):
        true_ns, stamp_ns = 1000 * S + i * PERIOD_NS, round(i * PERIOD_NS * (1 + drift)) + 5 * S
        errors.append(clock.placed(stamp_ns, true_ns + delay_ns + int(rng.exponential(15e6))) - true_ns - delay_ns)
    assert np.abs(errors[300:]).max() < 3_000_000


def test_times_of_streams_only_go_forward() -> None:
    clock = StampClock()
    times = [clock.placed(stamp, arrived) for stamp, arrived in ((100, 1000), (50, 1010), (None, 1005), (None, 900))]
    assert all(later > earlier for earlier, later in itertools.pairwise(times))


@pytest.mark.parametrize("jump_s", [-5, 5])
def test_a_camera_that_sets_its_clock_is_right_again_at_once(jump_s: int) -> None:
    clock, errors = StampClock(), []
    for i in range(300):
        true_ns = 1000 * S + i * PERIOD_NS
        errors.append(clock.placed(i * PERIOD_NS + 60 * S + (i > 150) * jump_s * S, true_ns + 10_000_000) - true_ns)
    assert np.abs(errors).max() < 20_000_000


@pytest.mark.parametrize("stalled_s", [5, 13])
def test_images_that_waited_in_the_network_keep_their_times(stalled_s: int) -> None:
    """They come all at once after it; after more than 10 s they were taken for images of just now."""
    clock, errors, resumes_ns = StampClock(), [], (1020 + stalled_s) * S
    for i in range(1200):
        true_ns = 1000 * S + i * PERIOD_NS
        # those of the first 8 s of the stall wait; of what comes later there was no room
        if 1028 * S < true_ns < resumes_ns:
            continue
        came_ns = resumes_ns + i * 1_000_000 if 1020 * S < true_ns < 1028 * S else true_ns
        errors.append(clock.placed(i * PERIOD_NS, max(came_ns, true_ns) + 10_000_000) - true_ns)
    assert np.abs(errors).max() < 20_000_000


@pytest.mark.parametrize("jump_s", [-7200, 7200])
def test_the_clock_of_a_session_continues_when_that_of_the_machine_is_set(monkeypatch: pytest.MonkeyPatch, jump_s: int) -> None:
    clock, real = SessionClock.begin(), time.time_ns
    before_ns = clock.now_ns()
    assert abs(before_ns - real()) < 600 * S
    monkeypatch.setattr(time, "time_ns", lambda: real() + jump_s * S)
    assert 0 <= clock.now_ns() - before_ns < 600 * S


# --- where the machine is too slow to watch the rig, that is said, and not that cameras were moved or are late


ILL = {"a": CameraHealth("moved", "a is off by 21 mm relative to the other cameras")}


@pytest.mark.parametrize(("used", "state"), [(15, "overload"), (28, "moved")])
def test_a_finding_stands_where_frames_are_used_and_else_overload_is_reported(used: int, state: str) -> None:
    monitor = Monitor(("a", "b"))
    for t_s in range(1, 9):
        monitor.take_state(camera_state("a", 30 * t_s, used * t_s), t_s * S)
        monitor._watches["a"].seen_ns = t_s * S
    verdict = monitor.judge(8 * S, {}, ILL)["a"]
    assert verdict == ILL["a"] if state == "moved" else "only 50% of its frames are used" in verdict.text
    assert verdict.state == state and monitor.overloaded("a") == (state == "overload") and not monitor.overloaded("b")
    # as long as nothing seems to be wrong there is nothing to say
    assert monitor.judge(8 * S, {}, {})["a"].state == "ok"
