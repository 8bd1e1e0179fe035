"""The command line reference, from the commands themselves."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any, Literal, Union, get_args, get_origin

from cyclopts import App, Argument

from posefuse.cli.command_line import COMMANDS, STEPS, application

_FIRST_GROUPS = ("Arguments", "Parameters")


def commands_page() -> str:
    """Markdown: one section per command, with a table of options per group of the help."""
    app = application()
    parts = [
        "# Commands\n",
        "This page is generated from the code and has every option; `posefuse COMMAND --help` shows the usual ones. "
        "`posefuse COMMAND --help-all` lists every one, too. "
        "Options of settings take what the key of the same meaning takes in a settings file. "
        "Every command also takes `--json`: it prints the figures of its tables as one JSON object on stdout, "
        "and everything else on stderr.\n",
        "| exit code | meaning |\n|---|---|\n| 0 | complete |\n| 1 | a known error, stated in one line |\n"
        "| 2 | a bug in posefuse, with its trace |\n| 130, 143 | stopped by Ctrl-C or SIGTERM; finished work is kept |\n",
    ]
    for words in command_words():
        parts.append(_section(words, app))
    return "\n".join(parts)


def command_words() -> Iterator[tuple[str, ...]]:
    """Every command as it is typed, e.g. ``("calibrate", "extrinsics")``."""
    for name in COMMANDS:
        yield from [(name, step) for step in STEPS[name]] if name in STEPS else [(name,)]


def _section(words: tuple[str, ...], app: App) -> str:
    command = app
    for word in words:
        command = command[word]
    shown = [one for one in command.assemble_argument_collection(parse_docstring=True) if one.parse]
    about = (inspect.getdoc(command.default_command) or "").partition("\nArgs:")[0].strip()
    lines = [f"## posefuse {' '.join(words)}\n", f"{about}\n", f"    {_usage(words, shown)}\n"]
    groups: dict[str, list[Argument]] = {}
    for one in shown:
        groups.setdefault(_group(one), []).append(one)
    for name in sorted(groups, key=lambda group: group not in _FIRST_GROUPS):
        title = {"Arguments": "argument", "Parameters": "option"}.get(name, name)
        lines.append(f"| {title} | |\n|---|---|")
        lines += [f"| {_names(one)} | {_meaning(one)} |" for one in groups[name]]
        lines.append("")
    return "\n".join(lines)


def _usage(words: tuple[str, ...], shown: list[Argument]) -> str:
    required = [
        f"{_spelling(one)} {_metavar(one)}".strip() if _is_option(one) else _metavar(one) for one in shown if one.required
    ]
    return " ".join(("posefuse", *words, *required, "[OPTIONS]"))


def _group(one: Argument) -> str:
    groups = one.parameter.group or ()
    return groups[0].name if groups else "Parameters"


def _is_option(one: Argument) -> bool:
    return one.name.startswith("--")


def _spelling(one: Argument) -> str:
    return one.names[0]


def _metavar(one: Argument) -> str:
    if not _is_option(one):
        return str(one.parameter.metavar or one.name)
    return "" if one.hint is bool else str(one.parameter.metavar or ("" if _choices(one.hint) else "VALUE"))


def _names(one: Argument) -> str:
    text = f"{_spelling(one)} {_metavar(one)}".strip() if _is_option(one) else _metavar(one)
    return f"`{text}`".replace("|", "\\|")


def _meaning(one: Argument) -> str:
    parts = [(one.parameter.help or "").strip()]
    choices = _choices(one.hint)
    if choices:
        parts.append("One of " + ", ".join(f"`{choice}`" for choice in choices) + ".")
    default = one.field_info.default
    if one.required:
        parts.append("Required.")
    elif one.show_default and default not in (inspect.Parameter.empty, None, False, "", ()):
        parts.append(f"Default: `{default}`.")
    return " ".join(parts).replace("|", "\\|")


def _choices(hint: Any) -> tuple[str, ...]:
    """The values of a Literal, also inside Optional."""
    if get_origin(hint) is Literal:
        return tuple(str(value) for value in get_args(hint))
    if get_origin(hint) is Union or type(hint).__name__ == "UnionType":
        return next((found for inner in get_args(hint) if (found := _choices(inner))), ())
    return ()
