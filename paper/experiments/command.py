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

from paper.experiments.runs import Console
from posefuse.detection import fetch_networks
from posefuse.formats.page import Facts, Heading, write_page
from posefuse.foundation import atomic_file, build_plugin, earlier_kept, growing_folder, plain

from .runs import Context, about
from .summary import FILE as SUMMARY_FILE
from .summary import write_summary

EXPERIMENTS = ("static", "walking", "latency", "drift", "occlusion", "scaling")


def experiment(args: argparse.Namespace, console: Console) -> Mapping[str, Any]:
    """Run one experiment or all; returns the files written."""
    wanted = EXPERIMENTS if args.name == "all" else (args.name,)
    names = [f"{name}{ending}" for name in wanted for ending in (".html", ".json")] + ([] if args.quick else [SUMMARY_FILE])
    folder = growing_folder(args.out, command="experiment", names=names)
    options = (" --quick" if args.quick else "") + "".join(f" --set {override}" for override in args.overrides)
    written: list[Path] = []
    for name in wanted:
        command = f"python -m paper {name}{options}"
        sessions = args.sessions or args.out / "sessions"
        context = Context(sessions, args.quick, args.workers, command, console, tuple(args.overrides))
        if name != "scaling":
            _check_detector(context)
        written += _one(name, context, folder)
    if not args.quick:
        written.append(write_summary(folder))
    for path in written:
        console.note(f"wrote {path}")
    return {"files": written}


def _check_detector(context: Context) -> None:
    """Fetch and build the detector, so that an error shows before an hour of rendering."""
    choice = context.config.detector

    def show(stage: str, done: int, total: int | None, message: str = "") -> None:
        if message:
            context.console.note(message)

    fetch_networks(choice, show)
    build_plugin("detectors", choice.name, choice.options)


def _one(name: str, context: Context, out: Path) -> list[Path]:
    module = importlib.import_module(f"paper.experiments.{name}")
    outcome = module.run(context)
    facts = about(context)
    blocks = [*outcome.page.blocks, Heading("How it was made"), Facts(facts)]
    page, figures = out / f"{name}.html", out / f"{name}.json"
    with earlier_kept(page):
        write_page(page, replace(outcome.page, blocks=blocks))
    with earlier_kept(figures), atomic_file(figures) as temporary:
        content = {"experiment": name, "date": str(date.today()), **facts, "figures": plain(outcome.figures)}
        temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return [page, figures]
