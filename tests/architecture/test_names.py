"""One name, one meaning: a public name of the package is defined in one module, but for the kinds listed here."""

import ast
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

from packages import source_files

FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
# functions of one name in several modules, and why each is one idea
SHARED = {
    "one module per file format": {"fits", "read", "rig_from"},
    "one module per page or job of the studio": {"build", "run"},
    "entry points of processes": {"main"},
    "one value from several kinds of files": {"read_rig"},
    "a command, the Python function and the stage behind it": {
        "batch", "calibrate_clocks", "calibrate_extrinsics", "calibrate_intrinsics", "calibrate_person", "compare", "doctor",
        "fetch_networks", "fit_noise", "live", "models", "plugins", "record", "simulate", "solve", "teleoperate", "track",
        "verify",
    },
    "a compiled kernel and the function that calls it": {"agreement", "solve_robust"},
    "one operation in the second pass and live": {"hold_bones"},
}  # fmt: skip


# where a decision is taken is found by the words that one searches for
DECIDED_IN = {
    "robust loss": "fusion/kernels/point.py",
    "latency bound": "realtime/latency.py",
    "moved camera": "health/rig_monitor.py",
    "left/right correction": "tracking/sides.py",
    "dead-man's switch": "posefuse_teleop/gate.py",
}


def shared_names(files: Iterable[Path], kinds: tuple[type, ...] = (ast.ClassDef,)) -> dict[str, list[str]]:
    """Public names that several files define, with those files; a subclass may have the name of its base."""
    found: dict[str, list[str]] = defaultdict(list)
    for path in files:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, kinds) and not node.name.startswith("_"):
                bases = node.bases if isinstance(node, ast.ClassDef) else ()
                if node.name not in {base.attr if isinstance(base, ast.Attribute) else getattr(base, "id", "") for base in bases}:
                    found[node.name].append(path.name)
    return {name: places for name, places in found.items() if len(places) > 1}


def test_no_two_classes_share_a_name() -> None:
    assert shared_names(source_files()) == {}


def test_functions_share_a_name_only_where_they_share_the_idea() -> None:
    assert set(shared_names(source_files(), FUNCTIONS)) == set().union(*SHARED.values())


def test_a_decision_is_found_by_the_words_for_it() -> None:
    texts = {path.as_posix(): ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "" for path in source_files()}
    found = {words: [path for path, text in texts.items() if words in text.lower()] for words in DECIDED_IN}
    assert not {words for words, place in DECIDED_IN.items() if not any(path.endswith(place) for path in found[words])}
    assert max(map(len, found.values())) <= 6


def test_the_check_can_fail(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("class Rig: ...\nclass Body: ...\nclass _Own: ...\ndef solve(): ...", encoding="utf-8")
    (tmp_path / "b.py").write_text(
        "class Rig(core.Rig): ...\nclass Body: ...\nclass _Own: ...\nasync def solve(): ...", encoding="utf-8"
    )
    assert shared_names([tmp_path / "a.py", tmp_path / "b.py"]) == {"Body": ["a.py", "b.py"]}
    assert shared_names([tmp_path / "a.py", tmp_path / "b.py"], FUNCTIONS) == {"solve": ["a.py", "b.py"]}
