"""One name, one meaning: no two classes of the package share a name, but for the front door's own kind of a core value."""

import ast
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

SRC = Path(__file__).resolve().parents[2] / "src" / "posefuse"


def shared_names(files: Iterable[Path]) -> dict[str, list[str]]:
    """Names of public classes that stand in several files, with those files; a subclass may have the name of its base."""
    found: dict[str, list[str]] = defaultdict(list)
    for path in files:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                bases = {base.attr if isinstance(base, ast.Attribute) else getattr(base, "id", "") for base in node.bases}
                if node.name not in bases:
                    found[node.name].append(path.name)
    return {name: places for name, places in found.items() if len(places) > 1}


def test_no_two_classes_share_a_name() -> None:
    assert shared_names(sorted(SRC.rglob("*.py"))) == {}


def test_the_check_can_fail(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("class Rig: ...\nclass Body: ...\nclass _Own: ...", encoding="utf-8")
    (tmp_path / "b.py").write_text("class Rig(core.Rig): ...\nclass Body: ...\nclass _Own: ...", encoding="utf-8")
    assert shared_names([tmp_path / "a.py", tmp_path / "b.py"]) == {"Body": ["a.py", "b.py"]}
