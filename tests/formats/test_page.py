"""Pages: one file that stands alone, shows its input and nothing else, and survives names, gaps and emptiness."""

import base64
import csv
import gzip
import html
import json
import re
import shutil
import subprocess

import cv2
import numpy as np
import pytest
from checks import refusal
from hypothesis import given
from hypothesis import strategies as st

from posefuse.core import InputError
from posefuse.formats.page import (
    Band,
    Cards,
    Cell,
    Details,
    Dots,
    Facts,
    Heading,
    Images,
    Line,
    Note,
    Page,
    Player,
    Plot,
    Plots,
    Spikes,
    Table,
    Ticks,
    write_page,
)
from posefuse.formats.page.page import PLOTLY
from posefuse.formats.page.plots import COARSE, FINE, page_numbers

NASTY = "<b>[x]</script>{{ 7*7 }}&amp;\"'%{y}"
GAP = np.array([0.0, 1, np.nan, np.nan, 3, 4, 2])
X = np.arange(7) * 0.1


def axes(*series, **more):
    return Plot("p", series, **{"x_label": "s", "y_label": "mm", **more})


def player(t_s, xyz, bones=((),), **more):
    """Of one person without bones."""
    bones = np.array(bones, int).reshape(-1, 2)
    return Player(t_s, xyz, bones=bones, **{"sides": (), "people": ("a",), **more})


def shown(read_page, tmp_path, *blocks, **more):
    return read_page(write_page(tmp_path / "page.html", Page("title", blocks, **more)))


@pytest.mark.parametrize("parts", [FINE, COARSE])
@given(st.lists(st.one_of(st.floats(-1e9, 1e9), st.just(float("nan"))), max_size=60))
def test_numbers_are_kept_to_a_fraction_of_their_range(parts, values):
    values = np.array(values, float)
    again = np.array(page_numbers(values, parts), float)
    known = np.isfinite(values)
    np.testing.assert_array_equal(np.isfinite(again), known)
    span = np.ptp(values[known]) if known.any() else 0.0
    span = span or (np.abs(values[known]).max() if known.any() else 0.0) or 1.0
    np.testing.assert_allclose(again[known], values[known], rtol=0, atol=max(1.01 * span / parts / 2, 1e-12))


def test_every_kind_of_series_arrives_as_it_was_given(read_page, tmp_path):
    lines = [Line("line", X, GAP, colour="left"), Band("band", X, GAP - 1, GAP + 1)]
    dots = Dots("dots", X, GAP, labels=list("abcdefg"))
    series = [*lines, dots, Spikes("spikes", X, GAP * 0, GAP), Ticks("ticks", X[:2], colour="right")]
    plot = shown(read_page, tmp_path, Plots([axes(*series)])).plot("p")
    for given_one, one in zip(series, plot["series"], strict=True):
        assert (one["type"], one["name"]) == (given_one.type, given_one.name)
        for name in given_one.of:
            np.testing.assert_allclose(one[name], getattr(given_one, name), atol=2e-3 if given_one.type == "band" else 3e-4)
    assert plot["series"][0]["colour"] == "left"
    assert plot["series"][1]["colour"] == "c0" and plot["series"][2]["colour"] == "c1"
    assert plot["series"][2]["labels"] == list("abcdefg")
    assert plot["legend"]


def test_arrays_that_are_the_same_are_stored_once(read_page, tmp_path):
    page = shown(read_page, tmp_path, Plots([axes(Line("a", X, GAP), Line("b", X.copy(), 2 * GAP))] * 2))
    assert len(page.data["arrays"]) == 3 and len(page.data["plots"]) == 2


def test_names_are_shown_as_they_are_and_run_nothing(read_page, tmp_path):
    named = [Heading(NASTY, NASTY), Cards({NASTY: NASTY}), Facts({NASTY: NASTY}), Table([NASTY], [[NASTY]])]
    image, details = Images({NASTY: np.zeros((4, 4, 3), np.uint8)}), Details(NASTY, [Note(NASTY, warning=True)])
    plots = Plots([Plot(NASTY, [Line(NASTY, X, GAP)], x_label=NASTY, y_label=NASTY)])
    page = Page(NASTY, [*named, image, details, plots], subtitle=NASTY)
    read = read_page(write_page(tmp_path / "page.html", page))
    assert read.headings == [NASTY, NASTY, NASTY]
    assert read.tables == [[[NASTY, NASTY]], [[NASTY], [NASTY]]]
    assert read.text.count(NASTY) >= 12
    assert read.plot(NASTY)["series"][0]["name"] == NASTY


