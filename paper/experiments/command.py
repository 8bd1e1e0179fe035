"""What `python -m paper` does around the experiments: files, headline figures, the summary."""

from __future__ import annotations

import argparse
import importlib
import json
from collections.abc import Mapping
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

from posefuse.cli.networks import fetch_networks
from posefuse.cli.terminal import Terminal
from posefuse.formats.page import Facts, Heading, write_page
from posefuse.foundation.atomic import atomic_file
from posefuse.foundation.growing_folder import growing_folder
from posefuse.foundation.plain_values import plain
from posefuse.foundation.plugins import build_plugin

from .runs import Context, about
from .summary import FILE as SUMMARY_FILE
from .summary import write_summary

EXPERIMENTS = ("static", "walking", "latency", "drift", "occlusion", "scaling")


def experiment(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Run one experiment or all; returns the files written."""
    wanted = EXPERIMENTS if args.name == "all" else (args.name,)
    names = [f"{name}{ending}" for name in wanted for ending in (".html", ".json")] + ([] if args.quick else [SUMMARY_FILE])
    folder = growing_folder(args.out, command="experiment", names=names)
    options = (" --quick" if args.quick else "") + "".join(f" --set {override}" for override in args.overrides)
    written: list[Path] = []
    for name in wanted:
        command = f"python -m paper {name}{options}"
        sessions = args.sessions or args.out / "sessions"
        context = Context(sessions, args.quick, args.workers, command, terminal, tuple(args.overrides))
        if name != "scaling":
            _check_detector(context)
        made = _one(name, context, args.out)
        folder.add(folder.folder / path.name for path in made)
        written += made
    if not args.quick:
        written.append(write_summary(args.out))
        folder.add([folder.folder / written[-1].name])
    terminal.facts("Experiments", {path.name: str(path) for path in written})
    terminal.next(f"open {written[0]} in a browser", "the figures of the first experiment")
    return {"files": written}


def _check_detector(context: Context) -> None:
    """Fetch and build the detector, so that an error shows before an hour of rendering."""
    choice = context.config.detector
    fetch_networks(choice, context.terminal)
    build_plugin("detectors", choice.name, choice.options)


def _one(name: str, context: Context, out: Path) -> list[Path]:
    module = importlib.import_module(f"paper.experiments.{name}")
    outcome = module.run(context)
    facts = about(context)
    blocks = [*outcome.page.blocks, Heading("How it was made"), Facts(facts)]
    page = write_page(out / f"{name}.html", replace(outcome.page, blocks=blocks))
    figures = out / f"{name}.json"
    with atomic_file(figures) as temporary:
        content = {"experiment": name, "date": str(date.today()), **facts, "figures": plain(outcome.figures)}
        temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return [page, figures]
