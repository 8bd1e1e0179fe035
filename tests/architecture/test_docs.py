"""Docs are run: every Python block of the README and the docs executes, every command they name exists."""

import re
from pathlib import Path

import pytest

from posefuse.cli.main import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def python_blocks() -> list[tuple[str, str]]:
    found = []
    for page in PAGES:
        blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
        found += [(f"{page.name} block {i + 1}", block) for i, block in enumerate(blocks)]
    return found


@pytest.mark.parametrize(("name", "code"), python_blocks(), ids=lambda value: value if "block" in value[:40] else "")
def test_python_blocks_run(name: str, code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    exec(compile(code, name, "exec"), {"__name__": "docs"})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_named_in_the_docs_exist(page: Path) -> None:
    quoted = " ".join(re.findall(r"`[^`]+`|^    .*$", page.read_text(encoding="utf-8"), re.MULTILINE))
    named = set(re.findall(r"posefuse (?!as\b)([a-z0-9][a-z0-9-]*)\b", quoted))
    assert named <= {*COMMANDS}, f"{page.name} names commands that do not exist: {sorted(named - {*COMMANDS})}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_pictures_exist(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8"))
    missing = [target for target in targets if not target.startswith("http") and not (page.parent / target).exists()]
    assert not missing
