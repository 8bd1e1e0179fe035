"""Commands of posefuse that run in this process: what they print, and what lets them run without a network."""

import json
from pathlib import Path
from typing import Any

from posefuse.cli.main import main

DEMO = Path(__file__).resolve().parents[2] / "examples" / "demo"


def oracle(session: Path = DEMO) -> dict[str, str]:
    """Settings by which the truth of a session stands for its detector."""
    return {"detector.name": "oracle", "detector.options.truth": (session / "truth" / "truth.npz").as_posix()}


def as_options(settings: dict[str, Any]) -> list[str]:
    """Settings as words of a command line."""
    return [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]


def tracked(session: Path, out: Path, outputs: str = "", end_s: float = 0.3) -> Path:
    """The result of the beginning of a session of the bundled clip, seen by the oracle."""
    words = ["track", str(session), "--out", str(out), *as_options(oracle()), "--end", str(end_s), "--outputs", outputs]
    assert main(words) == 0
    return out


def figures(capsys: Any, *words: object) -> dict[str, Any]:
    """The figures of a command that succeeds."""
    capsys.readouterr()
    code, shown = main([*map(str, words), "--json"]), capsys.readouterr()
    assert code == 0, shown.err
    found: dict[str, Any] = json.loads(shown.out)
    return found


def error(capsys: Any, *words: object) -> str:
    """What a command prints that ends with exit code 1."""
    capsys.readouterr()
    code, shown = main([*map(str, words)]), capsys.readouterr()
    assert code == 1, shown.err
    return str(shown.err)
