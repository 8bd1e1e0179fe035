"""Where the processor time of a live session goes: per frame captured, per image used and per output tick.

    python bench/live_cost.py [--networks blazepose_lite] [--cameras 8] [--seconds 6] [--session examples/demo] [--record]
    python bench/live_cost.py --alone
    python bench/live_cost.py --empty --seconds 20

*Alone* times each stage by itself in one thread. *In a session* counts what the threads of a running `posefuse live` take (Linux:
/proc), the start-up left out; several programs on the machine lengthen that, as they share caches and cores. Milliseconds of
processor time, not of the clock. ``--empty`` shows the cameras their own rooms without the person, with a camera's noise.
Tables on stderr, one JSON object on stdout.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
from harness import DEMO, answer, arguments, live_command
from live import TWIN, twins
from live_program import Program, thread_seconds

from posefuse.core import Camera, Frame, Rig
from posefuse.detection import region_from_pose
from posefuse.detection.build import DetectorChoice, build_detector
from posefuse.detection.crops import square_crop
from posefuse.formats.pixels import DecodedPixels, PixelConverter
from posefuse.formats.rig import read_rig
from posefuse.formats.video import VideoWriter
from posefuse.foundation.channel import Channel
from posefuse.health.cameras import CameraState
from posefuse.kinematics import JointTracker
from posefuse.realtime.capture import SAMPLE_STEP
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.realtime.fusion import Fusion
from posefuse.realtime.messages import Centres, SeenView
from posefuse.realtime.outputs import OutputPlan, OutputProcess
from posefuse.sources.video import VideoConfig
from posefuse.tracking.stand_in import made_up_detections

FRAMES, VIEW_DELAY_NS, PERIOD_NS = 60, 45_000_000, 10_000_000
BEGIN_NS = 10**18
# of a session that is not counted: its beginning; of an empty room, until it is searched rarely
_LEAD_S, _EMPTY_LEAD_S = 1.5, 16.0


class Spent:
    """Milliseconds of processor time per call of each stage: the mean without the highest tenth, which holds interruptions."""

    def __init__(self) -> None:
        self._spent_s: dict[str, list[float]] = {}

    def of(self, stage: str, work: Callable[[], object]) -> object:
        """What `work` returns; its time counts for the stage."""
        begun_s = time.process_time()
        result = work()
        self._spent_s.setdefault(stage, []).append(time.process_time() - begun_s)
        return result

    def ms(self) -> dict[str, float]:
        """By stage."""
        return {stage: 1000 * float(np.mean(sorted(one)[: -(-9 * len(one) // 10)])) for stage, one in self._spent_s.items()}


def capture_stages(video: Path, spent: Spent) -> list[Frame]:
    """Decode and convert the first frames of a video."""
    frames, converter = [], PixelConverter()
    with av.open(str(video)) as container:
        container.streams.video[0].thread_type = "SLICE"
        decoded = container.decode(video=0)
        for i in range(FRAMES):
            frame = spent.of("decode", lambda: next(decoded))
            pixels = DecodedPixels(frame, converter)
            spent.of("fingerprint, to see whether it changes", lambda pixels=pixels: pixels.fingerprint(SAMPLE_STEP))
            spent.of("sample, while no person is followed", lambda pixels=pixels: pixels.sample(SAMPLE_STEP))
            image = spent.of("convert to RGB, when it is looked at", pixels.rgb)
            frames.append(Frame(camera=video.stem, seq=i, t_ns=i, received_ns=i, image=image))
    return frames


def image_stages(frames: list[Frame], camera: Camera, network: str, rig: Rig, spent: Spent) -> None:
    """Region, crop, network and message of each frame; the person is where the detector finds one in the first frame."""
    detector = build_detector(DetectorChoice(options={"landmarks": network, "streams": 1}), rig)
    ours, theirs = Channel.pair()
    [landmarks] = detector._landmarks
    [found] = detector.detect(frames[:1], [None])
    # a flat person that is seen where the detector found one
    xyz = camera.centre_world + 4.0 * camera.rays_world(found.xy_img[0].astype(float))
    for frame in frames:
        region = spent.of("region from the expected pose", lambda: region_from_pose(camera, xyz, detector.skeleton))
        crop = spent.of(
            "cut the crop", lambda frame=frame, region=region: square_crop(frame.image, region, landmarks.network.side_px)
        )
        spent.of(f"network {network}", lambda crop=crop: landmarks.network([crop]))
        [seen] = spent.of("whole detector", lambda frame=frame, region=region: detector.detect([frame], [[region]]))
        message = SeenView(detections=seen, state=state_of(seen.camera), received_ns=0, started_ns=0, detected_ns=0)
        spent.of("message to the fusion", lambda message=message: (ours.send(message), theirs.receive()))
    for end in (ours, theirs):
        end.close()


def state_of(camera: str) -> CameraState:
    """Of a camera that is well."""
    return CameraState(camera=camera, state="running", text="", captured=1, used=1, replaced=0, missing=0)


def fusion_stages(rig: Rig, spent: Spent, seconds: float = 3.0) -> None:
    """Views of all cameras at 30 frames/s through the fusion, and an output tick every 10 ms."""
    config, clock = LiveConfig(), SimpleNamespace(now=BEGIN_NS, now_ns=lambda: clock.now)
    detector = build_detector(DetectorChoice(options={"landmarks": "blazepose_lite"}), rig)
    skeleton = detector.skeleton
    estimator, joints = warmed_up(rig, skeleton, config), JointTracker(skeleton, config.joints)
    estimator.centring.learn(Centres(rig.names, detector.joint_centres))
    fusion = Fusion(rig, estimator, lambda _: None, clock, OutputProcess(OutputPlan(rig=rig, clock=clock)), joints=joints)
    views = [view for step in made_up_detections(rig, skeleton, round(30 * seconds), start_ns=BEGIN_NS) for view in step]
    events = [(view.t_ns + VIEW_DELAY_NS + i % len(rig) * 2_000_000, view) for i, view in enumerate(views)]
    events += [(BEGIN_NS + i * PERIOD_NS, None) for i in range(round(seconds * 1e9 / PERIOD_NS))]
    for clock.now, view in sorted(events, key=lambda event: event[0]):
        if view is None:
            spent.of("output tick: pose, joint centres, angles, where to look", lambda: fusion.tick(clock.now, PERIOD_NS))
            continue
        times = {"received_ns": clock.now - 20_000_000, "started_ns": clock.now - 10_000_000, "detected_ns": clock.now}
        seen = SeenView(detections=view, state=state_of(view.camera), **times)
        spent.of("view into the tracker", lambda seen=seen: fusion.take(seen))


def empty_rooms(session_folder: Path, folder: Path, seconds: float) -> dict[str, Path]:
    """Videos by camera: the median of its images over time, which the person who walks is not in, with noise of 4 levels."""
    rng, made = np.random.default_rng(0), {}
    for video in sorted((session_folder / "videos").glob("*.mp4")):
        images = [frame.image for frame in VideoConfig(video, video.stem).build().frames()][::12]
        room = np.median(images, axis=0)
        noisy = [(room + 4 * rng.normal(size=room.shape)).clip(0, 255).astype(np.uint8) for _ in range(15)]
        made[video.stem] = folder / video.name
        with VideoWriter(made[video.stem], (room.shape[1], room.shape[0]), 30.0, crf=20, preset="ultrafast") as writer:
            for i in range(round(30 * seconds)):
                writer.write(noisy[i % len(noisy)], round(i * 1e9 / 30))
    return made


def session(rig: Path, sources: list[str], seconds: float, lead_s: float, *options: object) -> tuple[list[dict], dict]:
    """Cores by what the threads of a live session of these sources do; and its own figures."""
    program = Program(live_command(rig, sources, *options))
    try:
        program.wait_for(": ok")
        time.sleep(lead_s)
        before, begun_s = thread_seconds(program.process.pid), time.monotonic()
        time.sleep(seconds)
        after, took_s = thread_seconds(program.process.pid), time.monotonic() - begun_s
        role = program.roles()
        if not any(role.get(pid) == "cameras" for pid, _ in after):
            raise SystemExit("the videos ended before the measurement: fewer --seconds")
        figures = program.stopped()
    finally:
        program.kill()
    cores: dict[str, float] = {}
    for (pid, thread), total_s in after.items():
        name = role.get(pid, "other")
        name += {"cameras": ": detection" if thread == pid else ": capture"}.get(name, "")
        cores[name] = cores.get(name, 0.0) + (total_s - before.get((pid, thread), 0.0)) / took_s
    captured, used = (sum(c[key] for c in figures["cameras"].values()) / figures["seconds"] for key in ("captured", "used"))
    facts = {
        "cores_in_all": sum(cores.values()),
        "ms_per_frame_captured": 1000 * cores.get("cameras: capture", 0.0) / captured,
        "ms_per_image_used": 1000 * sum(cores.values()) / used if used else None,
        "ms_per_tick_of_fusion": 1000 * cores["fusion"] / figures["poses_per_s"],
        "used_share": figures["used_share"],
        "latency_ms": figures["latency"]["all_cameras_total_ms"],
        "tick_late_p99_ms": figures["latency"]["output"]["behind_due_ms"]["p99"],
    }
    return [{"in a session": name, "cores": value} for name, value in cores.items()], facts


def main() -> None:
    args = arguments(
        __doc__, networks="blazepose_lite", cameras=8, seconds=6.0, session=DEMO, alone=False, empty=False, record=False
    )
    spent, tables = Spent(), {}
    with tempfile.TemporaryDirectory() as scratch:
        rig_file = Path(scratch) / "rig.toml"
        sources = twins(args.session, rig_file, args.cameras // 4 - 1)
        rig = read_rig(rig_file)
        if args.empty:
            rooms = empty_rooms(args.session, Path(scratch), args.seconds + _EMPTY_LEAD_S + 2)
            sources = [f"{name}=video:{rooms[name.replace(TWIN, '')]}" for name in rig.names]
        else:
            video = sorted((args.session / "videos").glob("*.mp4"))[0]
            image_stages(capture_stages(video, spent), rig[video.stem], args.networks, rig, spent)
            fusion_stages(rig, spent)
            tables["Alone"] = [{"stage": stage, "ms of processor time": ms} for stage, ms in spent.ms().items()]
        options = ["--networks", args.networks, *(["--record", Path(scratch) / "session.mcap"] if args.record else [])]
        if not args.alone:
            lead_s = _EMPTY_LEAD_S if args.empty else _LEAD_S
            tables["In a session"], facts = session(rig_file, sources, args.seconds, lead_s, *options)
            tables["Session"] = [facts]
    answer(args, tables, cameras=args.cameras, networks=args.networks)


if __name__ == "__main__":
    main()
