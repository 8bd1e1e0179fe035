"""`posefuse calibrate guide`: a table and what to do next once a second, and pictures where they were asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from posefuse.calibration.targets.guidance import Guidance
from posefuse.cli.options.calibration import GuideOptions, TargetOptions
from posefuse.cli.terminal import Terminal
from posefuse.formats.rig import read_rig
from posefuse.outputs.rerun_scene import SPAWN
from posefuse.realtime.guide import guide, guide_view
from posefuse.realtime.inputs import inputs_from_arguments

from .inputs import check_files, target_of


def guide_at_cameras(target: TargetOptions, options: GuideOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Show what is covered until it is enough; returns the coverage."""

    def report(state: Guidance) -> None:
        covered = state.coverage
        rows = [(name, f"{share:.0%}", *counts) for name, share, counts in
                zip(covered.cameras, covered.share, covered.together.tolist(), strict=True)]  # fmt: skip
        terminal.table("seen together with", ("camera", "covered", *covered.cameras), rows)
        terminal.note(state.words)

    check_files((options.intrinsics,), (("--view-file", options.view_file),), force=options.force)
    kind = target_of(target)
    inputs = inputs_from_arguments(options.source, read_rig(options.intrinsics))
    place = str(options.view_file) if options.view_file else SPAWN if options.view else None
    with guide_view([one.camera for one in inputs], place) as show:
        found = guide(inputs, kind, report, show, options.duration)
    terminal.next("posefuse calibrate extrinsics --help", "the rig from what was recorded" if found.enough else found.words)
    covered = {name: float(share) for name, share in zip(found.coverage.cameras, found.coverage.share, strict=True)}
    return {"enough": found.enough, "covered": covered, "next": found.words}
