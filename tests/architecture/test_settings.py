"""Few enough settings: each needs a person who changes it; what no one changes is a constant with its source."""

import ast
from pathlib import Path

from packages import source_files

MOST_FIELDS = 220
# files that describe a network or a scene, not how posefuse works: their classes are document formats
DOCUMENTS = ("card.py", "download.py", "noise.py", "joint_centres.py")


def fields_of_settings(source: str) -> list[str]:
    """CLASS.FIELD of every class with the decorator `settings`."""
    classes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ClassDef)]
    made = [one for one in classes if any(ast.unparse(mark).partition("(")[0] == "settings" for mark in one.decorator_list)]
    fields = [(one.name, line) for one in made for line in one.body if isinstance(line, ast.AnnAssign)]
    return [f"{name}.{line.target.id}" for name, line in fields if "ClassVar" not in ast.unparse(line.annotation)]


def is_document(path: Path) -> bool:
    return path.name in DOCUMENTS or "posefuse_sim" in path.parts


def test_there_are_few_enough_settings() -> None:
    by_file = {path: fields_of_settings(path.read_text(encoding="utf-8")) for path in source_files() if not is_document(path)}
    assert 100 < sum(map(len, by_file.values())) <= MOST_FIELDS


def test_the_count_of_settings_can_fail() -> None:
    source = "@settings\nclass A:\n    a: int = 1\n    b: ClassVar[str] = ''\n@settings(x=1)\nclass B:\n    c: int"
    source += "\nclass C:\n    d: int"
    assert fields_of_settings(source) == ["A.a", "B.c"]
