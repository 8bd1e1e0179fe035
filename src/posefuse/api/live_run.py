"""A live session on this machine from its start to its figures: `posefuse.track_live`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from posefuse import core
from posefuse.core import ConfigError, InputError, LiveOutputConfig, Progress
from posefuse.core.errors import warn_caller
from posefuse.formats.rig import rig_warnings
from posefuse.foundation.output_file import check_first_part, real_path
from posefuse.foundation.plugins import plugin_config
from posefuse.foundation.settings import settings_from_mapping
from posefuse.foundation.summary import MISSING, Block, Facts, Heading, Note, Table, number_text
from posefuse.health.camera_monitor import Event
from posefuse.pipeline.config import read_changed
from posefuse.realtime.config import LiveConfig, RunOptions
from posefuse.realtime.fusion_loop import Fusion
from posefuse.realtime.inputs import check_ros_is_used, compare_rig, inputs_from_arguments, shown_again
from posefuse.realtime.latency import STAGES
from posefuse.realtime.messages import LivePlan
from posefuse.realtime.networks import fetch_networks
from posefuse.realtime.outputs import check_live_outputs
from posefuse.realtime.session import Finished, check_enough, closing_lines, run_live
from posefuse.realtime.video_keeping import read_counts

from .arguments import lines_of, shown
from .record import check_videos_folder, kept_videos, video_figures
from .rig_and_detector import rig_of


def live_plan(
    rig: core.Rig | str | Path,
    sources: Mapping[str, str] | Sequence[str],
    *,
    config: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    outputs: Mapping[str, Mapping[str, Any]] | None = None,
    ros: Mapping[str, Any] | None = None,
    axes: str | None = None,
    duration_s: float | None = None,
    loop_s: float | Literal["shortest"] | None = None,
) -> LivePlan:
    """What `posefuse.live` and others are asked for, checked; what is odd about the rig is a `UserWarning`.

    Raises:
        PosefuseError: settings, sources or outputs that cannot be.
    """
    stated_s = None if loop_s == "shortest" else loop_s
    run = settings_from_mapping({"duration_s": duration_s, "loop_s": stated_s}, RunOptions, where="options")
    cameras = rig_of(rig, placed=True)
    for note in rig_warnings("live" if isinstance(rig, core.Rig) else rig, cameras):
        warn_caller(note)
    chosen = read_changed(None if config is None else Path(config), settings or {}, LiveConfig)
    configs = output_configs(chosen, outputs or {}, {**(ros or {}), **({"axes": axes} if axes else {})})
    check_live_outputs(configs)
    if axes and not any(hasattr(one, "axes") for one in configs.values()):
        raise ConfigError("axes: no output of this session has axes; expected one such as osc or json")
    return LivePlan(
        rig=cameras,
        inputs=shown_again(inputs_from_arguments(sources, cameras, ros), loop_s),
        config=chosen,
        outputs=configs,
        duration_s=run.duration_s,
    )


def output_configs(
    config: LiveConfig, outputs: Mapping[str, Mapping[str, Any]], given: Mapping[str, Any]
) -> dict[str, LiveOutputConfig]:
    """Configs of the outputs of the settings and of a call by name.

    Args:
        outputs: options by name, above those of the settings. given: options that every output with such an option takes.

    Raises:
        ConfigError: no such output, or options it does not take.
        InputError: a file to write that exists already, or whose name makes it a part of one that does.
    """
    chosen: dict[str, dict[str, Any]] = {}
    for name in {**config.outputs, **outputs}:
        stated = {key: value for key, value in config.outputs.get(name, {}).items() if key not in given}
        chosen[name] = {**stated, **outputs.get(name, {})}
    for name, key in (("record", "path"), ("rerun", "file")):
        if path := chosen.get(name, {}).get(key):
            check_first_part(Path(path), option=name)
            if key in outputs.get(name, {}):
                # relative to here; one of a settings file stays as it is
                chosen[name][key] = Path(path).absolute()
    return {name: plugin_config("live_outputs", name, one, known=given) for name, one in chosen.items()}


@dataclass(frozen=True, kw_only=True)
class LiveRun:
    """How a live session went.

    Attributes:
        figures: plain values. stopped_by: name of the signal that ended it; empty: none. failed: an output or a video failed.
        people: whether a person was ever tracked. blocks: figures and problems, for people.
    """

    figures: Mapping[str, Any]
    stopped_by: str
    failed: bool
    people: bool
    blocks: tuple[Block, ...]

    def summary(self) -> Sequence[Block]:
        """The figures and what went wrong, for people."""
        return self.blocks


def finished_run(done: Finished, *, more: Mapping[str, Any], failed: bool = False) -> LiveRun:
    """Of a session that is over. `more`: further figures."""
    figures = {**live_figures(done), **more}
    problems = [Note(line, warning=True) for line in closing_lines(done.fusion)]
    return LiveRun(
        figures=figures,
        stopped_by=done.stopped_by,
        failed=failed or done.fusion.outlets.failed,
        people=bool(done.fusion.poses_with_people),
        blocks=(*problems, *live_summary(figures)),
    )


def track_live(
    rig: core.Rig | str | Path,
    sources: Mapping[str, str] | Sequence[str],
    *,
    config: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    outputs: Mapping[str, Mapping[str, Any]] | None = None,
    ros: Mapping[str, Any] | None = None,
    axes: str | None = None,
    duration_s: float | None = None,
    loop_s: float | None = None,
    videos: str | Path | None = None,
    on_end: Callable[[LiveRun], None] | None = None,
    progress: Progress | bool | None = None,
) -> LiveRun:
    """Track live until the time is over, the sources end, or Ctrl-C; poses go to the outputs. `live` gives them to a program.

    Args:
        rig: as for `live`, as are `sources`, `settings`, `ros` and `duration_s`.
        config: settings file.
        outputs: options of outputs by name, e.g. ``{"record": {"path": "walk.mcap"}, "osc": {"to": ["localhost:9000"]}}``.
        axes: of outputs that have such an option: ``z_up``, ``y_up``, ``y_up_left_handed``.
        loop_s: show the first seconds of videos and simulated sessions again and again.
        videos: new folder that keeps the cameras' videos, a session for `track`.
        on_end: is given the figures before the videos are moved to their place, which a full disk may not allow.
        progress: True shows the session's news on stderr.

    Raises:
        PosefuseError: settings, sources or outputs that cannot be, or a camera that cannot be opened.

    Examples:
        >>> import posefuse as pf
        >>> run = pf.track_live("rig.toml", {"cam1": "usb:0", "cam2": "usb:1"}, duration_s=10)  # doctest: +SKIP
        >>> run.figures["poses_per_s"]  # doctest: +SKIP
        100.0
    """
    recorded = (outputs or {}).get("record", {}).get("path")
    if videos is not None:
        _check_videos(Path(videos), None if recorded is None else Path(recorded))
    plan = live_plan(
        rig, sources, config=config, settings=settings, outputs=outputs, ros=ros, axes=axes, duration_s=duration_s, loop_s=loop_s
    )  # fmt: skip
    check_enough(plan.inputs)
    check_ros_is_used(ros or {}, plan.inputs, plan.outputs)
    count = len(plan.inputs)
    with shown(progress) as news:
        say = lines_of(news, "live")
        compare_rig(plan.rig, plan.inputs, say)
        say(f"{count} camera{'s' * (count != 1)}: " + ", ".join(f"{entry.camera} ({entry.kind})" for entry in plan.inputs))
        fetch_networks(plan.config.detector, news)
        with kept_videos(None if videos is None else Path(videos), plan.rig, plan.inputs) as folder:
            done = run_live(plan, say, videos=folder)
            kept = video_figures(read_counts(folder, [entry.camera for entry in plan.inputs])) if folder else {}
            failed = any(one["fault"] for one in kept.values())
            run = finished_run(done, more={"videos": kept}, failed=failed)
            if on_end is not None:
                on_end(run)
    return run


def _check_videos(folder: Path, record: Path | None) -> None:
    """Raise InputError unless the videos of a session can go to `folder`, and its recording not into it."""
    check_videos_folder(folder, command="live")
    if record is not None and real_path(folder) in (real_path(record), *real_path(record).parents):
        raise InputError(f"`record={record}`: is, or lies in, the folder of `videos=DIR`; choose another place for one of them")


def _lengths(fusion: Fusion) -> dict[int, dict[str, dict[str, float]]]:
    """By person and segment, what the whole-body fit learnt; nothing where it is off."""
    people = {} if fusion.estimator.bodies is None else fusion.estimator.bodies.lengths
    return {person: {name: asdict(length) for name, length in lengths.items()} for person, lengths in people.items()}


def live_figures(done: Finished) -> dict[str, Any]:
    """Everything as plain values."""
    fusion, outputs = done.fusion, done.fusion.outlets.figures()
    cameras: dict[str, dict[str, Any]] = {}
    for name in fusion.rig.names:
        source = fusion.monitor.source(name)
        health = fusion.estimator.tracker.health[name]
        verdict = fusion.verdicts.get(name)
        cameras[name] = {
            "state": verdict.state if verdict else "opening",
            "captured": source.captured,
            "used": fusion.used[name],
            "used_share": fusion.used[name] / source.captured if source.captured else float("nan"),
            "replaced": source.replaced,
            "missing": source.missing,
            "refused": fusion.monitor.refused(name),
            "innovation_sigmas": health.innovation_sigmas,
            "gated_share": health.gated_share,
            "late": health.late,
        }
    captured = sum(camera["captured"] for camera in cameras.values())
    return {
        "seconds": done.seconds,
        "stopped_by": done.stopped_by,
        "zero_ns": done.zero_ns,
        "poses": fusion.poses,
        "poses_with_people": fusion.poses_with_people,
        "withheld": fusion.estimator.gate.figures(),
        "poses_per_s": fusion.latencies.rate_hz,
        "joint_centres": fusion.estimator.centring.made_by,
        "noise_scale": fusion.noise_scale,
        "segment_lengths": _lengths(fusion),
        "used_share": sum(fusion.used.values()) / captured if captured else float("nan"),
        # a session that is stopped while it starts has not begun
        "cpu_fusion_share": done.cpu_s[0] / done.seconds if done.seconds > 0 else float("nan"),
        "cpu_children_share": done.cpu_s[1] / done.seconds if done.seconds > 0 else float("nan"),
        "memory_mb": done.memory_mb,
        "restarts": done.restarts,
        "outputs": outputs,
        "outputs_lost": fusion.outlets.lost,
        "output_events": _events(fusion.outlets.events, done.zero_ns, "output"),
        "failed": [name for name, output in outputs.items() if output["failures"]],
        "rig_watch_trouble": fusion.watch.trouble if fusion.watch is not None else "",
        "cameras": cameras,
        "events": _events(fusion.monitor.events, done.zero_ns, "camera"),
        "latency": fusion.latencies.figures(),
    }


def _events(events: Sequence[Event], zero_ns: int, what: str) -> list[dict[str, Any]]:
    """What happened to a camera or an output (`what`), and when."""
    return [{"t_s": (one.t_ns - zero_ns) / 1e9, what: one.name, "state": one.state, "text": one.text} for one in events]


def live_summary(figures: Mapping[str, Any]) -> list[Block]:
    """The tables a person reads."""
    latency = figures["latency"]
    rows = [
        [
            name, camera["state"], f"{camera['used_share']:.0%}" if camera["captured"] else MISSING,
            *(number_text(latency["cameras_ms"][name][stage]["p50"], 1) for stage in STAGES),
            *(number_text(latency["cameras_ms"][name]["total"][share], 0) for share in ("p95", "p99")),
        ]
        for name, camera in figures["cameras"].items()
    ]  # fmt: skip
    stages = Table(("camera", "state", "used", *STAGES, "p95", "p99"), rows, text=True)
    whole, ticks = latency["all_cameras_total_ms"], latency["output"]
    rate = number_text(figures["poses_per_s"], 1)
    facts = {"poses": f"{figures['poses']} ({rate}/s), with a person in {figures['poses_with_people']}"}
    if figures["poses"]:
        facts |= {
            "exposure to output": ", ".join(f"{p} {number_text(whole[p], 1)}" for p in ("p50", "p95", "p99")) + " ms",
            "output rate": (
                f"p99 {number_text(ticks['behind_due_ms']['p99'], 2)} ms behind due, "
                f"{number_text(ticks['period_deviation_ms']['p99'], 2)} ms off the period, {ticks['skipped']} skipped"
            ),
            "processor": (
                f"fusion {figures['cpu_fusion_share']:.0%} of a core, "
                f"the rest {figures['cpu_children_share']:.0%} with the start of their processes"
            ),
            "memory": f"{figures['memory_mb']:.0f} MB at most, fusion and cameras",
        }
    if any(figures["withheld"].values()):
        cut = figures["withheld"]
        facts["withheld"] = f"{cut['keypoints']:.1%} of keypoints, {cut['people']:.1%} of people: too unsure, or not measured"
    if figures["joint_centres"]:
        facts["joint centres"] = "; ".join(f"offsets of {table}" for table in sorted(set(figures["joint_centres"].values())))
    if figures["noise_scale"] is not None:
        facts["noise"] = f"not fitted; scaled by {figures['noise_scale']:.2g} from this session"
    if math.isfinite(figures["used_share"]):
        facts["frames used"] = f"{figures['used_share']:.0%}"
    if figures["restarts"]:
        facts["restarts"] = str(figures["restarts"])
    for name, output in figures["outputs"].items():
        fault = f"; failed {output['failures']} times, the last: {output['fault']}" if output["failures"] else ""
        facts[f"output {name}"] = f"{output['taken']} taken, {output['dropped']} dropped{fault}"
    for name, video in figures.get("videos", {}).items():
        fault = f"; {video['fault']}" if video["fault"] else ""
        facts[f"video {name}"] = f"{video['written']} frames {video['how'] or 'written'}, {video['dropped']} dropped{fault}"
    if figures["outputs_lost"]:
        facts["outputs"] = f"{figures['outputs_lost']} messages lost before they reached an output"
    if figures["rig_watch_trouble"]:
        facts["rig watch"] = figures["rig_watch_trouble"]
    return [
        Heading("Median ms per stage from exposure to output, and of the total p95 and p99"),
        stages,
        Heading("Session"),
        Facts(facts),
    ]
