"""What is published: one version, metadata that agree, and every file that they name."""

import ast
import re
import sys
import tomllib
from importlib.metadata import Distribution, PackageNotFoundError, distribution, packages_distributions
from pathlib import Path

import yaml
from packaging.requirements import Requirement

import posefuse
from posefuse.api.machine import EXTRAS

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
OPTIONAL = PROJECT["project"]["optional-dependencies"]
MEMBERS = {
    path.parent.name: tomllib.loads(path.read_text(encoding="utf-8"))["project"]
    for path in sorted(ROOT.glob("packages/*/pyproject.toml"))
}
PERMISSIVE = re.compile(r"\b(MIT|0?BSD|Apache|PSF|Python Software Foundation|Zlib|CC0|ISC|Unlicense)\b")
COPYLEFT = re.compile(r"GPL|MPL|EUPL|CDDL|GNU|Mozilla|proprietary|non-?commercial", re.IGNORECASE)
# its metadata name none; its LICENSE file is that of MIT
LICENCES = {"ezc3d": "MIT"}
# packages by the modules that are called otherwise
MODULES = {"collada": "pycollada", "cv2": "opencv-python-headless", "rerun": "rerun-sdk"}


def test_the_version_is_written_once_and_cited() -> None:
    assert PROJECT["project"]["dynamic"] == ["version"] and "version" not in PROJECT["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    for name, member in MEMBERS.items():
        assert member["version"] == posefuse.__version__ and f"posefuse=={posefuse.__version__}" in member["dependencies"]
        assert OPTIONAL[name.removeprefix("posefuse-")] == [f"{name}=={posefuse.__version__}"]
    assert citation["version"] == posefuse.__version__
    assert f"## {posefuse.__version__}" in (ROOT / "docs" / "releases.md").read_text(encoding="utf-8")


def test_the_paper_whose_method_this_is_is_cited() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    [paper] = citation["references"]
    assert [author["family-names"] for author in paper["authors"]] == ["Fortini", "Leonori", "Gandarias", "Momi", "Ajoudani"]


def test_licence_files_and_files_of_the_wheel_exist() -> None:
    included = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert not [name for name in [*PROJECT["project"]["license-files"], *included] if not (ROOT / name).exists()]


def pages() -> list[Path]:
    patterns = ("*.md", "*.cff", "*.yml", "pyproject.toml", "docs/**/*.md", "src/**/*.py", "packages/**/*.py", "packages/**/*.md")
    return [path for pattern in patterns for path in ROOT.glob(pattern)]


def test_no_placeholder_of_an_address_is_shown() -> None:
    assert not [path for path in pages() if re.search(r"https?://example\.", path.read_text(encoding="utf-8"))]


def test_until_it_is_published_no_page_begins_with_the_package_index() -> None:
    """The line that would fail is no command of a page; "once it is published" may name it."""
    assert "urls" not in PROJECT["project"], (
        "published: delete this test, and let README and installing.md begin with pip install posefuse"
    )
    command = re.compile(r"^    pip (install|download) posefuse\b", re.MULTILINE)
    assert not [path for path in pages() if command.search(path.read_text(encoding="utf-8"))]
    assert re.search(r"^    make demo ", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)


def test_the_readme_fits_on_two_screens_and_the_architecture_on_three() -> None:
    for page, screens in (("README.md", 2), ("docs/architecture.md", 3)):
        assert len((ROOT / page).read_text(encoding="utf-8").splitlines()) <= 40 * screens
    assert (ROOT / "docs" / "images" / "demo.webp").stat().st_size < 2_000_000


def test_doctor_lists_every_extra_of_a_user() -> None:
    assert {*EXTRAS, "dev", "docs", "mutation", "publish"} == set(PROJECT["project"]["optional-dependencies"])


def test_every_extra_is_in_the_guide() -> None:
    guide = (ROOT / "docs" / "installing.md").read_text(encoding="utf-8")
    assert not [name for name in EXTRAS if f"`{name}`" not in guide]


def test_ci_installs_every_package_without_which_tests_are_skipped() -> None:
    texts = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("*.py")]
    modules = {name for text in texts for name in re.findall(r'importorskip\("(\w+)', text)}
    # modules of ours and of Python
    wanted = {MODULES.get(name, name) for name in modules - {"discs", "graphs", "fcntl", "pty"}}
    extras = re.search(r"^export EXTRAS=(.+)$", (ROOT / ".ci" / "run").read_text(encoding="utf-8"), re.MULTILINE)[1].split(",")
    required = [PROJECT["project"]["dependencies"], *(OPTIONAL[one] for one in extras)]
    required += [member["dependencies"] for name, member in MEMBERS.items() if name.removeprefix("posefuse-") in extras]
    named = [line for lines in required for line in lines]
    assert wanted - {re.split(r"[\[<>=]", line)[0] for line in named} == set() and len(wanted) > 5


