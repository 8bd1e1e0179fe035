"""The command line: one module per command; nothing heavy is imported before a command runs."""

from __future__ import annotations

import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from posefuse import __version__

from .command_line import COMMANDS, Invocation, WrongCommandLineError, parse
from .stopping import terminate_on_signals

if TYPE_CHECKING:
    from .terminal import Terminal

__all__ = ["COMMANDS", "main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `posefuse`.

    Returns:
        0 complete, 1 a known error in one line, 2 a bug with its trace, 130 stopped by Ctrl-C, 143 by SIGTERM, 129 by SIGHUP.
    """
    name = "posefuse"
    with terminate_on_signals() as requests:
        try:
            invocation = parse(sys.argv[1:] if argv is None else argv)
            if invocation is None:
                return 0
            name = invocation.name
            return _run(invocation)
        except WrongCommandLineError as error:
            print(error, file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            print(f"{name}: stopped by {requests.cause}", file=sys.stderr)
            return requests.exit_code
        except BrokenPipeError:
            return 0
        except Exception:  # noqa: BLE001 - the one place where a bug ends the program
            traceback.print_exc()
            print(f"{name}: this is a bug in posefuse {__version__}; please report the lines above", file=sys.stderr)
            return 2


def _run(invocation: Invocation) -> int:
    """The exit code of a command; raises what is no known error."""
    # imports numpy and more: Ctrl-C meanwhile is one line, too
    from posefuse.core import PosefuseError
    from posefuse.foundation.output_file import is_disk_full

    try:
        return _command(invocation)
    except PosefuseError as error:
        from .terminal import in_options

        # messages that name what was asked for do not name it twice
        reason = str(error).removeprefix(f"{invocation.name.split()[-1]}: ")
        print(in_options("\n".join((f"{invocation.name}: {reason}", *getattr(error, "__notes__", ())))), file=sys.stderr)
    except OSError as error:
        full = is_disk_full(error)
        if not full and not isinstance(error, PermissionError):
            raise
        what = f"{error.filename or 'the output'}: cannot be {'written' if full else 'opened'} ({error.strerror})"
        print(f"{invocation.name}: {what}", file=sys.stderr)
    return 1


def _command(invocation: Invocation) -> int:
    """Run the command and show its figures; its exit code."""
    from .terminal import Terminal

    terminal = Terminal(as_json=invocation.as_json)
    with warnings.catch_warnings():
        # problems that do not stop the work, each time they come up
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = _shown_by(terminal)
        figures = invocation.run(terminal)
    steps = {"step": invocation.words[1]} if len(invocation.words) > 1 else {}
    terminal.figures({"command": invocation.words[0], "version": __version__, **steps, **figures})
    return int(figures.get("exit_code", 1 if figures.get("failed") else 0))


def _shown_by(terminal: Terminal) -> Callable[..., None]:
    """What shows warnings: those of posefuse as lines, others as Python does."""
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
        if category is UserWarning:
            terminal.warn(str(message))
        else:
            usual(message, category, *rest, **more)

    return show


if __name__ == "__main__":
    sys.exit(main())
