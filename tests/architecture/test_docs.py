"""Docs are run: every Python block executes, commands, messages, links and pages that they name exist, and the site lists all."""

import ast
import functools
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml
from checks import refusal

import posefuse as pf
import posefuse.api.track
from packages import source_files
from posefuse.cli.command_line import WrongCommandLineError, parse
from posefuse.cli.main import COMMANDS
from posefuse.core import ConfigError
from posefuse.foundation import plugins
from posefuse.foundation.plugins import list_plugins
from tools.docs_site.api import GROUPS, api_page
from tools.docs_site.commands import command_words, commands_page
from tools.docs_site.settings import settings_page

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
# streams of Lab Streaming Layer are called `posefuse keypoints` and `posefuse joint angles`
NO_COMMANDS = {"keypoints", "joint"}
CODE = ("src", "packages", "bench", "paper", "tests", "tools", "docs", "examples")
GENERATED = {"reference/api.md", "reference/commands.md", "reference/settings.md"}


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(language: str) -> list[tuple[str, str]]:
    found = []
    for page in PAGES:
        code = re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
        found += [(f"{name_of(page)} block {i + 1}", block) for i, block in enumerate(code)]
    return found


def block_id(value: str) -> str:
    return value if re.fullmatch(r"[\w./]+ block \d+", value) else ""


@functools.cache
def tracked_once(session: str, **arguments: float) -> pf.Recording:
    """Blocks that track the same share the work; a recording never changes."""
    return pf.api.track.track(session, **arguments)


@pytest.mark.parametrize(("name", "code"), blocks("python"), ids=block_id)
def test_python_blocks_run(name: str, code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(pf, "track", tracked_once)
    exec(compile(code, name, "exec"), {"__name__": "docs"})


@pytest.fixture
def my_package(monkeypatch: pytest.MonkeyPatch) -> None:
    """The plug-ins of the page, as if they were installed."""
    height, lamp = (code for name, code in blocks("python") if "plugins.md" in name and "@settings" in code)
    for name, code in {"my_package": "", "my_package.height": height, "my_package.lamp": lamp}.items():
        module = ModuleType(name)
        exec(compile(code, name, "exec"), vars(module))
        monkeypatch.setitem(sys.modules, name, module)
    [file] = [tomllib.loads(code) for name, code in blocks("toml") if "plugins.md" in name]
    for group, entries in file["project"]["entry-points"].items():
        for name, value in entries.items():
            announce(monkeypatch, EntryPoint(name, value, group))
    monkeypatch.chdir(ROOT)


def announce(monkeypatch: pytest.MonkeyPatch, entry: EntryPoint) -> None:
    others = plugins.entry_points
    monkeypatch.setattr(plugins, "entry_points", lambda group: [*others(group=group), *([entry] if entry.group == group else [])])


@pytest.mark.usefixtures("my_package")
def test_the_plugins_of_the_page_pass_their_checks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pf, "track", tracked_once)
    [test] = [code for name, code in blocks("python no-run") if "plugins.md" in name]
    exec(compile(test, "plugins.md", "exec"), {"__name__": "docs"})


@pytest.mark.usefixtures("my_package")
def test_what_a_plugin_cannot_do_is_an_error_before_any_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("posefuse.pipeline.track.detect", lambda *_, **__: pytest.fail("work was done"))
    announce(monkeypatch, EntryPoint("dict", "tests.architecture.test_docs:Useless", "posefuse.detectors"))
    for settings, line in (
        ({"detector.name": "lamp", "outputs.height.keypint": "nose"}, "unknown key 'keypint'; there are: keypoint"),
        ({"detector.name": "dict"}, "dict among detectors: dict lacks skeleton, joint_centres, detect of core.Detector"),
    ):
        refusal(ConfigError, line, pf.track, "examples/demo", out=tmp_path / "out", formats=("height",), settings=settings)
        assert not [*tmp_path.iterdir()]


@dataclass(frozen=True)
class Useless:
    """A plug-in that builds no detector."""

    def build(self) -> dict[str, str]:
        return {}


