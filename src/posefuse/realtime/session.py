"""A live session from views to outputs: processes started, the output rate kept, everything ended again.

For `posefuse.live` it runs in a process of its own (`serve`): the program that uses the poses cannot delay the output rate. Its
plan is an argument; poses, health and lines of news go over the channel, requests come back over it.
"""

from __future__ import annotations

import _thread
import math
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import LiveNames, LivePose, LivePreview, PosefuseError, Rig, SourceError
from posefuse.foundation.channel import Channel, ChannelClosed
from posefuse.foundation.compiled import compiling
from posefuse.foundation.platform import peak_memory_mb, punctual, usable_cores
from posefuse.foundation.requests_to_end import HANG_UP, REQUESTS_TO_END, Repeats, handling, heeded, put_off, without_terminal
from posefuse.kinematics import JointTracker

from .capture import LiveInput, keeping_packets
from .estimator import warmed_up
from .fusion_loop import Fusion
from .group import GroupPlan
from .inputs import compare_rig
from .messages import (
    AddOutput,
    KeepVideos,
    LivePlan,
    NamePerson,
    RemoveOutput,
    Requests,
    SessionClock,
    ShowImages,
    Stop,
    ViewSource,
)
from .networks import devices_of, on_device, settled_network
from .notices import LEAST_CAMERAS, LEAST_SHARE, News, Say, never_waiting
from .outputs import OutputProcess, SessionReader
from .processes import Groups
from .rig_watch import watching

# small images per second and camera, for viewers
_PREVIEW_HZ = 8.0


@dataclass(frozen=True, kw_only=True)
class Finished:
    """What a session leaves behind: figures for tables and reports.

    Attributes:
        fusion: with its latencies and monitor, and its outputs as they ended.
        zero_ns: session time of its 0 s: recorded sources show their time 0 then, or the wait for other machines began.
        seconds: how long it ran. stopped_by: name of the signal that ended it; empty when none did.
        restarts: of camera processes.
        cpu_s: processor time of the fusion process during the session, and of all its children, their start included.
        memory_mb: most memory of this process and its camera processes, added up.
    """

    fusion: Fusion
    zero_ns: int
    seconds: float
    stopped_by: str
    restarts: int
    cpu_s: tuple[float, float]
    memory_mb: float


def closing_lines(fusion: Fusion) -> Iterator[str]:
    """What there is to report at the end of a session: that this machine was too slow, and why no person was ever tracked."""
    came, images = sum(fusion.monitor.source(name).captured for name in fusion.rig.names), sum(fusion.used.values())
    slow = images < LEAST_SHARE * came
    if slow:
        yield f"in all, {images / came:.0%} of the images were processed"
    if fusion.poses_with_people:
        return
    seen = [name for name, count in fusion.seen.items() if count]
    if not images:
        why = "no image of any camera was processed"
    elif slow:
        why = "this computer is too slow for these cameras"
    elif len(seen) < LEAST_CAMERAS:
        where = f"in one camera only ({seen[0]})" if seen else "in none"
        why = f"people were seen {where} of {len(fusion.seen)} cameras; {LEAST_CAMERAS} at once are needed"
    else:
        why = f"people were seen by {', '.join(seen)}, but not at one place: is the calibration the one of these cameras?"
    yield f"no person was tracked: {why}"


def run_live(
    plan: LivePlan,
    say: Say,
    *,
    reader: SessionReader | None = None,
    videos: Path | None = None,
    requests: Requests | None = None,
) -> Finished:
    """A session with cameras of this machine: until the time is over, all sources have ended, or Ctrl-C.

    Args:
        reader: a program that takes messages, see `OutputProcess`. requests: what is changed on the way.
        videos: an existing folder that takes every camera's video; None: none are kept.

    Raises:
        SourceError: fewer than two cameras, or one that cannot be opened.
        InputError: an output that cannot be opened.
    """
    check_enough(plan.inputs)
    plan = replace(plan, rig=plan.rig.only(entry.camera for entry in plan.inputs))
    with never_waiting(say) as say_soon:
        detector = settled_network(plan.config.detector, len(plan.inputs), say_soon)
        plan, clock = replace(plan, config=replace(plan.config, detector=detector)), SessionClock.begin()
        groups = group_plans(plan, clock, videos)
        return run_session(plan, clock, lambda: Groups(groups), say_soon, reader=reader, requests=requests)


