"""Run the experiments of the paper: `python -m paper NAME --out DIR`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from paper.experiments.command import EXPERIMENTS, experiment
from paper.experiments.runs import Console
from posefuse.core import PosefuseError
from posefuse.detection import network_settings


def main(words: Sequence[str] | None = None) -> int:
    """Render, detect, fuse, compare with the truth, write a page and its figures; `words` stand for the command line."""
    parser = argparse.ArgumentParser(prog="python -m paper", description=main.__doc__)
    parser.add_argument("name", choices=(*EXPERIMENTS, "all"), help="which experiment; all: every one, and a summary")
    parser.add_argument("--out", type=Path, default=Path("out/paper"), metavar="DIR", help="pages and figures; default out/paper")
    parser.add_argument("--sessions", type=Path, metavar="DIR", help="where rendered sessions are kept; default DIR/sessions")
    parser.add_argument("--quick", action="store_true", help="seconds of everything: to see that it works, not for figures")
    parser.add_argument(
        "--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE",
        help="any setting of `posefuse track`, in place of its default, e.g. detector.name=NAME; take another --out",
    )  # fmt: skip
    parser.add_argument(
        "--networks", action="append", default=[], metavar="NAME", help="2D network, as in `posefuse track --help`"
    )
    parser.add_argument("--workers", type=int, metavar="N", help="processes that render; default: one per core")
    parser.add_argument("--json", action="store_true", help="figures as one JSON object on stdout")
    args = parser.parse_args(words)
    console = Console(as_json=args.json)
    try:
        networks = [f"{key}={value}" for name in args.networks for key, value in network_settings(name).items()]
        args.overrides = [*networks, *args.overrides]
        console.figures(dict(experiment(args, console)))
    except PosefuseError as error:
        print(f"paper {args.name}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
