"""How a recording was made: the figures of a run, and its summary for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posefuse.core import Recording
from posefuse.evaluation.metrics import JointErrors, joint_errors
from posefuse.evaluation.report import CAMERA_COLUMNS, camera_rows
from posefuse.formats.truth import read_truth
from posefuse.foundation.plugins import plugin_config
from posefuse.foundation.summary import Block, Facts, Heading, Table

if TYPE_CHECKING:
    from posefuse.detection.build import DetectorChoice
    from posefuse.pipeline.session import Session
    from posefuse.pipeline.track import Tracked

TRUTH_FILE = Path("truth") / "truth.npz"


@dataclass(frozen=True, kw_only=True)
class RunOutcome:
    """How a run went.

    Attributes:
        figures: plain values, as ``--json`` prints them; ``failed`` has why outputs were not written, by name.
        summary: the same for people.
    """

    figures: Mapping[str, Any]
    summary: tuple[Block, ...]


def tracked_outcome(out: Path | None, session: Session, detector: DetectorChoice, tracked: Tracked) -> RunOutcome:
    """Of a session that was tracked; with the errors against the truth where the session has it."""
    path = session.folder / TRUTH_FILE
    errors = joint_errors(tracked.recording.poses, read_truth(path)) if path.is_file() else None
    figures = _tracked_figures(out, tracked, errors)
    if session.kind != "pose2d":
        figures["network"] = network_shown(detector)
    return RunOutcome(figures=figures, summary=_tracked_summary(figures, errors))


def network_shown(detector: DetectorChoice) -> str:
    """The network, or its card, by which keypoints were found."""
    config = plugin_config("detectors", detector.name, detector.options)
    return str(next((getattr(config, key) for key in ("card", "landmarks") if hasattr(config, key)), detector.name))


def _tracked_figures(out: Path | None, tracked: Tracked, errors: JointErrors | None) -> dict[str, Any]:
    recording = tracked.recording
    figures: dict[str, Any] = {
        **_of_both(out, recording, tracked.files, tracked.failed, tracked.seconds),
        "start_up_s": tracked.start_up_s,
        "time_steps_per_s": len(recording.poses) / (tracked.seconds - tracked.start_up_s),
        "camera_fits": recording.provenance["camera_fits"],
        "rig_warnings": recording.provenance["rig_warnings"],
        "exit_code": int(bool(tracked.failed or recording.provenance["rig_warnings"])),
    }
    return figures | ({"mpjpe_mm": errors.mpjpe_mm} if errors else {})


def _of_both(
    out: Path | None, recording: Recording, files: Sequence[Path], failed: Mapping[str, str], seconds: float
) -> dict[str, Any]:
    """What is stated alike of a session that was tracked and of a recording that was solved again."""
    return {
        "cameras": len(recording.rig),
        "time_steps": len(recording.poses),
        "images": recording.observations.image_count,
        "people": len(recording.poses.person_id),
        "seconds": seconds,
        "failed": dict(failed),
        "exit_code": int(bool(failed)),
        "out": out,
        "files": [path.name for path in files],
    }


def _tracked_summary(figures: Mapping[str, Any], errors: JointErrors | None) -> tuple[Block, ...]:
    facts = {
        "cameras": figures["cameras"],
        "frames": f"{figures['time_steps']} time steps, {figures['images']} images",
        "people": figures["people"],
        **({"network": figures["network"]} if "network" in figures else {}),
    }
    if errors:
        facts["MPJPE against the truth"] = f"{errors.mpjpe_mm:.1f} mm (14 joints)"
        worst = max(range(len(errors.joints)), key=lambda i: errors.mean_mm[i])
        facts["worst joint"] = f"{errors.joints[worst]} {errors.mean_mm[worst]:.1f} mm"
    speed, start_up_s = figures["time_steps_per_s"], figures["start_up_s"]
    facts["speed"] = f"{speed:.1f} time steps/s with everything, after {start_up_s:.0f} s to start"
    cameras = Table(CAMERA_COLUMNS, camera_rows(figures["camera_fits"]))
    return Heading("Cameras"), cameras, Heading("Result"), Facts({**facts, **_written(figures)})


def solved_outcome(
    out: Path, recording: Recording, *, files: Sequence[Path], failed: Mapping[str, str], seconds: float, excluded: int
) -> RunOutcome:
    """Of a recording that was solved again with `excluded` stretches left out."""
    figures = {**_of_both(out, recording, files, failed, seconds), "exclusions": excluded}
    facts = {
        "from": f"{figures['images']} images of {figures['cameras']} cameras",
        "time steps": str(figures["time_steps"]),
        "people": str(figures["people"]),
        **_written(figures),
        **({"stretches left out": str(excluded)} if excluded else {}),
    }
    return RunOutcome(figures=figures, summary=(Heading("Second solve"), Facts(facts)))


def _written(figures: Mapping[str, Any]) -> dict[str, str]:
    if figures["out"] is None:
        return {}
    return {"result in": str(figures["out"]), "files": ", ".join(figures["files"])}
