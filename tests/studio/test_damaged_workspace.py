"""Files that are damaged, missing or oddly named never cost a page: in real Chromium, with a real server."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tools.studio_server import SIZES, free_port, server

pytestmark = pytest.mark.slow
LONG = "n" * 200
# as text among other properties of an element this would be two of them
QUOTED = 'a\' b" data-more="1'
JOBS = ".posefuse-studio/jobs"
CHECK = {"name": "enough views", "passed": True, "detail": "", "remedy": ""}
PASSED = {"passed": True, "cameras": ["a"], "reports": [{"subject": "rig", "checks": [CHECK], "numbers": {}}]}
PROJECT = {"setup": "outside", "cube": "c.toml", "board": "b.toml"}


def job(work: str, title: str, arguments: Any) -> dict[str, Any]:
    return {"work": work, "title": title, "arguments": arguments}


FILES: dict[str, Any] = {
    # recordings
    "recordings/walk/recording.mcap": "no MCAP file",
    "recordings/empty/recording.mcap": "",
    f"{LONG}/recording.mcap": "",
    f"{QUOTED}/recording.mcap": "",
    f"{QUOTED}/cam.mp4": "",
    "results/half/recording.json": "{",
    "results/other/recording.json": {},
    # presets: damaged, of another kind, leading out
    "setups/half.json": "{",
    "setups/list.json": [],
    "setups/number.json": {"sources": {"a": 7}},
    "setups/outside.json": {"sources": {"a": "video:../secret.mp4"}, "rig": "gone.toml"},
    # calibrations: of a preset that was deleted; with a rig file that is gone; with results of another kind
    "calibrations/bare/project.json": {"setup": "deleted", "cube": "", "board": ""},
    "calibrations/gone/project.json": PROJECT,
    "calibrations/gone/extrinsics.json": PASSED,
    "calibrations/kind/project.json": PROJECT,
    "calibrations/kind/extrinsics.json": {"passed": True},
    "calibrations/kind/verify.json": {"passed": False, "reports": [{}]},
    "calibrations/kind/extrinsics-1/coverage.json": {"cameras": ["a"]},
    # a recording that failed
    "calibrations/broken/project.json": PROJECT,
    f"{JOBS}/20260101-000003-watch/job.json": job("watch", "Recording x", {"folder": "calibrations/broken", "record": "x"}),
    f"{JOBS}/20260101-000003-watch/state.json": {"state": "failed", "error": "camera a: is used by another program"},
    # a link that a browser would run
    f"{JOBS}/20260101-000004-report/job.json": job("report", "Script", {}) | {"page": "javascript:document.title='ran'"},
    f"{JOBS}/20260101-000004-report/state.json": {"state": "done"},
    # jobs: not written to the end; with values of other kinds
    f"{JOBS}/20260101-000000-live/job.json": "{",
    f"{JOBS}/20260101-000001-report/job.json": {"id": "20260101-000001-report", "work": "report", "title": LONG, "arguments": {}},
    f"{JOBS}/20260101-000001-report/state.json": {"state": "done", "reported_s": "yesterday", "news": 5},
    f"{JOBS}/20260101-000002-report/job.json": {"id": "x", "work": "report", "title": "t", "arguments": 3},
    "plans/half.yaml": ": : :",
}
# by address, what is shown in the end
PAGES = {
    "/": "Your cameras",
    "/calibrate": "What to do next",
    "/live": "Start a session",
    "/recordings": "results/half",
    "/recordings?open=recordings/walk/recording.mcap": "cannot be read as MCAP",
    "/recordings?open=../secret.txt": "expected a path inside the workspace",
    f"/recordings?open={LONG}{LONG}": "not in the workspace",
    "/simulate": "Expected of these cameras",
    "/phone": "no session runs",
}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """The address of a studio whose workspace has all of `FILES`, and what its server prints."""
    place: Path = tmp_path_factory.mktemp("lab")
    (place / "secret.txt").write_text("secret", encoding="utf-8")
    for name, content in FILES.items():
        path = place / "workspace" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    port, log = free_port(), place / "log.txt"
    with server(place / "workspace", port, log=log):
        yield f"http://127.0.0.1:{port}", log


@pytest.mark.parametrize("size", SIZES.values(), ids=["desk", "phone"])
@pytest.mark.parametrize("path", PAGES)
def test_every_page_opens_and_fits_into_its_window(page: Any, lab: tuple[str, Path], path: str, size: tuple[int, int]) -> None:
    base, log = lab
    failed: list[str] = []
    page.on("response", lambda answer: failed.append(answer.url) if answer.status >= 500 else None)
    page.set_viewport_size(dict(zip(("width", "height"), size, strict=True)))
    page.goto(base + path)
    page.get_by_text(PAGES[path]).first.wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
    assert failed == []
    assert "Traceback" not in log.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("path", "label", "option", "shown"),
    [
        ("/calibrate", "Calibration", "bare", "The preset deleted is missing"),
        ("/calibrate", "Calibration", "gone", "rig.toml"),
        ("/calibrate", "Calibration", "kind", "Move the cube"),
        ("/calibrate", "Calibration", "broken", "used by another program"),
        # leads out of the workspace
        ("/", "Preset", "outside", "video:../secret.mp4"),
    ],
)
def test_what_is_chosen_is_shown_with_what_is_missing(
    page: Any, lab: tuple[str, Path], path: str, label: str, option: str, shown: str
) -> None:
    page.goto(f"{lab[0]}{path}")
    page.get_by_label(label, exact=True).click()
    page.get_by_role("option", name=option, exact=True).click()
    page.get_by_text(shown).first.wait_for()
    assert "Traceback" not in lab[1].read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("path", "label"),
    [("/recordings", f"Open {QUOTED}/recording.mcap"), ("/", f"Add {QUOTED}/cam.mp4")],
    ids=["recording", "video"],
)
def test_a_file_name_with_quotes_is_a_name_alone(page: Any, lab: tuple[str, Path], path: str, label: str) -> None:
    page.goto(f"{lab[0]}{path}")
    page.wait_for_function(
        "(label) => [...document.querySelectorAll('[aria-label]')].some((one) => one.ariaLabel === label)", arg=label
    )
    assert page.locator("[data-more]").count() == 0


def test_no_link_of_a_job_runs_in_the_browser(page: Any, lab: tuple[str, Path]) -> None:
    page.goto(lab[0])
    page.get_by_role("button", name="Jobs").click()
    link = page.get_by_role("link", name="Script", exact=True)
    link.wait_for()
    assert link.get_attribute("href") == "/recordings"


def test_the_button_that_closes_a_refusal_has_the_colour_of_its_words(page: Any, lab: tuple[str, Path]) -> None:
    page.goto(lab[0])
    page.get_by_role("button", name="Show images").click()
    shown = page.locator(".q-notification")
    colours = [one.evaluate("(one) => getComputedStyle(one).color") for one in (shown, shown.get_by_role("button", name="Close"))]
    assert colours[0] == colours[1]
