"""The command line: one module per command, nothing heavy imported before a command runs."""

from __future__ import annotations

import argparse
import importlib
import sys
import traceback
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

from posefuse import __version__

from .stopping import StopRequests, stop_requests

if TYPE_CHECKING:
    from .terminal import Terminal

COMMANDS = (
    "demo",
    "track",
    "live",
    "node",
    "calibrate",
    "view",
    "report",
    "simulate",
    "compare",
    "models",
    "fit-noise",
    "plugins",
    "doctor",
)


class Command(Protocol):
    """What a module in `cli/commands` offers."""

    SUMMARY: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare options."""
        ...

    def run(self, args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
        """Do the work, show its tables, return the same figures as plain values."""
        ...


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `posefuse`.

    Returns:
        0 complete, 1 a known error in one line, 2 a bug with its trace, 130 stopped by Ctrl-C, 143 by SIGTERM; the last two also
        where what was finished until then is kept.
    """
    with stop_requests() as requests:
        try:
            args = _parser().parse_args(argv)
        except KeyboardInterrupt:
            return _stopped("posefuse", requests)
        return _run(args, requests)


def _run(args: argparse.Namespace, requests: StopRequests) -> int:
    name = f"posefuse {args.command_name}"
    try:
        # imports numpy and more: Ctrl-C meanwhile is one line, too
        from posefuse.core import PosefuseError

        try:
            interrupted, code = _command(args)
        except PosefuseError as error:
            print(f"{name}: {error}", file=sys.stderr)
            return 1
    except KeyboardInterrupt:
        return _stopped(name, requests)
    except BrokenPipeError:
        return 0
    except Exception:  # noqa: BLE001 - the one place where a bug ends the program
        traceback.print_exc()
        print(f"{name}: this is a bug in posefuse {__version__}; please report the lines above", file=sys.stderr)
        return 2
    return requests.exit_code if interrupted else code


def _command(args: argparse.Namespace) -> tuple[bool, int]:
    """Run the command; returns whether it was interrupted and kept what it had, and else its exit code."""
    from .terminal import Terminal

    terminal = Terminal(as_json=args.json)
    figures = args.command.run(args, terminal)
    terminal.figures({"command": args.command_name, "version": __version__, **figures})
    return bool(figures.get("interrupted")), int(figures.get("exit_code", 1 if figures.get("failed") else 0))


def _stopped(name: str, requests: StopRequests) -> int:
    print(f"{name}: stopped by {requests.cause}", file=sys.stderr)
    return requests.exit_code


class _Parser(argparse.ArgumentParser):
    """A wrong command line is a known error like any other: one line, exit 1."""

    def error(self, message: str) -> NoReturn:
        """One line that names the command and where its options are listed."""
        self.exit(1, f"{self.prog}: {message}; see {self.prog} --help\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="posefuse", description="Several ordinary cameras + AI -> one accurate 3D human skeleton.")
    parser.add_argument("--version", action="version", version=f"posefuse {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name in COMMANDS:
        command: Command = importlib.import_module(f"posefuse.cli.commands.{name.replace('-', '_')}")  # type: ignore[assignment]
        sub = commands.add_parser(name, help=command.SUMMARY, description=command.SUMMARY)
        sub.add_argument("--json", action="store_true", help="figures as one JSON object on stdout, all else on stderr")
        command.add_arguments(sub)
        sub.set_defaults(command=command, command_name=name)
    return parser


if __name__ == "__main__":
    sys.exit(main())