def test_missing_values_are_dashes_and_gaps(read_page, tmp_path):
    table = Table(["joint", "mm"], [["neck", 12.345], ["hip", float("nan")], ["toe", None], ["knee", 0.0123]])
    plots = Plots([axes(Line("none", X, X * np.nan)), axes(Band("none", X, X * np.nan, X * np.nan)), axes()])
    page = shown(read_page, tmp_path, table, Facts({"a": float("inf")}), plots)
    assert page.tables == [[["joint", "mm"], ["neck", "12.3"], ["hip", "–"], ["toe", "–"], ["knee", "0.0"]], [["a", "–"]]]
    assert np.isnan(page.data["plots"][0]["series"][0]["y"]).all()
    assert page.data["plots"][1]["ranges"] == [None, None] and page.data["plots"][2]["series"] == []


def test_empty_blocks_make_a_whole_page(read_page, tmp_path):
    nothing = player(np.zeros(0), np.zeros((0, 0, 5, 3)), people=())
    blocks = (Cards({}), Facts({}), Table(["a"], []), Images({}), Details("d", []), Plots([]), nothing)
    page = shown(read_page, tmp_path, *blocks)
    assert page.headings == ["title"] and page.images == []
    bare = tmp_path / "bare.html"
    read_page(write_page(bare, Page("nothing", [])))
    refusal(InputError, "no folder", write_page, tmp_path / "nowhere" / "page.html", Page("nothing", []))
    assert "<script" not in bare.read_text() and bare.stat().st_size < 20_000


def test_sections_begin_at_headings_and_cells_have_tones(read_page, tmp_path):
    table = Table(["a", "b"], [[Cell("bad one", "bad"), Cell(3.0, "left")]])
    page = shown(read_page, tmp_path, Note("before"), Heading("one"), table, Heading("three", level=3), Heading("two"))
    assert (tmp_path / "page.html").read_text().count("<section>") == 3
    assert page.headings == ["title", "one", "three", "two"]
    assert page.classes == {"bad one": "bad", "3.0": "left"}


def test_images_are_inside_and_what_is_none_is_refused(read_page, tmp_path):
    picture = np.random.default_rng(0).integers(0, 255, (6, 9, 3), np.uint8)
    assert len(shown(read_page, tmp_path, Images({"a": picture, "b": picture[:3]})).images) == 2
    photograph = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 255, (200, 300, 3), np.uint8), (0, 0), 3)
    [address] = shown(read_page, tmp_path, Images({"a": photograph})).images
    head, _, content = address.partition(",")
    image = cv2.imdecode(np.frombuffer(base64.b64decode(content), np.uint8), cv2.IMREAD_COLOR_RGB)
    # a page of the paper was 1.5 MB of lossless photographs
    assert head == "data:image/jpeg;base64" and len(content) * 5 < len(cv2.imencode(".png", photograph)[1]) * 4
    assert np.abs(image.astype(float) - photograph).mean() < 3
    for wrong in (picture[..., 0], picture[:0], picture.astype(float)):
        refusal(InputError, "RGB image", write_page, tmp_path / "bad.html", Page("t", [Images({"x": wrong})]))
    assert not (tmp_path / "bad.html").exists()


def test_bands_widen_the_axes_but_do_not_flatten_the_line(read_page, tmp_path):
    y = np.linspace(10, 20, 50)
    wide = np.full(50, 3.0)
    wide[25] = 4000.0
    for half, low, high in ((np.full(50, 2.0), 8, 22), (wide, 0, 30)):
        x = np.arange(50.0)
        plot = shown(read_page, tmp_path, Plots([axes(Band("b", x, y - half, y + half), Line("l", x, y))])).plot("p")
        least, most = plot["ranges"][1]
        assert low - 2 < least <= low and high <= most < high + 2


