"""The tree is the architecture: rooms import downwards only, and heavy packages only where they are used."""

import ast
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from commands import as_options, oracle
from running import printed, python

from packages import PACKAGES, shown

SRC = PACKAGES["posefuse"]
# the rooms of the core, bottom to top
LINES = (
    ("core",),
    ("foundation",),
    ("formats",),
    ("sources", "detection", "association", "fusion", "tracking", "kinematics", "outputs"),
    ("calibration", "evaluation"),
    ("health",),
    ("realtime", "pipeline"),
    ("api",),
    ("cli",),
)
# what the packages that extras install may import of this repository; the studio has a page about scenes
MEMBERS = {
    "posefuse_ros": set(),
    "posefuse_sim": set(),
    "posefuse_studio": {"posefuse_sim"},
    "posefuse_teleop": {"posefuse_ros"},
}
LEVEL = {room: level for level, rooms in enumerate(LINES) for room in rooms}
DATA = ("pandas", "matplotlib")
OPTIONAL = (
    "mujoco", "daqp", "rerun", "opensim", "rosbags", "mcap", "cyclonedds", "rospy", "pylsl", "nicegui", *DATA,
)  # fmt: skip
SLOW = ("cv2", "numba", "openvino", "scipy", "ezc3d", "jinja2")


# the command line and the pages: they parse, call public functions, and show what these give
HANDLES = {"cli": SRC / "cli", "studio": PACKAGES["posefuse_studio"]}
# rooms whose modules they may import
FOR_HANDLES = {"core", "foundation", "api", "cli"}
# what else they import; it may only get shorter
BESIDES_API = {
    # settings classes and names of networks, from which options and fields are made
    "posefuse.calibration.settings": {"cli", "studio"},
    "posefuse.detection": {"cli", "studio"},
    "posefuse.pipeline.config": {"cli"},
    "posefuse.realtime.config": {"cli"},
    # values that public functions take, give and raise, as types
    "posefuse.calibration.report": {"cli", "studio"},
    "posefuse.calibration.targets.coverage": {"cli", "studio"},
    "posefuse.calibration.targets.kinds": {"studio"},
    "posefuse.realtime.watching": {"studio"},
    # colours of people and JPEG
    "posefuse.outputs.drawing": {"studio"},
    # the files that an argument stands for, which no output may overwrite
    "posefuse.calibration.targets.recordings": {"cli"},
}


def room_of(path: Path) -> str:
    return path.relative_to(SRC).parts[0]


