"""`posefuse experiment`: one of the paper's experiments, end to end, as a page and as figures."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal

from .options import add_networks

SUMMARY = "run one of the paper's experiments: render, find, fuse, compare with the truth, write a page and its figures"
NAMES = ("static", "walking", "latency", "drift", "occlusion", "scaling", "all")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Which one, where to, how long."""
    parser.add_argument("name", choices=NAMES, help="which experiment; all: every one, and the summary accuracy.md")
    parser.add_argument("--out", type=Path, default=Path("out/paper"), metavar="DIR", help="pages and figures; default out/paper")
    parser.add_argument("--sessions", type=Path, metavar="DIR", help="where rendered sessions are kept; default DIR/sessions")
    parser.add_argument("--quick", action="store_true", help="seconds of everything: to see that it works, not for figures")
    parser.add_argument(
        "--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE",
        help="any setting of `posefuse track`, in place of its default, e.g. detector.name=NAME; take another --out",
    )  # fmt: skip
    add_networks(parser)
    parser.add_argument("--workers", type=int, metavar="N", help="processes that render; default: one per core")


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Run, write, show the headline figures."""
    from paper.experiments.command import experiment

    return experiment(args, terminal)