def check_enough(inputs: Sequence[LiveInput]) -> None:
    """Raise SourceError for fewer cameras than it takes to measure anything."""
    if len(inputs) < LEAST_CAMERAS:
        raise SourceError(f"expected sources for at least {LEAST_CAMERAS} cameras, got {len(inputs)}; each camera needs one")


def run_session(
    plan: LivePlan,
    clock: SessionClock,
    open_views: Callable[[], AbstractContextManager[ViewSource]],
    say: Say,
    *,
    remote: bool = False,
    reader: SessionReader | None = None,
    requests: Requests | None = None,
) -> Finished:
    """Outputs, tracker, joint centres, rig watch and fusion around the views that `open_views()` brings.

    Args:
        plan: with the cameras that take part. reader, requests: as of `run_live`.
        remote: views come from other machines, whose clocks are compared on the way.

    Raises:
        SourceError: views that cannot come.
        InputError: an output that cannot be opened.
    """
    rig, config, outputs = plan.rig, plan.config, OutputProcess(plan, clock, reader)
    try:
        with ExitStack() as stack:
            stopped, views = stack.enter_context(stop_requests()), stack.enter_context(open_views())
            outputs.wait_ready()
            skeleton = views.wait_ready(stopped)
            watch = stack.enter_context(watching(rig, clocks=remote, noise=not views.noise_fitted))
            say("; ".join(filter(None, [*views.whereabouts(), watch.whereabouts() if watch else "", outputs.whereabouts()])))
            with compiling("live tracking", say):
                estimator = warmed_up(rig, skeleton, config, stopped)
            joints = JointTracker(skeleton) if outputs.wants(LivePose) else None
            fusion = Fusion(rig, estimator, views.expect, clock, outputs, watch=watch, joints=joints)
            for centres in views.centres():
                fusion.take(centres)
            zero_ns = views.start(clock)
            # what was compiled and loaded before is not the session's
            begun = os.times()
            news = News(fusion, zero_ns, say, views.notices, watches_pace=not remote)
            with punctual():
                over = _until(plan.duration_s, zero_ns, fusion, news, stopped)
                fusion.run(views, config.rate_hz, over if requests is None else _controlled(over, requests, views, outputs))
            restarts, memory_mb = views.restarts, peak_memory_mb([os.getpid(), *views.pids])
    finally:
        outputs.close()
    news.report(clock.now_ns())
    times = os.times()
    return Finished(
        fusion=fusion,
        zero_ns=zero_ns,
        seconds=(clock.now_ns() - zero_ns) / 1e9,
        stopped_by=stopped[0] if stopped else "",
        restarts=restarts,
        cpu_s=(times.user + times.system - begun.user - begun.system, times.children_user + times.children_system),
        memory_mb=memory_mb,
    )


def _until(duration_s: float | None, zero_ns: int, fusion: Fusion, news: News, stopped: Sequence[str]) -> Callable[[int], bool]:
    end_ns = None if duration_s is None else zero_ns + round(duration_s * 1e9)

    def until(now_ns: int) -> bool:
        news.report(now_ns)
        over = end_ns is not None and now_ns >= end_ns
        return over or bool(stopped) or fusion.monitor.all_ended()

    return until


def _controlled(
    over: Callable[[int], bool], requests: Requests, views: ViewSource, outputs: OutputProcess
) -> Callable[[int], bool]:
    """`over`, which does what was asked for since the last tick first."""
    names: dict[int, str] = {}

    def until(now_ns: int) -> bool:
        while not requests.empty():
            match requests.get_nowait():
                case ShowImages() | KeepVideos() as request:
                    views.control(request)
                case AddOutput(name, config):
                    outputs.add(name, config)
                case RemoveOutput(name):
                    outputs.remove(name)
                case NamePerson(person, name):
                    names[person] = name
                    outputs.offer(LiveNames(t_ns=now_ns, names=dict(names)))
        return over(now_ns)

    return until


