"""No import cycle, inside packages, functions and for type checkers either: what a module imports never leads back to it."""

import ast
from collections.abc import Mapping
from pathlib import Path

from packages import PACKAGES


def graph(*roots: Path) -> dict[str, set[str]]:
    """Module -> modules it imports anywhere; the packages a module lies in are no imports of its own."""
    files = {
        ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__"): path
        for root in roots
        for path in root.rglob("*.py")
    }
    found: dict[str, set[str]] = {}
    for module, path in files.items():
        package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
        names: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {one.name for one in node.names}
            elif isinstance(node, ast.ImportFrom):
                base = package[: len(package) - node.level + 1] if node.level else []
                full = ".".join([*base, *([node.module] if node.module else [])])
                names |= {f"{full}.{one.name}" if f"{full}.{one.name}" in files else full for one in node.names}
        found[module] = {name for name in names if name in files and name != module and not module.startswith(f"{name}.")}
    return found


def cycles(edges: Mapping[str, set[str]]) -> set[str]:
    """Modules that lie on a cycle: what is left when those without imports are taken away, again and again, from both ends."""
    left = set(edges)
    while True:
        gone = {one for one in left if not edges[one] & left or not any(one in edges[other] for other in left)}
        if not gone:
            return left
        left -= gone


def test_no_module_leads_back_to_itself() -> None:
    assert cycles(graph(*(folder.parent for folder in PACKAGES.values()))) == set()


def test_the_check_can_fail(tmp_path: Path) -> None:
    for name, text in {
        "a": "from .b import x",
        "b": "def f():\n    from .c import x",
        "c": "if TYPE_CHECKING:\n    from .a import x",
        "d": "from .a import x",
    }.items():
        (tmp_path / "package").mkdir(exist_ok=True)
        (tmp_path / "package" / f"{name}.py").write_text(text, encoding="utf-8")
    assert cycles(graph(tmp_path)) == {"package.a", "package.b", "package.c"}
