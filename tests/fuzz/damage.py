"""Ways to damage a file: by a disk, an editor, a spreadsheet, or an attacker. The same seed gives the same bytes."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

Damage = Callable[[random.Random, bytes], bytes]

_TEXTS = (*(b"nan", b"inf", b"-1", b"0", b"1e308", b"-1e400", b"0x7f"), *(b'"text"', b"[]", b"{}", b"null", b"", b"1,5"),
          b"9" * 400, b"9" * 5000)  # fmt: skip
_BYTES = (b"\xff", b"\x00", b"\x7f", b"\x80", b"\x01")


def _flips(rng: random.Random, content: bytes) -> bytes:
    out = bytearray(content)
    for _ in range(rng.choice((1, 3, 20))):
        out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _flips_near_the_start(rng: random.Random, content: bytes) -> bytes:
    head = min(len(content), 2048)
    return _flips(rng, content[:head]) + content[head:]


def _truncated(rng: random.Random, content: bytes) -> bytes:
    return content[: rng.randrange(len(content))]


def _inserted(rng: random.Random, content: bytes) -> bytes:
    place = rng.randrange(len(content))
    return content[:place] + rng.randbytes(rng.choice((1, 4, 100))) + content[place:]


def _deleted(rng: random.Random, content: bytes) -> bytes:
    place = rng.randrange(len(content))
    return content[:place] + content[place + rng.choice((1, 7, 300)) :]


def _swapped_sections(rng: random.Random, content: bytes) -> bytes:
    a, b, c = sorted(rng.randrange(len(content) + 1) for _ in range(3))
    return content[:a] + content[b:c] + content[a:b] + content[c:]


def _extreme_bytes(rng: random.Random, content: bytes) -> bytes:
    place, size = rng.randrange(len(content)), rng.choice((1, 2, 4, 8))
    return content[:place] + rng.choice(_BYTES) * size + content[place + size :]


def _number_replaced(rng: random.Random, content: bytes) -> bytes:
    found = list(re.finditer(rb"[-+]?\d[\d.]*(?:e[-+]?\d+)?", content))
    if not found:
        return _extreme_bytes(rng, content)
    one = rng.choice(found)
    return content[: one.start()] + rng.choice(_TEXTS) + content[one.end() :]


def _lines_deleted(rng: random.Random, content: bytes) -> bytes:
    lines = content.split(b"\n")
    place = rng.randrange(len(lines))
    return b"\n".join(lines[:place] + lines[place + rng.choice((1, 3)) :])


def _lines_shuffled(rng: random.Random, content: bytes) -> bytes:
    lines = content.split(b"\n")
    rng.shuffle(lines)
    return b"\n".join(lines)


def _line_repeated(rng: random.Random, content: bytes) -> bytes:
    lines = content.split(b"\n")
    place = rng.randrange(len(lines))
    return b"\n".join(lines[: place + 1] + lines[place:])


def _word_replaced(rng: random.Random, content: bytes) -> bytes:
    found = list(re.finditer(rb"[A-Za-z_]{3,}", content))
    if not found:
        return _flips(rng, content)
    one, other = rng.choice(found), rng.choice(found)
    return content[: one.start()] + rng.choice((other.group(), b"x\xfcy", b"x" * 70_000)) + content[one.end() :]


def _deep_brackets(rng: random.Random, content: bytes) -> bytes:
    place = rng.choice([0, *(match.end() for match in re.finditer(rb"[:=,]", content))])
    return content[:place] + rng.choice((b"[", b'{"a":', b"<a>")) * 200_000 + content[place:]


def _other_encoding(rng: random.Random, content: bytes) -> bytes:
    text = content.decode("utf-8", errors="replace")
    choice = rng.randrange(4)
    if choice == 0:
        return b"\xef\xbb\xbf" + content
    if choice == 1:
        return text.encode("utf-16")
    if choice == 2:
        return text.replace("e", "\u00e9").encode("latin-1", errors="replace")
    return content.replace(b"\n", b"\r\n")


def _spreadsheet(rng: random.Random, content: bytes) -> bytes:
    """Decimal and field separators as a spreadsheet with another locale writes them."""
    return content.replace(b",", b";").replace(b".", b",") if rng.random() < 0.7 else content.replace(b",", b"\t")


def _empty(rng: random.Random, content: bytes) -> bytes:
    return rng.choice((b"", b"\n", b"\0" * 4096, content * 2))


DAMAGES: tuple[Damage, ...] = (
    _flips, _flips_near_the_start, _truncated, _inserted, _deleted, _swapped_sections, _extreme_bytes, _number_replaced,
    _number_replaced, _lines_deleted, _lines_shuffled, _line_repeated, _word_replaced, _deep_brackets, _other_encoding,
    _spreadsheet, _empty,
)  # fmt: skip


def damaged(content: bytes, kind: str, seed: int) -> tuple[str, bytes]:
    """(name of the damage, damaged bytes) number `seed` of a file of this kind."""
    rng = random.Random(f"{kind} {seed}")
    damage = DAMAGES[seed % len(DAMAGES)]
    return damage.__name__.strip("_"), damage(rng, content or b"\0")