def imports(path: Path, root: Path | None = None) -> Iterator[tuple[str, str]]:
    """Module and name of what a file imports anywhere, relative imports resolved; `root`: the folder its packages are in."""
    package = [*path.parent.relative_to(root).parts] if root else shown(path).split("/")[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield from ((module, f"{module}.{alias.name}") for alias in node.names)


def imported_names(path: Path) -> set[str]:
    """Absolute dotted names."""
    return {name for pair in imports(path) for name in pair}


def forbidden(room: str, names: set[str]) -> set[str]:
    rooms = {name.split(".")[1] for name in names if name.startswith("posefuse.")} & set(LEVEL)
    return {other for other in rooms if other != room and LEVEL[other] >= LEVEL[room]}


FILES = sorted(path for path in SRC.rglob("*.py") if len(path.relative_to(SRC).parts) > 1)


def test_every_room_is_known() -> None:
    assert {p.name for p in SRC.iterdir() if p.is_dir() and p.name != "__pycache__"} == set(LEVEL)


def test_imports_go_down_only() -> None:
    found = {str(path.relative_to(SRC)): forbidden(room_of(path), imported_names(path)) for path in FILES}
    assert FILES and {path: rooms for path, rooms in found.items() if rooms} == {}


def of_members(names: set[str]) -> set[str]:
    return {name.partition(".")[0] for name in names} & set(MEMBERS)


def test_the_core_imports_no_package_of_an_extra() -> None:
    """But for the front door, which names their functions for type checkers."""
    found = {shown(path): of_members(imported_names(path)) for path in FILES}
    assert {path: names for path, names in found.items() if names} == {}
    assert set(PACKAGES) == {"posefuse", *MEMBERS}


def test_packages_of_extras_import_the_core_and_what_is_said_here() -> None:
    for package, allowed in MEMBERS.items():
        found = {shown(path): of_members(imported_names(path)) - {package} for path in PACKAGES[package].rglob("*.py")}
        assert found and {path: names for path, names in found.items() if names - allowed} == {}


# what makes a program of an installation without the packages of extras
WITHOUT_PACKAGES = (
    "import sys, importlib.metadata as m, importlib.util as u\n"
    "found, entries = u.find_spec, m.entry_points\n"
    "u.find_spec = lambda name, *rest: None if name.startswith('posefuse_') else found(name, *rest)\n"
    "m.entry_points = lambda **of: m.EntryPoints(one for one in entries(**of) if not one.value.startswith('posefuse_'))\n"
    f"sys.modules.update(dict.fromkeys({sorted(MEMBERS)}))\n"
)
DEMO_RIG = SRC.parents[1] / "examples" / "demo" / "rig.toml"


@pytest.mark.parametrize(
    ("words", "extra"),
    [
        ("simulate a.yaml --plan", "sim"),
        ("studio", "studio"),
        ("teleoperate rig.toml", "teleop"),
        ("node camera rig.toml", "ros"),
        ("node fusion rig.toml", "ros"),
        (f"live {DEMO_RIG} --ros", "ros"),
        (f"live {DEMO_RIG} --ros1", "ros"),
        (f"live {DEMO_RIG} --record new.mcap", "ros"),
        (f"live {DEMO_RIG} --source cam00=ros:/a", "ros"),
        ("record --source cam00=ros:/a --out new", "ros"),
        (f"track {DEMO_RIG.parent} --outputs mcap --out new", "ros"),
        (f"track {DEMO_RIG.parent} --set detector.name=oracle --out new", "sim"),
        ("report a.mcap", "ros"),
    ],
)
def test_what_needs_a_missing_package_names_the_extra(words: str, extra: str, tmp_path: Path) -> None:
    code = f"{WITHOUT_PACKAGES}from posefuse.cli.main import main\nmain(['--help'])\nsys.exit(main({words.split()}))"
    done = python("-c", code, cwd=tmp_path)
    assert done.returncode == 1 and f"pip install 'posefuse[{extra}]'" in done.stderr, done.stderr
    assert done.stdout.count("(needs the extra") == 4


def test_names_of_posefuse_whose_package_is_missing_name_the_extra() -> None:
    wanted = {"simulate": "sim", "teleoperate": "teleop", "camera_node": "ros", "fusion_node": "ros"}
    code = (
        f"{WITHOUT_PACKAGES}import posefuse as pf\nfor name in {sorted(wanted)}:\n"
        "    try:\n        getattr(pf, name)\n    except pf.PosefuseError as error:\n        print(name, error)"
    )
    assert [f"pip install 'posefuse[{wanted[line.split()[0]]}]'" in line for line in printed("-c", code).splitlines()] == 4 * [
        True
    ]


def test_the_import_guard_can_fail() -> None:
    assert of_members({"posefuse_sim.scene.Scene", "posefuse.core"}) == {"posefuse_sim"}
    assert forbidden("fusion", {"posefuse.tracking.smoothing"}) == {"tracking"}
    assert forbidden("core", {"posefuse.formats.rig"}) == {"formats"}
    assert forbidden("cli", {"posefuse.fusion", "posefuse.core"}) == set()
    imported = {
        "posefuse.sources.VideoConfig",
        "posefuse.sources",
        "posefuse.pipeline.solve",
        "posefuse.core",
        "posefuse.api.live",
    }
    assert below_api(imported) == {"posefuse.sources", "posefuse.pipeline.solve"}


def below_api(names: set[str]) -> set[str]:
    """Modules and packages of the product among imported names, but for those that a handle may import."""
    places = {name: SRC.parent / Path(*name.split(".")) for name in names if name.startswith("posefuse.")}
    modules = {name for name, place in places.items() if place.with_suffix(".py").is_file() or (place / "__init__.py").is_file()}
    return {name for name in modules if name.split(".")[1] not in FOR_HANDLES}


def test_handles_call_the_public_functions_only() -> None:
    found: dict[str, set[str]] = {}
    for handle, folder in HANDLES.items():
        for path in folder.rglob("*.py"):
            for name in below_api(imported_names(path)):
                found.setdefault(name, set()).add(handle)
    assert found == BESIDES_API


def test_core_needs_numpy_only() -> None:
    for path in (SRC / "core").rglob("*.py"):
        tops = {name.split(".")[0] for name in imported_names(path)} - {"posefuse", "numpy", ""}
        assert tops <= set(sys.stdlib_module_names), f"{path.name} imports {sorted(tops - set(sys.stdlib_module_names))}"


def test_openvino_is_imported_where_its_telemetry_is_off() -> None:
    [place] = [path.name for path in FILES if "openvino" in {name.split(".")[0] for name in imported_names(path)}]
    assert place == "engines.py"


def test_nothing_is_called_utils() -> None:
    banned = {"utils", "common", "helpers", "manager", "misc"}
    assert not [path for path in SRC.rglob("*") if path.stem in banned]


def modules_after(statement: str) -> set[str]:
    code = f"{statement}\nimport sys\nprint(' '.join(sorted({{m.split('.')[0] for m in sys.modules}})))"
    return set(printed("-c", code).splitlines()[-1].split())


def test_help_imports_nothing_heavy() -> None:
    loaded = modules_after("from posefuse.cli import main\ntry:\n    main.main(['--help'])\nexcept SystemExit:\n    pass")
    assert "posefuse" in loaded
    assert not loaded & {*OPTIONAL, *SLOW}


def test_tracking_and_reporting_need_no_tables_of_others(demo_session: Path, tmp_path: Path) -> None:
    options = [*as_options(oracle(demo_session)), "--end", "0.5"]
    without = f"import sys\nfrom posefuse.cli.main import main\nsys.modules.update(dict.fromkeys({DATA}))\n"
    for words in (["track", str(demo_session), "--out", str(tmp_path / "a"), *options], ["report", str(tmp_path / "a")]):
        printed("-c", f"{without}sys.exit(main({words}))", limit_s=300)


def test_importing_posefuse_is_light() -> None:
    assert not modules_after("import posefuse") & {*OPTIONAL, *SLOW}
    # what the list of plug-ins imports
    ros = "posefuse_ros.bags, posefuse_ros.dds, posefuse_ros.ros1, posefuse_ros.source, posefuse_ros.mcap_output"
    assert not modules_after(f"import {ros}") & {*OPTIONAL}


# --- no import cycle, inside packages, functions and for type checkers either: what a module imports never leads back to it


def graph(*roots: Path) -> dict[str, set[str]]:
    """Module -> modules it imports anywhere; the packages a module lies in are no imports of its own."""
    files = {
        ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__"): (path, root)
        for root in roots
        for path in root.rglob("*.py")
    }
    edges = {one: {name if name in files else module for module, name in imports(*place)} for one, place in files.items()}
    return {one: {name for name in to & files.keys() if not f"{one}.".startswith(f"{name}.")} for one, to in edges.items()}


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


def test_a_cycle_is_seen(tmp_path: Path) -> None:
    (tmp_path / "package").mkdir()
    for name, text in {
        "a": "from .b import x",
        "b": "def f():\n    from .c import x",
        "c": "if TYPE_CHECKING:\n    from .a import x",
        "d": "from .a import x",
    }.items():
        (tmp_path / "package" / f"{name}.py").write_text(text, encoding="utf-8")
    assert cycles(graph(tmp_path)) == {"package.a", "package.b", "package.c"}
