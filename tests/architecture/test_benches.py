"""Benches and tools: each can be imported, what docs and source name of them is there, and fits stay off reported bodies."""

import re
from pathlib import Path

import pytest
from running import printed

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted(path.stem for path in (ROOT / "bench").glob("*.py"))
PAGES = sorted((ROOT / "docs").rglob("*.md"))
# one process imports all; a package that an extra brings may be missing, one of ours may not
IMPORT_ALL = """
import importlib, sys
for name in sys.argv[1:]:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name.partition(".")[0] in ("posefuse", "paper", "bench", "tools", *sys.argv[1:]):
            print(name, error)
    except ImportError as error:
        print(name, error)
"""
NAMED = re.compile(r"(?<![\w/])((?:bench|tools|paper)/(?!test_)[\w/]+\.py)((?: +(?:--?)?[\w./=\"-]+)*)")
MARK = re.compile(r"<!-- ([^:>]+): begin -->")
# a command, the commit until which the repository had one, or a plain statement that there is none
SOURCE = re.compile(
    r"(?:bench|tools|paper|fuzz)/[\w/]+\.py|python -m paper|`make [a-z-]+`"
    r"|until\s+commit [0-9a-f]{8}|without a command in the repository"
)


def problems(folder: Path, scripts: list[str]) -> str:
    place = f"import sys; sys.path[:0] = [{str(folder)!r}, {str(ROOT)!r}]\n"
    return printed("-c", place + IMPORT_ALL, *scripts, limit_s=300)


def with_imports(script: Path) -> str:
    """The text of a script and of the modules next to it that it imports; options of `arguments` as they are typed."""
    text = script.read_text(encoding="utf-8")
    neighbours = [script.with_name(f"{name}.py") for name in re.findall(r"^\s*(?:from|import) (\w+)", text, re.MULTILINE)]
    whole = text + "".join(path.read_text(encoding="utf-8") for path in neighbours if path.is_file())
    return whole + "".join(f" --{name.replace('_', '-')}" for name in re.findall(r"(\w+)=", whole)) + " --write"


def wrong_names(text: str) -> list[str]:
    """Scripts that do not exist, and options that a script does not have."""
    wrong = []
    for path, words in NAMED.findall(text):
        if (ROOT / "tests" / path).is_file():
            continue
        if not (ROOT / path).is_file():
            wrong.append(path)
            continue
        options = re.findall(r"--[a-z][\w-]*", words)
        wrong += [f"{path} {option}" for option in options if option not in with_imports(ROOT / path)]
    return wrong


def writer_of(mark: str) -> list[Path]:
    """Scripts that write the table of a mark: those that have its name, or are called so."""
    folders = (ROOT / "bench", ROOT / "tools", ROOT / "tests" / "fuzz")
    scripts = [path for folder in folders for path in folder.glob("*.py")]
    return [path for path in scripts if path.stem == mark or f'"{mark}"' in path.read_text(encoding="utf-8")]


def test_every_script_finds_what_it_imports() -> None:
    assert len(SCRIPTS) > 25
    assert problems(ROOT / "bench", SCRIPTS) == ""


