"""The glossary of CONTRIBUTING.md holds: its left column is in no comment, docstring, message or page."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

from packages import shown, source_files

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("src", "packages", "bench", "paper", "examples", "tools")
SPOKEN = {tokenize.COMMENT, tokenize.STRING, *({tokenize.FSTRING_MIDDLE} if hasattr(tokenize, "FSTRING_MIDDLE") else ())}


def refused() -> list[str]:
    table = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("| not | but |")[2]
    rows = re.findall(r"^\| ([^|]+) \| [^|]+ \|$", table, re.MULTILINE)
    return [term.strip() for row in rows for term in row.split(",")]


PATTERN = re.compile(r"(?<!/)\b(" + "|".join(map(re.escape, refused())) + r")\b", re.IGNORECASE)


def spoken(code: str) -> Iterator[tuple[int, str]]:
    """Comments and texts of a program with their lines; single words are names of fields and keys."""
    for token in tokenize.generate_tokens(io.StringIO(code).readline):
        if token.type in SPOKEN and (token.type == tokenize.COMMENT or re.search(r"\w\W+\w", token.string.strip("frb\"'"))):
            yield token.start[0], token.string


def found_in(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8")
    parts = spoken(text) if path.suffix == ".py" else enumerate(prose(text).splitlines(), start=1)
    said = [(line, re.sub(r"`[^`\n]*`|\{[^{}]*\}", "", part)) for line, part in parts]
    return [f"line {line}: {match.group()!r}" for line, part in said for match in PATTERN.finditer(part)]


def prose(page: str) -> str:
    """A page with its blocks of code and of printed tables emptied; line numbers stay."""
    return re.sub(r"^```.*?^```$", lambda block: "\n" * block.group().count("\n"), page, flags=re.MULTILINE | re.DOTALL)


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
CODE = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]


def test_standard_terms_are_used() -> None:
    found = {path.relative_to(ROOT).as_posix(): found_in(path) for path in [*PAGES, *CODE]}
    assert {path: terms for path, terms in found.items() if terms} == {}


def odd_names(code: str) -> list[str]:
    """Test functions whose names have a refused term."""
    return [name for name in re.findall(r"^ *def (test_\w+)\(", code, re.MULTILINE) if PATTERN.search(name.replace("_", " "))]


def test_tests_are_named_in_standard_terms() -> None:
    files = sorted((ROOT / "tests").rglob("test_*.py"))
    found = {path.relative_to(ROOT).as_posix(): odd_names(path.read_text(encoding="utf-8")) for path in files}
    assert {path: names for path, names in found.items() if names} == {}


def test_the_check_of_names_can_fail() -> None:
    code = "def test_nobody_is_there(rig): ...\ndef test_an_instantaneous_step(): ...\ndef test_every_instant(): ..."
    assert odd_names(code) == ["test_nobody_is_there", "test_every_instant"]


def test_the_check_can_fail(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text('"""Nobody is there."""\nfilm = 1  # at every instant\nkey = "film"\n', encoding="utf-8")
    assert found_in(tmp_path / "a.py") == ["line 1: 'Nobody'", "line 2: 'instant'"]
    (tmp_path / "a.md").write_text("The camera was\nbumped, see `bumped`.", encoding="utf-8")
    assert found_in(tmp_path / "a.md") == ["line 2: 'bumped'"]


# texts about other programs' options, and about options that exist in the shell alone
_OTHER_OPTIONS = (
    "posefuse/cli/*", "posefuse_studio/*", "posefuse_teleop/*", "posefuse_sim/gazebo/*", "posefuse_sim/commands.py",
    "posefuse/detection/download.py", "posefuse_ros/ros1.py", "posefuse/outputs/rerun.py",
    "posefuse/calibration/targets/kinds.py",
)  # fmt: skip


def test_the_library_names_arguments_of_python() -> None:
    """`cli.terminal.in_options` makes options of them; whole commands (`posefuse track ... --out DIR`) may stand in any text."""
    found = []
    for path in source_files():
        name = Path(shown(path))
        if any(name.match(pattern) or name.is_relative_to(pattern.removesuffix("/*")) for pattern in _OTHER_OPTIONS):
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
                text = re.sub(r"`?posefuse [a-z][^`]*|dask worker.*|--set .*", "", node.value)
                if re.search(r"(^|[\s(])--[a-z]", text):
                    found.append(f"{name}:{node.lineno}: {node.value[:80]}")
    assert found == []
