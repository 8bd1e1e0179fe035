"""Text, TOML, JSON, YAML and arrays of damaged files: one clear line, bounded work."""

from pathlib import Path

import numpy as np
import pytest
from checks import refusal

from posefuse.core import ConfigError, InputError
from posefuse.formats import npz
from posefuse.formats.npz import read_arrays
from posefuse.foundation.parsing import one_line, parse_json, parse_toml, parse_yaml, read_text, short
from posefuse.foundation.settings import read_mapping, settings, settings_from_mapping

BOMB = "a0: &a0 [x]\n" + "".join(f"a{i + 1}: &a{i + 1} [{', '.join([f'*a{i}'] * 9)}]\n" for i in range(9))


@settings
class Numbers:
    value: float = 0.0
    many: tuple[float, ...] = ()


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    path = tmp_path / "posefuse.toml"
    path.write_bytes(b"\xef\xbb\xbfvalue = 1.5\n")
    assert read_mapping(path) == {"value": 1.5}
    assert read_text(path).startswith("value")


@pytest.mark.parametrize("content", ["x = é".encode("latin-1"), "x = é".encode("utf-16")])
def test_text_that_is_not_utf8_is_one_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.toml").write_bytes(content)
    refusal(ConfigError, r"a\.toml: cannot be read as text .*; save it as UTF-8", read_mapping, tmp_path / "a.toml")


def test_json_of_any_size_and_depth() -> None:
    assert parse_json("a", '{"b": 1' + "0" * 17 + "}") == {"b": 10**17}
    # nanoseconds since 1970, and the limits of 64 bits
    for number in (1_795_514_162_018_423_794, 2**63 - 1, -(2**63)):
        assert parse_json("a", f"[{number}]") == [number] and isinstance(parse_json("a", f"[{number}]")[0], int)
    assert isinstance(parse_json("a", f"[{2**63}]")[0], float)
    assert parse_json("a", '{"b": 1' + "0" * 5000 + "}") == {"b": float("inf")}
    refusal(InputError, r"^a: cannot be parsed as JSON \(nested too deeply\)$", parse_json, "a", "[" * 200_000)


def test_toml_and_yaml_that_are_too_deep_or_contain_themselves() -> None:
    refusal(InputError, "cannot be parsed as TOML", parse_toml, "a", "x = " + "[" * 200_000)
    refusal(InputError, "cannot be parsed as YAML", parse_yaml, "a", "x: " + "[" * 20_000)
    refusal(InputError, "a value contains itself", parse_yaml, "a", "x: &x [1, *x]")
    refusal(InputError, "cannot be parsed as YAML", parse_yaml, "a", "x: 2026-99-99")


def test_a_bomb_of_aliases_is_refused_with_its_number(tmp_path: Path) -> None:
    refusal(InputError, r"its aliases stand for \d\.\d+e\+0[89] values; expected at most 1000000", parse_yaml, "a", BOMB)
    (tmp_path / "scene.yaml").write_text(BOMB)
    refusal(ConfigError, "its aliases stand for", read_mapping, tmp_path / "scene.yaml")
    assert parse_yaml("a", "x: &x [1]\ny: [*x, *x]") == {"x": [1], "y": [[1], [1]]}


def test_a_refused_value_is_shown_shortly() -> None:
    message = refusal(ConfigError, "", settings_from_mapping, {"value": ["x" * 10**6] * 100}, Numbers, "here")
    assert message.startswith("here: value: ") and len(message) < 800
    assert len(short("x" * 10**6)) < 200 and len(one_line("x\n" * 10**6)) < 500


@pytest.mark.parametrize("content", [{"value": float("nan")}, {"value": float("inf")}, {"many": [1.0, float("-inf")]}])
def test_settings_are_finite(content: dict) -> None:
    refusal(ConfigError, "finite", settings_from_mapping, content, Numbers, "here")


def test_damaged_arrays_are_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, a=np.arange(1000), b=np.ones(3))
    whole = path.read_bytes()
    assert set(read_arrays(path)) == {"a", "b"}
    for damage in (b"", b"PK", whole[: len(whole) // 2], whole[:60] + b"\xff" * 40 + whole[100:]):
        path.write_bytes(damage)
        refusal(InputError, r"a\.npz: not an \.npz file", read_arrays, path)
    np.save(tmp_path / "b.npy", np.arange(3))
    refusal(InputError, r"not an \.npz file", read_arrays, tmp_path / "b.npy")
    refusal(InputError, "no such file", read_arrays, tmp_path / "none.npz")


def test_arrays_that_claim_gigabytes_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(10**6))
    assert len(read_arrays(tmp_path / "a.npz")["a"]) == 10**6
    monkeypatch.setattr(npz, "_EXPANSION_MATTERS_BYTES", 1000)
    refusal(InputError, r"claims to hold 8000128 bytes in a file of", read_arrays, tmp_path / "a.npz")