def test_long_series_are_thinned_and_it_is_reported(read_page, tmp_path):
    x = np.arange(20_000.0)
    plot = shown(read_page, tmp_path, Plots([axes(Line("l", x, x), Band("b", x, x - 1, x + 1))])).plot("p")
    assert len(plot["series"][1]["x"]) <= 900 and plot["series"][1]["x"][-1] > 19_900
    step = int(plot["series"][0]["x"][1])
    assert 1000 < len(plot["series"][0]["x"]) <= 3600 and f"every {step}th point" in plot["x"]


def test_printed_headings_stay_with_their_text_tables_stay_whole_and_pages_are_numbered(tmp_path):
    style = write_page(tmp_path / "page.html", Page("t", [])).read_text(encoding="utf-8")
    for place, rule in (
        ("h2, h3", "break-after: avoid"),
        (r"\btable\b", "break-inside: avoid"),
        ("@bottom-right", "content: counter"),
    ):
        assert re.search(rf"{place}[^{{]*\{{ {rule}", style), rule


def test_windows_zero_and_equal_axes_reach_the_script(read_page, tmp_path):
    plots = [axes(Line("l", X, GAP), window=(0, 2, 0, 10)), axes(Line("l", X, GAP), from_zero=True, equal=True)]
    first, second = shown(read_page, tmp_path, Plots(plots)).data["plots"]
    assert first["ranges"] == [[0, 2], [0, 10]] and not first["legend"]
    assert second["ranges"][1][0] == 0 and second["equal"]


def test_the_player_keeps_positions_to_a_millimetre(read_page, tmp_path):
    rng = np.random.default_rng(1)
    xyz = rng.normal(size=(90, 2, 4, 3)).cumsum(axis=0) * 0.01
    xyz[10:20, 1, 2] = np.nan
    t_s = np.arange(90) / 60
    block = player(t_s, xyz, [(0, 1), (2, 3)], sides=("left", "mid"), people=("a", NASTY), right_left=[(0, 1)])
    [content] = shown(read_page, tmp_path, block).data["players"]
    np.testing.assert_allclose(content["t"], t_s[::2], atol=6e-4)
    for n, person in enumerate(content["people"]):
        for k, positions in enumerate(person["xyz"]):
            np.testing.assert_allclose(np.array(positions, float).T, xyz[::2, n, k], atol=5.1e-4)
    assert content["people"][1]["name"] == NASTY and content["across"] == [[0, 1]] and block.note == ""
    # a long recording is cut, which is reported
    long = player(np.arange(12_000) / 30, np.zeros((12_000, 1, 1, 3)))
    assert len(long.kept) == 5400 and long.note == "The first 180 s of 400 s."


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: Line("l", X, X[:3]), "line: expected arrays of one length"),
        (lambda: Spikes("l", X, X, X, colour="pink"), "unknown colour 'pink'"),
        (lambda: Table(["a", "b"], [["only one"]]), "expected rows of 2 cells"),
        (lambda: player(X, np.zeros((3, 1, 1, 3))), r"expected positions \(7, 1"),
        (lambda: player(X, np.zeros((7, 1, 1, 3)), [(0, 0)]), "a side for each of 1 bones"),
    ],
)
def test_blocks_that_do_not_fit_together_are_refused(build, said):
    refusal(InputError, said, build)


def test_the_bundle_of_plotly_has_the_version_of_its_name():
    head = gzip.decompress(PLOTLY.read_bytes())[:300].decode()
    version = re.search(r"plotly\.js \(basic - minified\) v([\d.]+)", head)[1]
    assert PLOTLY.name.endswith(f"-{version}.min.js.gz")
    assert "MIT" in head and "MIT License" in PLOTLY.with_name("plotly-LICENSE.txt").read_text()


# --- a page in a real browser: its script draws what it was given, saves it, plays it, and reports no error. Needs Chromium


BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

