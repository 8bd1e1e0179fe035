"""``--people N`` and places that begin with a minus sign."""

from typing import Any

import pytest

from posefuse.cli.command_line import WrongCommandLineError, parse


def given(*words: str) -> dict[str, Any]:
    invocation = parse(["track", "SESSION", "--out", "OUT", *words])
    assert invocation is not None
    changes: dict[str, Any] = invocation.bound.arguments["options"].changes
    return changes


@pytest.mark.parametrize(("text", "count"), [("1", 1), ("64", 64)])
def test_a_number_of_people(text: str, count: int) -> None:
    assert given("--people", text) == {"associate.max_people": count}


@pytest.mark.parametrize("text", ["two", "1.5", "0", "1001", "all"])
def test_anything_else_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(WrongCommandLineError, match=rf"--people: expected N \(input should be .*\), got '{text}'"):
        given("--people", text)


@pytest.mark.parametrize("place", ["-1.1,0", "-.5,-2", "1,-2"])
@pytest.mark.parametrize("form", [["--person={}"], ["--person", "{}"]])
def test_a_place_left_of_the_origin_is_no_option(place: str, form: list[str]) -> None:
    got = given(*(part.format(place) for part in form), "--raw")
    assert got == {"associate.near_xy_m": tuple(map(float, place.split(","))), "raw": True}


def test_an_option_after_person_stays_an_option() -> None:
    with pytest.raises(WrongCommandLineError, match="--person"):
        given("--person", "--raw")
