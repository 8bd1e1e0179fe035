"""``--people N|all`` and places that begin with a minus sign."""

import pytest

from posefuse.cli.command_line import WrongCommandLineError, parse
from posefuse.cli.options.shared import ALL_PEOPLE
from posefuse.cli.options.track import TrackOptions


def options(*words: str) -> TrackOptions:
    invocation = parse(["track", "SESSION", "--out", "OUT", *words])
    assert invocation is not None
    given = invocation.bound.arguments["options"]
    assert isinstance(given, TrackOptions)
    return given


@pytest.mark.parametrize(("text", "count"), [("1", 1), ("64", 64), ("all", ALL_PEOPLE)])
def test_a_number_or_all(text: str, count: int) -> None:
    assert options("--people", text).people == count


@pytest.mark.parametrize("text", ["two", "1.5", "0", "65", "ALL"])
def test_anything_else_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(WrongCommandLineError, match="--people: expected a whole number from 1 to 64, or all, got"):
        options("--people", text)


@pytest.mark.parametrize("place", ["-1.1,0", "-.5,-2", "1,-2"])
@pytest.mark.parametrize("form", [["--person={}"], ["--person", "{}"]])
def test_a_place_left_of_the_origin_is_no_option(place: str, form: list[str]) -> None:
    got = options(*(part.format(place) for part in form), "--raw")
    assert got.person == tuple(map(float, place.split(",")))
    assert got.raw


def test_an_option_after_person_stays_an_option() -> None:
    with pytest.raises(WrongCommandLineError, match="--person"):
        options("--person", "--raw")
