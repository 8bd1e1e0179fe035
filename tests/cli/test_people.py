"""``--people N|all``."""

from types import SimpleNamespace

import pytest

from posefuse.cli.options.shared import ALL_PEOPLE, people_from_text


@pytest.mark.parametrize(("text", "count"), [("1", 1), ("64", 64), ("all", ALL_PEOPLE)])
def test_a_number_or_all(text: str, count: int) -> None:
    assert people_from_text(None, [SimpleNamespace(value=text)]) == count


@pytest.mark.parametrize("text", ["0", "65", "-1", "two", "1.5", "", "ALL"])
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"^expected a whole number from 1 to 64, or all, got "):
        people_from_text(None, [SimpleNamespace(value=text)])
