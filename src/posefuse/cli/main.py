"""The command line: one module per command, nothing heavy imported before a command runs."""

from __future__ import annotations

import argparse
import importlib
import sys
import traceback
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn, Protocol

from posefuse import __version__
from posefuse.core import PosefuseError

from .terminal import Terminal

COMMANDS = (
    "track",
    "live",
    "node",
    "calibrate",
    "view",
    "report",
    "simulate",
    "experiment",
    "compare",
    "models",
    "plugins",
    "doctor",
)
INTERRUPTED = 130


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
    """Entry point of `posefuse`: 0 done, 1 a known error in one line, 2 a bug with its trace, 130 Ctrl-C."""
    args = _parser().parse_args(argv)
    terminal = Terminal(as_json=args.json)
    try:
        figures = args.command.run(args, terminal)
        terminal.figures({"command": args.command_name, "version": __version__, **figures})
    except PosefuseError as error:
        print(f"posefuse {args.command_name}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"posefuse {args.command_name}: stopped by Ctrl-C", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        return 0
    except Exception:  # noqa: BLE001 - the one place where a bug ends the program
        traceback.print_exc()
        print(
            f"posefuse {args.command_name}: this is a bug in posefuse {__version__}; please report the lines above",
            file=sys.stderr,
        )
        return 2
    return 0


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
        command: Command = importlib.import_module(f"posefuse.cli.commands.{name}")  # type: ignore[assignment]
        sub = commands.add_parser(name, help=command.SUMMARY, description=command.SUMMARY)
        sub.add_argument("--json", action="store_true", help="figures as one JSON object on stdout, all else on stderr")
        command.add_arguments(sub)
        sub.set_defaults(command=command, command_name=name)
    return parser


if __name__ == "__main__":
    sys.exit(main())
