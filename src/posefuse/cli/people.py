"""``--people N|all``: how many people a command follows."""

from __future__ import annotations

import argparse

# what "all" means: more would not fit into the area that a rig of cameras sees
EVERYBODY = 16


def people_count(text: str) -> int:
    """The value of ``--people``: a whole number, whose range the settings check, or ``all`` for up to 16."""
    if text == "all":
        return EVERYBODY
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a whole number, or all, got {text!r}") from None


def with_places_joined(argv: list[str]) -> list[str]:
    """``--person -1.1,0`` as ``--person=-1.1,0``: a value that begins with a minus sign is no option."""
    joined: list[str] = []
    for word in argv:
        if joined and joined[-1] == "--person" and word[:1] == "-" and word[1:2].isdecimal() | (word[1:2] == "."):
            joined[-1] = f"--person={word}"
        else:
            joined.append(word)
    return joined
