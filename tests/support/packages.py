"""Where the packages of this repository lie: `posefuse`, and those that its extras install."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {path.name: path for path in (ROOT / "src" / "posefuse", *sorted(ROOT.glob("packages/*/src/posefuse_*")))}


def source_files() -> list[Path]:
    """Python files of all packages."""
    return [path for folder in PACKAGES.values() for path in sorted(folder.rglob("*.py"))]


def shown(path: Path) -> str:
    """A file as messages of tests name it: ``posefuse_sim/scene.py``."""
    [folder] = [folder for folder in PACKAGES.values() if path.is_relative_to(folder)]
    return path.relative_to(folder.parent).as_posix()
