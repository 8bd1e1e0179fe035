"""A page in a real browser: its script draws what it was given, saves it, plays it, and reports no error. Needs Chromium."""

import csv
import html
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from posefuse.formats.page import (
    Band,
    Dots,
    Line,
    Page,
    Player,
    Plot,
    Plots,
    Spikes,
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