@pytest.mark.parametrize(("name", "code"), [*blocks("toml"), *blocks("python no-run")], ids=block_id)
def test_blocks_of_settings_and_those_that_need_cameras_can_be_read(name: str, code: str) -> None:
    assert tomllib.loads(code) if (name, code) in blocks("toml") else ast.parse(code)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_named_in_the_docs_exist(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    quoted = " ".join(re.findall(r"`[^`\n]+`|^    .*$", text, re.MULTILINE))
    named = set(re.findall(r"posefuse (?!as\b)([a-z0-9][a-z0-9-]*)\b", quoted)) - NO_COMMANDS
    assert named <= {*COMMANDS}, f"{page.name} names commands that do not exist: {sorted(named - {*COMMANDS})}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_command_lines_are_understood(page: Path) -> None:
    text = re.sub(r"\\\n\s*", "", page.read_text(encoding="utf-8"))
    fenced = "".join(re.findall(r"^```(?:sh)?\n(.*?)^```$", text, re.MULTILINE | re.DOTALL))
    whole = re.findall(r"^    posefuse (.+)$", text, re.MULTILINE) + re.findall(r"^posefuse (.+)$", fenced, re.MULTILINE)
    wrong = {line: problem for line in whole if (problem := problem_of(line))}
    parts = {line: problem_of(line) for line in re.findall(r"`posefuse ([^`\n]+)`", text)}
    wrong |= {line: problem for line, problem in parts.items() if "Unknown option" in problem}
    assert not wrong


def problem_of(line: str) -> str:
    """What is wrong with the words after `posefuse`; empty where nothing is. Dots are a value that is left to the reader."""
    try:
        parse(shlex.split(line, comments=True))
    except WrongCommandLineError as error:
        return str(error)
    return ""


def test_the_check_of_command_lines_can_fail() -> None:
    assert "Unknown option" in problem_of("track SESSION --out RESULT --edit")
    assert "expected N" in problem_of("track SESSION --out RESULT --people all")


def anchors(page: Path) -> set[str]:
    """Names of the headings of a page as the site links them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    plain = [re.sub(r"[`*]|\[([^]]*)\]\([^)]*\)", r"\1", heading) for heading in headings]
    return {re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading.lower()).strip()) for heading in plain}


def dead_links(page: Path) -> list[str]:
    dead = []
    for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)]*))?\)", page.read_text(encoding="utf-8")):
        if target.startswith(("http://", "https://", "mailto:")):
            continue
        path = (page.parent / target).resolve() if target else page
        generated = path.is_relative_to(DOCS) and path.relative_to(DOCS).as_posix() in GENERATED
        unknown = anchor and path.suffix == ".md" and path.exists() and anchor not in anchors(path)
        if unknown or not (generated or path.exists()):
            dead.append(f"{target}#{anchor}" if anchor else target)
    return dead


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_anchors_and_pictures_exist(page: Path) -> None:
    assert not dead_links(page)


def test_the_link_check_can_fail(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Here\n[a](nowhere.md) [b](#here) [c](#there)", encoding="utf-8")
    assert dead_links(page) == ["nowhere.md", "#there"]


def missing_files(page: Path) -> list[str]:
    """Files of Python that a page names by folder and name, and that are nowhere in the repository."""
    named = set(re.findall(r"`([\w.-]+/[\w./-]+\.py)", page.read_text(encoding="utf-8")))
    known = [f"/{path.relative_to(ROOT).as_posix()}" for folder in CODE for path in (ROOT / folder).rglob("*.py")]
    return sorted(name for name in named if not any(path.endswith(f"/{name}") for path in known))


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=name_of)
def test_files_named_in_the_docs_exist(page: Path) -> None:
    assert not missing_files(page)


def test_the_check_of_named_files_can_fail(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("`core/se3.py` `core/se4.py` `bench/live.py --seconds 3`", encoding="utf-8")
    assert missing_files(page) == ["core/se4.py"]


def navigation(entry: Any) -> list[str]:
    if isinstance(entry, str):
        return [entry]
    return [page for inner in (entry.values() if isinstance(entry, dict) else entry) for page in navigation(inner)]


def test_every_page_is_in_the_navigation_once() -> None:
    listed = navigation(yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"])
    assert sorted(listed) == sorted({page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md")} | GENERATED)


def promises(page: Path) -> list[tuple[str, list[str], str]]:
    """Promise, tests and when they run, of every row of the tables."""
    rows = re.findall(r"^\| (?!promise \||---)(.+?) \|(.*)\| (.+?) \|$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return [(promise, re.findall(r"`(\S+?)`", tests), when) for promise, tests, when in rows]


def faults_of_promises(rows: list[tuple[str, list[str], str]], ci: str) -> list[str]:
    """Rows without a test, tests that do not exist, and slow tests that run later than their row states."""
    faults = [f"{promise}: no test" for promise, tests, _ in rows if not tests]
    for test, when in [(test, when) for _, tests, when in rows for test in tests]:
        file, _, name = test.partition("::")
        path = ROOT / "tests" / file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if not (found := re.search(rf"((?:^@.*\n(?:[ )].*\n)*)*)^def {name}\(", text, re.MULTILINE)):
            faults.append(f"{test}: not there")
        elif when == "always" and re.search(r"^@pytest.mark.(slow|fuzz)", found[1], re.MULTILINE):
            faults.append(f"{test}: slow")
        elif when == "CI" and "mark.slow" in found[1] and f"tests/{file}" not in ci:
            faults.append(f"{test}: not among the slow tests of CI")
    return faults


def test_every_promise_has_a_test_and_every_figure_a_promise() -> None:
    rows = promises(DOCS / "promises.md")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert len(rows) > 40 and faults_of_promises(rows, makefile) == []
    measured = (ROOT / "README.md").read_text(encoding="utf-8").partition("## What is measured")[2].partition("##")[0]
    figures = re.findall(r"\| (\d[\d./ ]+) ?[a-z]* \| \[", measured)
    text = " ".join(promise for promise, *_ in rows)
    assert len(figures) == 5 and not [figure for figure in figures if figure.strip() not in text]


def test_the_check_of_promises_can_fail() -> None:
    slow = "api/test_gallery.py::test_calibrate_from_walk"
    rows = [("a", [], "always"), ("b", ["api/test_gallery.py::test_gone"], "CI"), ("c", [slow], "always"), ("d", [slow], "CI")]
    found = faults_of_promises(rows, "")
    assert [fault.rpartition(": ")[2] for fault in found] == ["no test", "not there", "slow", "not among the slow tests of CI"]


def test_references_list_every_command_setting_and_name() -> None:
    commands, settings, api = commands_page(), settings_page(), api_page()
    assert not [words for words in command_words() if f"## posefuse {' '.join(words)}\n" not in commands]
    assert "`--people N`" in commands
    assert not [key for key in ("cutoff_hz", "max_people", "offset_s", "rate_hz") if f"| `{key}` |" not in settings]
    ours = [plugin.name for kind in ("detectors", "outputs", "live_outputs") for plugin in list_plugins(kind) if plugin.config]
    assert not [name for name in ours if f"### `{name}`" not in settings]
    assert all(f"heading: posefuse.{name}\n" in api for _, names in GROUPS for name in names)


def test_every_documented_setting_has_a_meaning() -> None:
    undocumented = re.findall(r"^\| `(\w+)` \|[^|]*\|[^|]*\|\s*\|$", settings_page(), re.MULTILINE)
    assert not undocumented


def test_messages_in_troubleshooting_are_those_of_the_code() -> None:
    page = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    messages = re.findall(r"^\| `([^`]+)` \|", page, re.MULTILINE)
    code = " ".join(path.read_text(encoding="utf-8") for path in source_files())
    plain = re.sub(r"\{[^{}]*\}", "2", re.sub(r'"\s*\n\s*f?"', "", code))
    assert messages
    assert not [text for text in messages if text not in plain]


def test_all_outputs_are_in_the_list_of_files() -> None:
    page = (DOCS / "reference" / "files.md").read_text(encoding="utf-8")
    ours = [plugin.name for plugin in list_plugins("outputs") if plugin.package == "posefuse"]
    assert ours and not [name for name in ours if f"`{name}`" not in page]


def test_the_site_builds_without_a_warning_and_needs_no_other_host(tmp_path: Path) -> None:
    pytest.importorskip("mkdocstrings", reason="needs the extra docs")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    pages = [page.read_text(encoding="utf-8") for page in (tmp_path / "site").rglob("*.html")]
    assert not [page for page in pages if re.search(r'<(?:script|link|img|iframe)[^>]+(?:src|href)="https?://', page)]