def group_plans(plan: LivePlan, clock: SessionClock, videos: Path | None = None) -> list[GroupPlan]:
    """Neighbouring cameras share a group: whichever is lost, the others still look from different directions.

    On a graphics card one group looks at all waiting images in one call: its cameras share one copy of the network there.
    """
    rig, inputs, config = plan.rig, plan.inputs, plan.config
    cores, devices, detector = usable_cores(), devices_of(config.detector), config.detector
    together = devices not in (["auto"], ["cpu"])
    count = config.groups or (len(devices) if together else max(1, min(cores, len(inputs) // 2)))
    count = min(count, len(inputs))
    if detector.name in ("blazepose", "onnx"):
        streams = max(1, cores // count)
        detector = replace(detector, options={"streams": streams, **detector.options})
    # a program that reads the session asks for images when it wants them
    shown = any(LivePreview in output.takes for output in plan.outputs.values())
    by_name = {entry.camera: keeping_packets(entry) if videos else entry for entry in inputs}
    return [
        GroupPlan(
            rig=rig,
            inputs=tuple(by_name[name] for name in cameras),
            detector=on_device(detector, devices[i % len(devices)]) if together else detector,
            together=together,
            clock=clock,
            most_people=config.track.max_people,
            search_every_s=config.search_every_s,
            preview_hz=_PREVIEW_HZ if shown else 0.0,
            videos=videos,
        )
        for i, cameras in enumerate(blocks(rig, list(by_name), count))
    ]


def blocks(rig: Rig, cameras: Sequence[str], count: int) -> list[list[str]]:
    """`cameras` in `count` blocks by azimuth about the middle of the rig, from the first camera on; equal ones as they come."""
    ahead = rig.centres_world() - rig.centres_world().mean(axis=0)
    azimuth = dict(zip(rig.names, np.arctan2(ahead[:, 1], ahead[:, 0]).tolist(), strict=True))
    turned = {name: round(azimuth[name] - azimuth[cameras[0]], 6) % math.tau for name in cameras}
    return [block.tolist() for block in np.array_split(sorted(cameras, key=turned.__getitem__), count)]


@contextmanager
def stop_requests() -> Iterator[list[str]]:
    """A list that stays empty until Ctrl-C or a request to terminate; a second one interrupts as usual.

    Whatever interrupts the block is put down to the first request: the handler that was there before raises what it raises.
    """
    stopped: list[str] = []
    repeats = Repeats()

    def note(number: int, frame: Any) -> None:
        if put_off(number, frame) or repeats.repeated(number):
            return
        if stopped:
            raise KeyboardInterrupt
        stopped.append(signal.Signals(number).name)
        if number == HANG_UP:
            without_terminal()

    with handling(heeded((signal.SIGINT, *REQUESTS_TO_END)), note) as before:
        try:
            yield stopped
        except KeyboardInterrupt:
            earlier = before[signal.Signals[stopped[0]]] if stopped else None
            if callable(earlier):
                earlier(signal.Signals[stopped[0]], None)
            raise


_SEND_S, _LOOK_S, _END_SEND_S = 1.0, 0.2, 30.0


@dataclass(frozen=True)
class Ended:
    """The session is over; `error` is the reason for a failure, None after a normal end."""

    error: PosefuseError | None


def serve(channel: Channel, plan: LivePlan, images: bool) -> None:
    """Body of the process: run the session until it ends, it is stopped (it interrupts itself), or no one listens any more.

    `images`: send the cameras' small images, too, each after its detections.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    requests = Requests()
    error: PosefuseError | None = None
    try:
        # it may interrupt at once
        threading.Thread(target=_take_requests, args=(channel, requests), daemon=True).start()

        def say(line: str) -> None:
            with suppress(ChannelClosed):
                channel.send(line, _SEND_S)

        compare_rig(plan.rig, plan.inputs, say)
        run_live(plan, say, reader=SessionReader(channel, images), requests=requests)
    except PosefuseError as problem:
        error = problem
    except KeyboardInterrupt:
        pass
    with suppress(ChannelClosed):
        channel.send(Ended(error), _END_SEND_S)


def _take_requests(channel: Channel, requests: Requests) -> None:
    # it also ends when the program that wanted the poses has ended
    with suppress(ChannelClosed):
        while True:
            channel.wait(_LOOK_S)
            while (message := channel.receive()) is not None:
                if isinstance(message, Stop):
                    _thread.interrupt_main()
                    return
                requests.put(message)
    _thread.interrupt_main()
