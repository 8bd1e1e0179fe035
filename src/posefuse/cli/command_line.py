"""What the user typed, as a function to call: commands are found by name and imported when they are needed."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import (
    App,
    CycloptsError,
    Group,
    MissingArgumentError,
    Parameter,
    UnknownCommandError,
    UnusedCliTokensError,
    ValidationError,
)
from cyclopts.help import DefaultFormatter

from posefuse import __version__

if TYPE_CHECKING:
    from .terminal import Terminal

# as the help lists them: command -> module of it, or of its steps; a dotted one is of a package that an extra installs
GROUPS = {
    "Start": {"demo": "recorded", "doctor": "machine", "studio": "posefuse_studio.commands"},
    "Record and calibrate": {"record": "calibrate", "calibrate": "calibrate"},
    "Track": {"track": "recorded", "solve": "recorded", "batch": "recorded"},
    "Live": {"live": "live", "teleoperate": "posefuse_teleop.commands", "node": "posefuse_ros.commands"},
    "Look at a result": {"view": "results", "report": "results", "export": "results", "compare": "results"},
    "Simulate and extend": {
        "simulate": "posefuse_sim.commands",
        "models": "machine",
        "fit-noise": "posefuse_sim.commands",
        "plugins": "machine",
    },
}
COMMANDS = tuple(name for names in GROUPS.values() for name in names)
STEPS = {
    "node": ("camera", "fusion"),
    "calibrate": ("intrinsics", "extrinsics", "guide", "person", "clocks", "verify", "print"),
}
_OPTIONS = Group("Options", sort_key=len(GROUPS))


class WrongCommandLineError(Exception):
    """A command line that cannot be understood: one line that names the command, the problem and where to look."""


@dataclass(frozen=True)
class Invocation:
    """One command with its arguments.

    Attributes:
        words: the command, and its step if it has steps. as_json: figures go to stdout as one JSON object.
    """

    words: tuple[str, ...]
    as_json: bool
    command: Callable[..., Mapping[str, Any]]
    bound: inspect.BoundArguments

    @property
    def name(self) -> str:
        """The command as it is typed."""
        return " ".join(("posefuse", *self.words))

    def run(self, terminal: Terminal) -> Mapping[str, Any]:
        """Do the work; returns the figures of the tables."""
        return self.command(*self.bound.args, **self.bound.kwargs, terminal=terminal)


def parse(tokens: Sequence[str]) -> Invocation | None:
    """The command to run; None where help or the version was shown: asked for, or because no command was named.

    Raises:
        WrongCommandLineError: an unknown command or option, a value that is missing or wrong.
    """
    typed = [token for token in tokens if not token.startswith("-")]
    all_options = "--help-all" in tokens
    app = application(listed=not typed or (len(typed) == 1 and typed[0] in STEPS), all_options=all_options)
    words: tuple[str, ...] = ()
    try:
        outer, bound, _ = app.meta.parse_args(list(tokens), exit_on_error=False, print_error=False)
        if outer is not _common:
            outer(*bound.args, **bound.kwargs)
            return None
        rest, as_json = list(bound.args), bool(bound.arguments.get("json", False))
        words = tuple(app.parse_commands(rest)[0])
        if all_options:
            app.help_print(list(words))
            return None
        command, inner, _ = app.parse_args(rest, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        words = words or tuple(word for word in error.command_chain or () if not word.startswith("-"))
        raise WrongCommandLineError(_line(words, _problem(error))) from None
    if getattr(command, "__func__", None) is App.help_print:
        app.help_print(list(words))
        return None
    return Invocation(words, as_json, command, inner)


def _common(
    *tokens: Annotated[str, Parameter(show=False, allow_leading_hyphen=True)],
    json: Annotated[
        bool, Parameter(group=_OPTIONS, help="Print the figures as one JSON object on stdout, all else on stderr.")
    ] = False,
    help_all: Annotated[bool, Parameter(group=_OPTIONS, help="Display this message with every option and exit.")] = False,
) -> None:
    """Options that every command takes, at any position."""


def application(*, listed: bool = False, all_options: bool = False) -> App:
    """All commands; each is imported when it is looked up.

    Args:
        listed: with a line of help each, found without importing it. all_options: their help lists those that are not usual, too.
    """
    app = App(
        name="posefuse",
        help="Several ordinary cameras + AI -> one accurate 3D human skeleton.",
        version=f"posefuse {__version__}",
        version_format="plaintext",
        help_format="plaintext",
        default_parameter=Parameter(negative=(), show_default=_default_text),
    )
    app.meta.default(_common)
    app["--help"].group = app["--version"].group = _OPTIONS
    for order, (title, names) in enumerate(GROUPS.items()):
        group = Group(title, sort_key=order)
        for position, (name, module) in enumerate(names.items()):
            if name in STEPS:
                steps = app.command(_with_steps(name, group, position))
                for step_order, step in enumerate(STEPS[name]):
                    shown = {} if all_options else {"help_formatter": UsualOnly(f"{name} {step}")}
                    _add(steps, module, f"{name}_{step}", listed, name=step, sort_key=step_order, **shown)
            else:
                shown = {} if all_options else {"help_formatter": UsualOnly(name)}
                _add(app, module, name.replace("-", "_"), listed, name=name, group=group, sort_key=position, **shown)
    return app


def _add(app: App, module: str, function: str, listed: bool, **options: Any) -> None:
    dotted = module if "." in module else f"posefuse.cli.{module}"
    package = dotted.partition(".")[0]
    if find_spec(package) is None:
        from .options import without_package

        extra = package.removeprefix("posefuse_")
        app.command(without_package(dotted, extra), **options, help=f"(needs the extra {extra})")
    else:
        about = {"help": _first_line(dotted, function)} if listed else {}
        app.command(f"{dotted}:{function}", **options, **about)


@cache
def _parsed(dotted: str) -> ast.Module:
    package, *names = dotted.split(".")
    spec = find_spec(package)
    [folder] = (spec.submodule_search_locations if spec else None) or [""]
    return ast.parse(Path(folder).joinpath(*names).with_suffix(".py").read_text(encoding="utf-8"))


def _first_line(dotted: str, function: str) -> str:
    """Of the docstring of a command, without importing it."""
    found = (node for node in _parsed(dotted).body if isinstance(node, ast.FunctionDef) and node.name == function)
    return (ast.get_docstring(next(found)) or "").partition("\n")[0]


def _with_steps(name: str, group: Group, position: int) -> App:
    helps = {
        "node": "Run a live session on several machines: `node camera` where the cameras are, `node fusion` anywhere.",
        "calibrate": "Calibrate cameras from a board, a marker object or a person; find clock offsets; verify; print targets.",
    }
    return App(name=name, help=helps[name], group=group, sort_key=position)


def _default_text(value: Any) -> str | None:
    """A default as the help shows it; None where there is nothing to show."""
    return None if value is None or value is False or value in ((), "") else str(value)


def _line(words: Sequence[str], problem: str) -> str:
    command = " ".join(("posefuse", *words))
    return f"{command}: {problem}; see {command} --help"


def _problem(error: CycloptsError) -> str:
    """The problem in one line, with the closest option or choice where there is one."""
    if isinstance(error, ValidationError) and error.argument is not None:
        name = next((token.keyword for token in error.argument.tokens if token.keyword), error.argument.name)
        return f"{name}: {error.exception_message}"
    if isinstance(error, ValidationError):
        return error.exception_message
    if isinstance(error, UnknownCommandError) and error.unused_tokens:
        return _unknown(error.unused_tokens[0], error.command_chain or ())
    if isinstance(error, UnusedCliTokensError) and error.unused_tokens:
        return f"unexpected {error.unused_tokens[0]!r}"
    if type(error) is MissingArgumentError and error.argument is not None:
        return _missing(error)
    return " ".join(str(error).split()).rstrip(".")


def _unknown(word: str, words: Sequence[str]) -> str:
    from difflib import get_close_matches

    names = STEPS[words[0]] if words else COMMANDS
    closest = get_close_matches(word, names, n=1)
    return f"unknown command {word!r}; " + (f"did you mean {closest[0]}?" if closest else f"there are: {', '.join(names)}")


def _missing(error: MissingArgumentError) -> str:
    assert error.argument is not None
    if error.keyword or error.tokens_so_far:
        count = error.argument.token_count()[0]
        return f"{error.keyword or error.argument.name}: expected {'a value' if count == 1 else f'{count} values'}"
    _, _, hint = str(error).partition("Did you mean ")
    return f"missing {error.argument.name}" + (f"; did you mean {hint.rstrip('.')}" if hint else "")


if TYPE_CHECKING:
    from cyclopts.help import HelpPanel

_WRITES = "--out --report --force"
USUAL = {
    "demo": "--out --force",
    "doctor": "",
    "studio": "--host --open",
    "record": "--source --out --rig --duration --resume",
    "calibrate intrinsics": f"--target {_WRITES}",
    "calibrate extrinsics": f"--target --intrinsics --floor-marker --clocks {_WRITES}",
    "calibrate guide": "--target --source --intrinsics --record",
    "calibrate person": f"--intrinsics --height-m --apart --clocks {_WRITES}",
    "calibrate clocks": "--rig --clocks --report --force",
    "calibrate verify": "--rig --target --report --force",
    "calibrate print": "--target --columns --rows --square-mm --marker-mm --ids --cube --page --out --force",
    "track": "--out --force --resume --rig --people --names --start --end --outputs --networks --device --set",
    "solve": "--out --force --exclude --keep-person --start --end --outputs --set",
    "batch": "--out --force --jobs --outputs --networks --set",
    "live": "--source --duration --record --videos --ros --osc --json-udp --output --view --people --networks --set",
    "teleoperate": "--source --duration --hand --deadman --robot --robot-at --elsewhere --box --speed "
    "--limits --view --record --ros --command",
    "node camera": "--source --name --domain --peer",
    "node fusion": "--domain --peer",
    "view": "--session",
    "report": "--out --fit --opensim-model",
    "export": "--out --outputs --session",
    "compare": "--out --no-time --no-space",
    "simulate": "--out --plan --gazebo --force",
    "models": "--check --accept-licence",
    "fit-noise": "--scenes-in",
    "plugins": "",
}
"""Names of the options by command, parted by spaces; `tests/cli/test_options.py` limits their number."""


class UsualOnly(DefaultFormatter):
    """Shows the panels of a command without the options that are not usual."""

    def __init__(self, command: str) -> None:
        super().__init__()
        self._usual = set(USUAL[command].split())

    def __call__(self, console: Any, options: Any, panel: HelpPanel) -> None:
        """Show one panel; one of which nothing is left is not shown."""
        if panel.format == "parameter" and panel.title != "Options":
            panel = panel.copy(entries=[one for one in panel.entries if self._is_usual(one.names)])
        if panel.entries:
            super().__call__(console, options, panel)

    def _is_usual(self, names: tuple[str, ...]) -> bool:
        spelled = {name for name in names if name.startswith("--")}
        return not spelled or bool(spelled & self._usual)