def plain(name: str) -> str:
    """A package's name as the index writes it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def packages_of(lines: list[str]) -> set[str]:
    """The packages that these requirements name and those that they need, as far as they are installed."""
    known: set[str] = set()
    left = [Requirement(line) for line in lines]
    while left:
        one = left.pop()
        name = plain(one.name)
        if name in known or (one.marker and not any(one.marker.evaluate({"extra": extra}) for extra in ("", *one.extras))):
            continue
        known.add(name)
        try:
            left += map(Requirement, distribution(name).requires or [])
        except PackageNotFoundError:
            continue
    return known


def imported_at_once(source: str) -> set[str]:
    """Modules of others whose absence keeps a test file from being collected: neither skipped by name nor inside `try`."""
    found: set[str] = set()
    skipped: set[str] = set()
    for node in ast.parse(source).body:
        skipped.update(re.findall(r'importorskip\("(\w+)', ast.unparse(node).replace("'", '"')))
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names} - skipped
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {node.module.partition(".")[0]} - skipped
    return found - set(sys.stdlib_module_names)


def missing_without_extras(sources: dict[str, str]) -> dict[str, list[str]]:
    """Modules by file that are neither ours nor of the core or the extra `dev`."""
    ours = {"posefuse", "bench", "paper", "tools", *(name.replace("-", "_") for name in MEMBERS)}
    ours |= {path.stem for path in (ROOT / "tests").rglob("*.py")}
    there = packages_of([*PROJECT["project"]["dependencies"], *OPTIONAL["dev"]])
    known = {module for module, names in packages_distributions().items() if there & {plain(name) for name in names}}
    wrong = {file: sorted(imported_at_once(source) - ours - known) for file, source in sources.items()}
    return {file: modules for file, modules in wrong.items() if modules}


def test_every_test_file_is_collected_without_extras() -> None:
    """`make test` in a fresh clone installs `dev` alone: a file that needs more skips by name, it does not end the run."""
    collected = [path for pattern in ("test_*.py", "conftest.py", "support/*.py") for path in (ROOT / "tests").rglob(pattern)]
    sources = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in collected}
    assert len(sources) > 100 and missing_without_extras(sources) == {}


def test_the_check_of_collection_can_fail() -> None:
    sources = {
        "a": "import rerun.chunk\nfrom rosbags import one",
        "b": 'import pytest\nreader = pytest.importorskip("rerun.chunk")\nfrom rerun import x',
        "c": "def test() -> None:\n    import rerun\n",
        "d": "try:\n    import rerun\nexcept ImportError:\n    pass\nimport numpy, cv2, yaml, packaging",
    }
    assert missing_without_extras(sources) == {"a": ["rerun", "rosbags"]}


def licence_of(package: Distribution) -> str:
    about = package.metadata
    classified = [line for line in about.get_all("Classifier") or [] if line.startswith("License ::")]
    return LICENCES.get(package.name) or about.get("License-Expression") or " ".join(classified) or about.get("License") or ""


def refused(licences: dict[str, str]) -> dict[str, str]:
    return {name: text for name, text in licences.items() if not PERMISSIVE.search(text) or COPYLEFT.search(text)}


def test_licences_of_the_core_are_permissive() -> None:
    licences = {name: licence_of(distribution(name)) for name in packages_of(["posefuse"])}
    assert len(licences) > 15 and refused(licences) == {}


def test_the_check_of_licences_can_fail() -> None:
    assert set(refused({"a": "LGPL-3.0", "b": "", "c": "MIT AND GPL-2.0-only", "d": "BSD-3-Clause AND 0BSD"})) == {"a", "b", "c"}


def test_every_folder_of_tests_belongs_to_one_part() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    named = sorted(name for line in re.findall(r"^PART_\w+ *:= (.+)$", makefile, re.MULTILINE) for name in line.split())
    # what the parts share, what checks all of them, and what `make fuzz` runs
    others = {"architecture", "contracts", "fuzz", "support"} - {*named}
    folders = {path.parent.relative_to(ROOT / "tests").parts[0] for path in (ROOT / "tests").glob("*/**/*.py")}
    assert named == sorted(folders - others)


def test_no_job_of_every_change_takes_the_damaged_files() -> None:
    """An expression of markers on the command line replaces the one of pyproject.toml."""
    workflow = (ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    assert [chosen for chosen in re.findall(r'-m "([^"]+)"', workflow) if "not fuzz" not in chosen] == []
    assert all("not fuzz" in chosen for chosen in PROJECT["tool"]["pytest"]["ini_options"]["addopts"].split("-m ")[1:])