def test_the_check_can_fail(tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text("from two import gone\n")
    (tmp_path / "two.py").write_text("import posefuse.nowhere\n")
    (tmp_path / "three.py").write_text("from posefuse.core import gone\n")
    found = problems(tmp_path, ["one", "two", "three"])
    assert "No module named 'posefuse.nowhere'" in found and "three cannot import name 'gone'" in found


@pytest.mark.parametrize("place", ["docs", "src", "examples", ".github", ".ci", "Makefile", "README.md", "CONTRIBUTING.md"])
def test_scripts_that_are_named_exist_with_their_options(place: str) -> None:
    texts = (".md", ".py", ".toml", ".yaml", ".yml", ".js", "")
    files = [path for path in (ROOT / place, *(ROOT / place).rglob("*")) if path.is_file() and path.suffix in texts]
    assert files
    assert {str(path.relative_to(ROOT)): wrong for path in files if (wrong := wrong_names(path.read_text("utf-8")))} == {}


def test_a_wrong_script_and_a_wrong_option_are_seen() -> None:
    text = "`python bench/gone.py`, `python bench/fuse.py --repeat 9 --turns 2`, `bench/live.py --only 8 --write docs/x.md`"
    assert wrong_names(text) == ["bench/gone.py", "bench/fuse.py --turns"]


def missing_tests(text: str) -> list[str]:
    """Tests that a script or the Makefile names, and that do not exist."""
    return [name for name in re.findall(r"(?<![\w/])tests/[\w/]+\.py", text) if not (ROOT / name).is_file()]


def test_tests_that_scripts_and_the_makefile_name_exist() -> None:
    files = [*(ROOT / "bench").glob("*.py"), *(ROOT / "tools").glob("*"), ROOT / "Makefile"]
    named = {path.name: missing_tests(path.read_text(encoding="utf-8")) for path in files if path.is_file()}
    assert {name: missing for name, missing in named.items() if missing} == {}
    assert missing_tests('"tests/fusion/test_gone.py", "tests/architecture/test_benches.py"') == ["tests/fusion/test_gone.py"]


def test_every_table_between_marks_has_a_script_that_writes_it() -> None:
    marks = {(page.name, mark) for page in PAGES for mark in MARK.findall(page.read_text(encoding="utf-8"))}
    assert len(marks) >= 5
    assert [mark for mark in sorted(marks) if not writer_of(mark[1])] == []
    parts = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8").split("\n## ")[1:]
    assert len(parts) >= 9 and [part.partition("\n")[0] for part in parts if not MARK.search(part)] == []
    assert writer_of("a table that no script writes") == []


def tables_without_source(text: str) -> list[str]:
    """First lines of tables of measured figures whose section names neither a command nor the commit that still had one."""
    found = []
    for section in re.split(r"^(?=#{1,6} )", text, flags=re.MULTILINE):
        for table in re.findall(r"(?:^\|.*\n)+", section, re.MULTILINE):
            cells = [cell.strip() for line in table.splitlines()[2:] for cell in line.strip("|").split("|")[1:]]
            measured = [cell for cell in cells if re.match(r"[-~<]?\d+\.\d", cell)]
            if len(measured) > 0.3 * len(cells) and not SOURCE.search(section):
                found.append(table.partition("\n")[0])
    return found


def test_every_table_of_figures_names_the_command_that_makes_it() -> None:
    # limits of a robot are settings, which are not measured
    settings = "| limit | default |"
    wrong = {page.name: tables_without_source(page.read_text(encoding="utf-8")) for page in PAGES}
    assert {page: lines for page, lines in wrong.items() if set(lines) - {settings}} == {}


def test_a_table_without_a_command_is_seen() -> None:
    table = "\n| a | b |\n|---|---|\n| x | 1.5 |\n"
    assert tables_without_source(f"## One\n`python bench/fuse.py`\n{table}## Two\n{table}") == ["| a | b |"]
    assert tables_without_source("## Two\n\n| a | b |\n|---|---|\n| x | often |\n") == []


def test_a_fit_takes_no_body_that_is_reported_and_a_report_none_that_was_fitted() -> None:
    code = """
from harness import Use, checked
from paper.scenes.scenes import walking_scene
for seed, use in ((9400, Use.FIT), (7300, Use.REPORT), (7300, Use.FIT), (9400, Use.REPORT), (7300, Use.DEVELOP)):
    try:
        checked(walking_scene(seed), use)
        print("taken")
    except SystemExit as error:
        print(error)
"""
    place = f"import sys; sys.path[:0] = [{str(ROOT / 'bench')!r}]\n"
    said = printed("-c", place + code, limit_s=300).splitlines()
    assert said[0].startswith("body 9400 is not for a fit") and said[1].startswith("body 7300 is not for a report")
    assert said[2:] == ["taken"] * 3
