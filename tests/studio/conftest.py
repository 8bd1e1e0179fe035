"""A workspace, and a studio in real Chromium for what only a browser can show."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from small_session import saved_session

from posefuse.core import Rig
from posefuse_studio.calibrations import Project, save_project
from posefuse_studio.setups import Setup, save_setup
from posefuse_studio.workspace import StudioWorkspace, write_stored


@pytest.fixture
def workspace(tmp_path: Path) -> StudioWorkspace:
    """An empty one."""
    (tmp_path / "lab").mkdir()
    return StudioWorkspace(tmp_path / "lab")


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A browser without a window; skipped, by name, where there is none.

    Of one module: while it is there, an event loop runs in this thread, and modules without a browser begin loops of their own.
    """
    from tools.studio_server import CHROMIUM, GRAPHICS

    if not Path(CHROMIUM).is_file():
        pytest.skip(f"needs {CHROMIUM}")
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=GRAPHICS)
        yield browser
        browser.close()


@pytest.fixture
def errors() -> list[str]:
    """What went wrong in the page of a test, the policy that it broke included."""
    return []


@pytest.fixture
def page(chromium: Any, errors: list[str]) -> Iterator[Any]:
    """A tab that must raise no error; what it waits for may take as long as a busy machine needs."""
    from tools.studio_server import PATIENCE_S, SIZES, cookies

    tab = chromium.new_page(viewport=dict(zip(("width", "height"), SIZES[""], strict=True)))
    tab.context.add_cookies(cookies())
    tab.set_default_timeout(PATIENCE_S * 1e3)
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.on("console", lambda line: errors.append(line.text) if "Content Security Policy" in line.text else None)
    yield tab
    tab.close()
    assert errors == []


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory, ring_rig: Callable[..., Rig]) -> Iterator[tuple[StudioWorkspace, str]]:
    """A workspace with a recording, a calibration that was begun and a live session, and the address of its studio."""
    from tools.studio_server import free_port, server, stand_in

    workspace, port = StudioWorkspace(tmp_path_factory.mktemp("lab")), free_port()
    saved_session(workspace.root, ring_rig)
    videos = {f"cam0{c}": f"video:walk/videos/cam0{c}.mp4" for c in range(3)}
    save_setup(workspace, Setup(name="webcams", sources=videos))
    write_stored(workspace.folder("targets") / "made.json", {})
    save_project(workspace, Project(name="room", setup="webcams", cube="a.toml", board="b.toml"))
    with server(workspace.root, port), stand_in(workspace.root, 4):
        yield workspace, f"http://127.0.0.1:{port}"
