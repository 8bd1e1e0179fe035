"""Run the experiments of the paper: `python -m paper NAME --out DIR`."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path

from paper.experiments.runs import DEVICE, Console, Context, about
from paper.experiments.summary import EXPERIMENTS, report_of, write_summary
from paper.experiments.summary import FILE as SUMMARY_FILE
from posefuse.core import ConfigError, PosefuseError
from posefuse.detection import fetch_networks, network_settings
from posefuse.formats.page import Facts, Heading, Page, write_page
from posefuse.foundation import atomic_file, build_plugin, earlier_kept, growing_folder, plain


def main(words: Sequence[str] | None = None) -> int:
    """Render, detect, fuse, compare with the truth, write a page and its figures; `words` stand for the command line."""
    parser = argparse.ArgumentParser(prog="python -m paper", description=main.__doc__)
    add = parser.add_argument
    add("name", choices=(*EXPERIMENTS, "all"), help="which experiment; all: every one, and a summary")
    add("--out", type=Path, default=Path("out/paper"), metavar="DIR", help="pages and figures; default out/paper")
    add("--sessions", type=Path, metavar="DIR", help="where rendered sessions are kept; default DIR/sessions")
    add("--quick", action="store_true", help="seconds of everything: to see that it works, not for figures")
    add("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE",
        help="any setting of `posefuse track`, in place of its default, e.g. detector.name=NAME; take another --out")  # fmt: skip
    add("--networks", action="append", default=[], metavar="NAME", help="2D network, as in `posefuse track --help`")
    add("--device", dest="devices", action="append", default=[], metavar="WORD",
        help="processor of the network, e.g. cpu or cuda; latency: may be given several times, one session on each")  # fmt: skip
    add("--workers", type=int, metavar="N", help="processes that render; default: one per core")
    add("--json", action="store_true", help="figures as one JSON object on stdout")
    args = parser.parse_args(words)
    console = Console(as_json=args.json)
    try:
        if len(args.devices) > 1 and args.name != "latency":
            raise ConfigError(f"expected one --device for {args.name}, got {len(args.devices)}; latency takes several")
        networks = [f"{key}={value}" for name in args.networks for key, value in network_settings(name).items()]
        args.overrides = [*networks, *(f"{DEVICE}={word}" for word in args.devices[:1]), *args.overrides]
        console.figures({"files": experiments(args, console)})
    except PosefuseError as error:
        print(f"paper {args.name}: {error}", file=sys.stderr)
        return 1
    return 0


def experiments(args: argparse.Namespace, console: Console) -> list[Path]:
    """Run one experiment or all, and write the summary; returns the files written."""
    wanted = EXPERIMENTS if args.name == "all" else (args.name,)
    names = [f"{name}{ending}" for name in wanted for ending in (".html", ".json")] + ([] if args.quick else [SUMMARY_FILE])
    folder = growing_folder(args.out, command="experiment", names=names)
    shown = [f" --device {word}" for word in args.devices]
    shown += [f" --set {override}" for override in args.overrides if not override.startswith(f"{DEVICE}=")]
    options = (" --quick" if args.quick else "") + "".join(shown)
    sessions, written = args.sessions or args.out / "sessions", list[Path]()
    for name in wanted:
        command = f"python -m paper {name}{options}"
        context = Context(sessions, args.quick, args.workers, command, console, tuple(args.overrides), tuple(args.devices))
        if name != "scaling":
            for one in context.each_device().values():
                _check_detector(one)
        written += _one(name, context, folder)
    if not args.quick:
        written.append(write_summary(folder))
    for path in written:
        console.note(f"wrote {path}")
    return written


def _check_detector(context: Context) -> None:
    """Fetch and build the detector, so that an error shows before an hour of rendering."""
    choice = context.config.detector
    with context.console.stages() as progress:
        fetch_networks(choice, progress)
    build_plugin("detectors", choice.name, choice.options)


def _one(name: str, context: Context, out: Path) -> list[Path]:
    """The page and the figures of an experiment."""
    outcome = importlib.import_module(f"paper.experiments.{name}").run(context)
    facts = about(context)
    page, figures = out / f"{name}.html", out / f"{name}.json"
    with earlier_kept(page):
        made = (Heading("How it was made"), Facts(facts))
        write_page(page, Page(outcome.title, [*report_of(name, outcome.figures), *outcome.blocks, *made]))
    with earlier_kept(figures), atomic_file(figures) as temporary:
        content = {"experiment": name, "date": str(date.today()), **facts, "figures": plain(outcome.figures)}
        temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return [page, figures]


if __name__ == "__main__":
    sys.exit(main())
