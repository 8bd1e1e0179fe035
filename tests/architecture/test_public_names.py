"""What is public: the names that the `__init__` of a package imports or defines. The paper's experiments use nothing else."""

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from packages import PACKAGES

ROOT = Path(__file__).resolve().parents[2]


def _of_posefuse(module: str) -> bool:
    return module.split(".")[0] in PACKAGES


def public_names(code: str) -> set[str]:
    """What the `__init__` of a package defines or imports; one that has code imports from outside of it for its own use."""
    tree = ast.parse(code)
    lines = [inner for line in tree.body for inner in (line.body if isinstance(line, ast.If) else [line])]
    has_code = any(isinstance(line, ast.FunctionDef | ast.ClassDef) and not line.name.startswith("_") for line in lines)
    names = {
        one.asname or one.name
        for line in lines
        if isinstance(line, ast.ImportFrom) and line.module and (line.level or (_of_posefuse(line.module) and not has_code))
        for one in line.names
    }
    for line in lines:
        names |= {line.name} if isinstance(line, ast.FunctionDef | ast.ClassDef) else set()
        names |= {target.id for target in getattr(line, "targets", []) if isinstance(target, ast.Name)}
    return {name for name in names if not name.startswith("_") or name == "__version__"} - {"lazy_names"}


OFFERED = {
    ".".join(path.parent.relative_to(folder.parent).parts): names
    for folder in PACKAGES.values()
    for path in sorted(folder.rglob("__init__.py"))
    if (names := public_names(path.read_text(encoding="utf-8")))
}
PAPER = sorted((ROOT / "paper").rglob("*.py"))
# the command line and the browser page are for people, not for programs
FOR_PEOPLE = ("posefuse.cli",)


def private_imports(code: str) -> Iterator[str]:
    """What a program imports from posefuse that is not public."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names if _of_posefuse(one.name) and one.name != "posefuse")
        elif isinstance(node, ast.ImportFrom) and _of_posefuse(node.module or ""):
            module = node.module or ""
            offered = set() if module.startswith(FOR_PEOPLE) else OFFERED.get(module, set())
            yield from (f"{module}.{one.name}" for one in node.names if one.name not in offered)


def test_the_paper_uses_public_names_only() -> None:
    found = {path.relative_to(ROOT).as_posix(): list(private_imports(path.read_text(encoding="utf-8"))) for path in PAPER}
    assert PAPER and {path: names for path, names in found.items() if names} == {}


@pytest.mark.parametrize("package", OFFERED)
def test_every_public_name_is_there_and_is_no_module_of_its_package(package: str) -> None:
    """Python puts a module that was imported into its package, where it would stand in for a name that is imported lazily."""
    module = importlib.import_module(package)
    assert [name for name in OFFERED[package] if not hasattr(module, name)] == []
    folder = Path(str(module.__file__)).parent
    modules = {path.stem for path in folder.glob("*.py")} | {path.name for path in folder.iterdir() if path.is_dir()}
    assert not modules & OFFERED[package] or not hasattr(module, "__getattr__")


def test_the_check_can_fail() -> None:
    assert public_names("from posefuse.core.extras import lazy_names\nfrom .a import b as c\n_d = e = 1\nimport f") == {"c", "e"}
    assert public_names("from posefuse.core import Rig\nfrom .a import b\ndef f(): ...") == {"b", "f"}
    code = "import posefuse\nfrom posefuse import track\nfrom posefuse.core import Rig, frozen\nimport posefuse.core.rig"
    assert list(private_imports(code)) == ["posefuse.core.frozen", "posefuse.core.rig"]
    assert list(private_imports("from posefuse.core.rig import Rig as R")) == ["posefuse.core.rig.Rig"]
    assert list(private_imports("from posefuse.cli.terminal import Terminal")) == ["posefuse.cli.terminal.Terminal"]
