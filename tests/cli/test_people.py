"""``--people N|all`` and places that begin with a minus sign."""

import argparse

import pytest

from posefuse.cli.people import EVERYBODY, people_count, with_places_joined


@pytest.mark.parametrize(("text", "count"), [("1", 1), ("64", 64), ("all", EVERYBODY)])
def test_a_number_or_all(text: str, count: int) -> None:
    assert people_count(text) == count


@pytest.mark.parametrize("text", ["two", "1.5", "", "ALL"])
def test_anything_else_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=r"^expected a whole number, or all, got "):
        people_count(text)


@pytest.mark.parametrize("place", ["-1.1,0", "-.5,-2", "1,-2"])
@pytest.mark.parametrize("form", [["--person={}"], ["--person", "{}"]])
def test_a_place_left_of_the_origin_is_no_option(place: str, form: list[str]) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--person")
    parser.add_argument("-v", action="store_true")
    got = parser.parse_args(with_places_joined([*(part.format(place) for part in form), "-v"]))
    assert (got.person, got.v) == (place, True)


def test_an_option_after_person_stays_an_option() -> None:
    assert with_places_joined(["--person", "--force", "-1"]) == ["--person", "--force", "-1"]