ODD_NAME = '<b>[x]</b> & "y", %{z}'
Y = np.array([0.0, 1.5, np.nan, np.nan, 3, 4.25, 2])
# waits until everything is drawn, plays, saves a plot's data, and leaves what it saw in the title
PROBE = """
<script>
const errors = [], saved = [];
addEventListener("error", event => errors.push(event.message));
addEventListener("unhandledrejection", event => errors.push(String(event.reason)));
URL.createObjectURL = blob => { saved.push(blob.text()); return "data:,"; };
// frames come by the browser's own clock, which is not that of the machine
requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 16);
const wait = ms => new Promise(done => setTimeout(done, ms));
const until = async met => { for (let i = 0; i < 150 && !met(); i++) await wait(50); };
addEventListener("load", async () => {
  const axes = [...document.querySelectorAll(".axes")], find = text => document.querySelector(text);
  await until(() => axes.every(one => one.data && one.querySelector(".main-svg")));
  const time = find(".time"), button = find(".play");
  button.click();
  await until(() => Number(time.value) > 0);
  button.click();
  find('[data-title="Save the data as CSV"]').click();
  const seen = trace => ({ name: trace.name, x: [...trace.x], y: [...trace.y] });
  const canvas = find(".player canvas"), ink = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  const blue = ink.filter((red, at) => at % 4 == 0 && ink[at + 3] > 128 && ink[at + 2] > red + 80).length;
  const report = { errors, blue, played: Number(time.value), csv: await saved[0], shown: find(".legendtext").textContent,
                   drawn: axes.map(one => one.data.map(seen)) };
  document.body.innerHTML = "";
  document.body.append(Object.assign(document.createElement("pre"), { id: "report", textContent: JSON.stringify(report) }));
});
</script>
"""


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """What the browser made of a page of every kind of series and a player."""
    if BROWSER is None:
        pytest.skip("needs Chromium")
    spread = [Band("band", X, Y - 1, Y + 1), Dots("dots", X, Y), Spikes("spikes", X, Y * 0, Y), Ticks("ticks", X[:2])]
    xyz = np.random.default_rng(0).normal(size=(900, 1, 4, 3))
    plots = [axes(Line(ODD_NAME, X, Y), *spread), axes(Line("none", X, X * np.nan), equal=True)]
    block = player(np.arange(900) / 10, xyz, [(0, 1)], sides=("left",), right_left=[(0, 1)])
    path = write_page(tmp_path_factory.mktemp("page") / "page.html", Page("title", [Plots(plots), block]))
    path.write_text(path.read_text(encoding="utf-8").replace("<head>", f"<head>{PROBE}"), encoding="utf-8")
    flags = "--headless --no-sandbox --disable-gpu --window-size=1000,2400 --virtual-time-budget=15000 --dump-dom"
    run = subprocess.run([BROWSER, *flags.split(), path.as_uri()], capture_output=True, text=True, timeout=120)
    found = re.search(r'<pre id="report">(.*?)</pre>', run.stdout, re.DOTALL)
    assert found, run.stdout[-500:]
    return json.loads(html.unescape(found[1]))


def values(column):
    return np.array([np.nan if value is None else value for value in column], float)


def test_the_script_runs_without_errors_and_the_player_plays(seen):
    assert seen["errors"] == []
    assert 0 < seen["played"] < 900
    assert seen["shown"] == ODD_NAME
    assert seen["blue"] > 8, "its one bone is a left one: only the word of the legend is blue"


def test_what_is_drawn_is_what_was_given(seen):
    line, band, dots, spikes, ticks = seen["drawn"][0]
    for one in (line, dots):
        np.testing.assert_allclose(values(one["x"]), X, atol=2e-3)
        np.testing.assert_allclose(values(one["y"]), Y, atol=2e-3)
    assert sum(value is None for value in band["x"]) == 1
    assert np.nanmin(values(band["y"])) == pytest.approx(np.nanmin(Y) - 1, abs=2e-3)
    assert np.nanmax(values(band["y"])) == pytest.approx(np.nanmax(Y) + 1, abs=2e-3)
    np.testing.assert_allclose(values(spikes["y"])[1::3], Y, atol=2e-3)
    np.testing.assert_allclose(values(ticks["x"]), X[:2])


def test_the_data_of_a_plot_can_be_saved(seen):
    head, *rows = csv.reader(seen["csv"].splitlines())
    assert head == ["s", ODD_NAME, "band low", "band high", "dots", "spikes low", "spikes high", "ticks, s"]
    table = np.array([[float(cell or "nan") for cell in row] for row in rows])
    expected = [X, Y, Y - 1, Y + 1, Y, Y * 0, Y, np.pad(X[:2], (0, 5), constant_values=np.nan)]
    np.testing.assert_allclose(table.T, expected, atol=2e-3)
