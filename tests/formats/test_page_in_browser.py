"""A page in a real browser: its script draws what it was given, saves it, plays it, and reports no error. Needs Chromium."""

import csv
import html
import json
import re
import shutil
import subprocess
import zlib

import numpy as np
import pytest

from posefuse.formats.page import (
    Band,
    Dots,
    Heading,
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

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="needs Chromium")

NAME = '<b>[x]</b> & "y", %{z}'
GAP = np.array([0.0, 1.5, np.nan, np.nan, 3, 4.25, 2])
X = np.arange(7) * 0.1
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
    series = [
        Line(NAME, X, GAP),
        Band("band", X, GAP - 1, GAP + 1),
        Dots("dots", X, GAP),
        Spikes("spikes", X, GAP * 0, GAP),
        Ticks("ticks", X[:2]),
    ]
    xyz = np.random.default_rng(0).normal(size=(900, 1, 4, 3))
    plots = [
        Plot("all", series, x_label="s", y_label="mm"),
        Plot("nothing", [Line("none", X, X * np.nan)], x_label="s", y_label="mm", equal=True),
    ]
    player = Player(np.arange(900) / 10, xyz, bones=np.array([[0, 1]]), sides=("left",), people=("a",), right_left=[(0, 1)])
    path = write_page(tmp_path_factory.mktemp("page") / "page.html", Page("title", [Plots(plots), player]))
    path.write_text(path.read_text(encoding="utf-8").replace("<head>", f"<head>{PROBE}"), encoding="utf-8")
    flags = (
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--window-size=1000,2400",
        "--virtual-time-budget=15000",
        "--dump-dom",
    )
    run = subprocess.run([BROWSER, *flags, path.as_uri()], capture_output=True, text=True, timeout=120)
    found = re.search(r'<pre id="report">(.*?)</pre>', run.stdout, re.DOTALL)
    assert found, run.stdout[-500:]
    return json.loads(html.unescape(found[1]))


def values(column):
    return np.array([np.nan if value is None else value for value in column], float)


def test_the_script_runs_without_errors_and_the_player_plays(seen):
    assert seen["errors"] == []
    assert 0 < seen["played"] < 900


def test_the_player_names_the_colours_of_the_sides(seen):
    """Its one bone is a left one: only the word of the legend is blue."""
    assert seen["blue"] > 8


def test_what_is_drawn_is_what_was_given(seen):
    line, band, dots, spikes, ticks = seen["drawn"][0]
    for one in (line, dots):
        np.testing.assert_allclose(values(one["x"]), X, atol=2e-3)
        np.testing.assert_allclose(values(one["y"]), GAP, atol=2e-3)
    known = GAP[np.isfinite(GAP)]
    assert sum(value is None for value in band["x"]) == 1
    assert (min(values(band["y"])[np.isfinite(values(band["y"]))]), np.nanmax(values(band["y"]))) == pytest.approx(
        (known.min() - 1, known.max() + 1), abs=2e-3
    )
    np.testing.assert_allclose(values(spikes["y"])[1::3], GAP, atol=2e-3)
    np.testing.assert_allclose(values(ticks["x"]), X[:2])


def test_names_stand_as_they_are(seen):
    assert seen["shown"] == NAME


def test_the_data_of_a_plot_can_be_saved(seen):
    head, *rows = csv.reader(seen["csv"].splitlines())
    assert head == ["s", NAME, "band low", "band high", "dots", "spikes low", "spikes high", "ticks, s"]
    table = np.array([[float(cell or "nan") for cell in row] for row in rows])
    expected = [X, GAP, GAP - 1, GAP + 1, GAP, GAP * 0, GAP, np.pad(X[:2], (0, 5), constant_values=np.nan)]
    np.testing.assert_allclose(table.T, expected, atol=2e-3)


class Printed:
    """What Chromium prints, by the structure that it writes into the PDF: which element has text on which page."""

    def __init__(self, path, target):
        flags = ("--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer", f"--print-to-pdf={target}")
        subprocess.run([BROWSER, *flags, path.as_uri()], capture_output=True, check=True, timeout=120)
        found = re.finditer(rb"(\d+) 0 obj\n(.*?)\nendobj", target.read_bytes(), re.DOTALL)
        self._objects = {int(one[1]): one[2] for one in found}
        self.pages = [n for n, one in self._objects.items() if b"/Type /Page\n" in one]
        [document] = (n for n, one in self._objects.items() if b"/S /Document" in one)
        self._texts = list(self._below(document, ()))

    def _below(self, number, above):
        """(elements that it is in, page) of every text, in reading order."""
        one = self._objects[number]
        kids = re.search(rb"/K (\[.*?\]|\d+ 0 R|\d+)", one, re.DOTALL)[1]
        path = (*above, (number, re.search(rb"/S /(\w+)", one)[1].decode()))
        for page, element, _ in re.findall(rb"/Pg (\d+) 0 R\s*/MCID \d+|(\d+) 0 R|(\d+)", kids):
            if element:
                yield from self._below(int(element), path)
            else:
                yield path, int(page or re.search(rb"/Pg (\d+)", one)[1])

    def split_tables(self):
        pages = {}
        for path, page in self._texts:
            for element in path:
                pages.setdefault(element, set()).add(page)
        return sum(len(found) > 1 for (_, kind), found in pages.items() if kind == "Table")

    def lonely_headings(self):
        """Headings that are not on one page with the note under them and what follows."""
        headings = [any(kind in ("H2", "H3") for _, kind in path) for path, _ in self._texts]
        pages = [page for _, page in self._texts]
        return sum(headings[k] and len(set(pages[k : k + 3])) > 1 for k in range(len(pages)))

    def margins(self):
        """Glyphs of each page that belong to no element of the document."""
        contents = [self._objects[int(re.search(rb"/Contents (\d+)", self._objects[page])[1])] for page in self.pages]
        streams = [zlib.decompress(one.split(b"stream\n", 1)[1].rsplit(b"\nendstream", 1)[0]) for one in contents]
        return [re.findall(rb"<([0-9A-F]+)> Tj", one.split(b"BDC")[0]) for one in streams]


@pytest.fixture(scope="module")
def long_page(tmp_path_factory):
    """Headings and tables everywhere on the sheets."""
    blocks = []
    for n in range(40):
        table = Table(["name", "value"], [[f"row {n}.{i}", float(i)] for i in range(n % 9)])
        blocks += [Heading(f"Heading {n}", "Its note."), Note("Some words. " * (37 * n % 90)), table]
    blocks += [block for n in range(150) for block in (Heading(f"Short {n}", "Its note."), Note("Words."))]
    return write_page(tmp_path_factory.mktemp("print") / "page.html", Page("title", blocks))


def test_printed_headings_stay_with_their_text_tables_stay_whole_and_pages_are_numbered(long_page, tmp_path):
    printed = Printed(long_page, tmp_path / "page.pdf")
    assert len(printed.pages) > 4
    assert (printed.split_tables(), printed.lonely_headings()) == (0, 0)
    numbers = [number for number, *_ in printed.margins()]
    assert len(set(numbers)) == len(numbers) and len({tuple(total) for _, *total in printed.margins()}) == 1


def test_the_checks_of_printing_can_fail(long_page, tmp_path):
    bare = tmp_path / "bare.html"
    bare.write_text(
        re.sub(r"break-(inside|after): avoid|@bottom-right", "x", long_page.read_text(encoding="utf-8")), encoding="utf-8"
    )
    printed = Printed(bare, tmp_path / "bare.pdf")
    assert printed.split_tables() and printed.lonely_headings() and not any(printed.margins())
