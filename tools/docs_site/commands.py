"""The command line reference, from the commands themselves."""

from __future__ import annotations

from collections.abc import Iterator

from posefuse.cli.command_line import COMMANDS, STEPS, application

_ABOUT = """# Commands

This page is generated from the code and has every option; `posefuse COMMAND --help` shows the usual ones. `posefuse COMMAND
--help-all` lists every one, too. Options of settings take what the key of the same meaning takes in a settings file. Every
command also takes `--json`: it prints the figures of its tables as one JSON object on stdout, and everything else on stderr.

| exit code | meaning |
|---|---|
| 0 | complete |
| 1 | a known error, stated in one line |
| 2 | a bug in posefuse, with its trace |
| 130, 143 | stopped by Ctrl-C or SIGTERM; finished work is kept |
"""


def commands_page() -> str:
    """Markdown: one section per command, with its options per group of the help, as cyclopts writes them."""
    app = application()
    for name in STEPS:
        # else a switch of a step would be listed with a `--no-` that it does not have
        app[name].default_parameter = app.default_parameter
    _, contents, sections = app.generate_docs(output_format="markdown").partition("## Table of Contents")
    return f"{_ABOUT}\n{contents}{sections}"


def command_words() -> Iterator[tuple[str, ...]]:
    """Every command as it is typed, e.g. ``("calibrate", "extrinsics")``."""
    for name in COMMANDS:
        yield from [(name, step) for step in STEPS[name]] if name in STEPS else [(name,)]
