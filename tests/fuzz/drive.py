"""The fuzz stage: damaged files for every reader and every command, each variant bounded in time, in a process that may crash.

python tests/fuzz/drive.py --variants 110 --write docs/reliability.md
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.context import SpawnProcess
from pathlib import Path

from damage import damaged
from options import OPTIONS
from worker import answers

from examples import EXAMPLES, openpose_session

LIMIT_S = 20.0
PATIENCE = 6
# a fresh process imports everything, and compiles numeric kernels where none are kept yet
START_LIMIT_S = 300.0
OUTCOMES = ("clear", "accepted", "trace", "hang", "crash")
SOUND = -1  # number of the variant that is not damaged
BAD = ("trace", "hang", "crash")
HUNG = -getattr(signal, "SIGXCPU", 24)
COLUMNS = ("variants", "one clear line", "accepted", "traceback or warning", "hang over 20 s", "crash")
# commands take a second each, readers milliseconds: commands get this share of the variants
COMMAND_SHARE = 0.25
# a narrow terminal would wrap messages, and colour codes would split them
os.environ |= {"COLUMNS": "500", "NO_COLOR": "1"}
SPAWN = get_context("spawn")


@dataclass(frozen=True)
class Failure:
    """A variant that was not handled."""

    kind: str
    seed: int
    damage: str
    outcome: str
    detail: str


class Worker:
    """`worker.answers` in a process of its own, with a time limit on every answer; restarted after a crash or a hang."""

    def __init__(self) -> None:
        self._process: SpawnProcess | None = None

    def ask(self, kind: str, folder: Path, file: str, limit_s: float) -> tuple[str, str]:
        """Outcome and detail of one variant. Processor time is limited; waiting counts only above `PATIENCE` limits (the machine
        may be busy)."""
        if self._process is None:
            self._pipe, other = SPAWN.Pipe()
            self._process = SPAWN.Process(target=answers, args=(other,), daemon=True)
            self._process.start()
            other.close()
            assert self._pipe.poll(START_LIMIT_S) and self._pipe.recv() == "ready"
        try:
            # where it has ended, so has its answer
            self._pipe.send((kind, folder, file, limit_s))
            if self._pipe.poll(PATIENCE * limit_s):
                answer: tuple[str, str] = self._pipe.recv()
                return answer
            code = HUNG
        except (EOFError, OSError):
            self._process.join(LIMIT_S)
            code = self._process.exitcode
        self.stop()
        if code == HUNG:
            return "hang", f"no answer within {limit_s:g} s"
        return "crash", f"the interpreter ended with code {code}"

    def stop(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join(LIMIT_S)
            self._process = None


def run(
    variants: int, kinds: Sequence[str], commands: bool = True, first: int = 0
) -> tuple[dict[str, Counter[str]], list[Failure]]:
    """Damage and read `variants` files of each kind, from seed `first` on; the counts per kind and what went wrong."""
    counts: dict[str, Counter[str]] = {}
    failures: list[Failure] = []
    worker = Worker()
    with tempfile.TemporaryDirectory(prefix="posefuse-fuzz-") as folder:
        try:
            for kind, seed, damage, place, file, limit_s in _variants(Path(folder), variants, kinds, commands, first):
                outcome, detail = worker.ask(kind, place, file, limit_s)
                if seed == SOUND and outcome == "clear":
                    # a reader that refuses even the undamaged file would find nothing
                    outcome, detail = "trace", f"the undamaged file is refused: {detail}"
                counts.setdefault(kind, Counter())[outcome] += 1
                if outcome in BAD:
                    failures.append(Failure(kind, seed, damage, outcome, detail))
        finally:
            worker.stop()
    return counts, failures


def _variants(
    folder: Path, variants: int, kinds: Sequence[str], commands: bool, first: int
) -> Iterator[tuple[str, int, str, Path, str, float]]:
    for kind in (kind for kind in EXAMPLES if kind in kinds):
        example, is_command = EXAMPLES[kind], EXAMPLES[kind].read is None
        if is_command and not commands:
            continue
        sound = folder / "sound"
        sound.mkdir()
        example.make(sound)
        content = (sound / example.file).read_bytes()
        count = max(3, round(variants * (COMMAND_SHARE if is_command else 1)))
        for seed in (SOUND, *range(first, first + count)):
            damage, bytes_ = ("none", content) if seed == SOUND else damaged(content, kind, seed)
            place = folder / "variant" / "session"
            shutil.copytree(sound, place)
            (place / example.file).write_bytes(bytes_)
            # the first file of a kind may still trigger compilation
            yield kind, seed, damage, place, example.file, START_LIMIT_S if seed == SOUND else LIMIT_S
            shutil.rmtree(place.parent, ignore_errors=True)
        shutil.rmtree(sound)
    if commands and "options" in kinds:
        yield from _options(folder)


def _options(folder: Path) -> Iterator[tuple[str, int, str, Path, str, float]]:
    for seed, words in enumerate(OPTIONS, start=SOUND):
        place = folder / "variant" / "session"
        place.mkdir(parents=True)
        openpose_session(place)
        (place / "words.txt").write_text(words)
        yield "options", seed, words, place, "words.txt", START_LIMIT_S if seed == SOUND else LIMIT_S
        shutil.rmtree(place.parent, ignore_errors=True)


def table(counts: dict[str, Counter[str]]) -> str:
    """The counts as a Markdown table."""
    rows = [(kind, sum(count.values()), *(count[outcome] for outcome in OUTCOMES)) for kind, count in counts.items()]
    rows.append(("**all**", *(sum(row[i] for row in rows) for i in range(1, 2 + len(OUTCOMES)))))
    lines = [f"| kind | {' | '.join(COLUMNS)} |", "|---|" + "---:|" * len(COLUMNS)]
    lines += [f"| {' | '.join(str(cell) for cell in row)} |" for row in rows]
    return "\n".join(lines)


def main() -> int:
    """0 when every variant was handled."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variants", type=int, default=110, help="per reader; commands get a quarter")
    parser.add_argument("--only", action="append", metavar="KIND", help=f"one of: {', '.join([*EXAMPLES, 'options'])}")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="the first seed; fresh ones find what 0 does not")
    parser.add_argument("--readers-only", action="store_true", help="do not run the commands")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="put the table between the marks of this page")
    args = parser.parse_args()
    counts, failures = run(args.variants, args.only or [*EXAMPLES, "options"], not args.readers_only, args.first)
    for one in failures:
        print(f"--- {one.kind}, seed {one.seed} ({one.damage}): {one.outcome}\n{one.detail}", flush=True)
    print(table(counts))
    if args.write:
        from page_marks import write_between_marks

        write_between_marks(args.write, table(counts), "fuzz")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
