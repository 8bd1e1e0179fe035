"""Keys lie outside of workspaces, for this user only; what another user could have written is not read."""

import json
from pathlib import Path

import pytest

from posefuse_studio import private_files
from posefuse_studio.job_process import JobReporter
from posefuse_studio.jobs import JOBS_FOLDER, Jobs
from posefuse_studio.private_files import SessionAddress, private_folder, read_address, read_own, write_address, write_own
from posefuse_studio.workspace import StudioWorkspace

ADDRESS = SessionAddress(port=4711, key=bytes(range(32)))


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stands for the user's folder of state."""
    monkeypatch.setattr(private_files.platformdirs, "user_state_dir", lambda *_, **__: str(tmp_path / "state"))
    return tmp_path / "state"


@pytest.fixture
def workspace(tmp_path: Path) -> StudioWorkspace:
    (tmp_path / "lab").mkdir()
    return StudioWorkspace(tmp_path / "lab")


def test_a_key_is_outside_of_the_workspace_and_private(workspace: StudioWorkspace, state: Path) -> None:
    workspace.folder(f"{JOBS_FOLDER}/one")
    reporter = JobReporter(workspace, "one")
    assert Jobs(workspace).address("one") is None
    reporter.listens(ADDRESS)
    [file] = [path for path in state.rglob("*") if path.is_file()]
    assert file.stat().st_mode & 0o777 == 0o600 and private_folder().stat().st_mode & 0o777 == 0o700
    assert Jobs(workspace).address("one") == ADDRESS
    texts = [path.read_text(encoding="utf-8") for path in workspace.root.rglob("*") if path.is_file()]
    assert texts and not any(ADDRESS.key.hex() in text or "4711" in text for text in texts)
    reporter.end(state="done")
    assert Jobs(workspace).address("one") is None and not file.exists()


def test_an_address_is_of_one_job_in_one_workspace(tmp_path: Path) -> None:
    write_address(tmp_path / "a", "one", ADDRESS)
    assert read_address(tmp_path / "a", "one") == ADDRESS
    assert read_address(tmp_path / "b", "one") is None and read_address(tmp_path / "a", "two") is None


@pytest.mark.parametrize(
    "text", ["{", "[]", "{}", '{"port": 1}', '{"port": [], "key": "00"}', '{"port": 1, "key": "xy"}', "[" * 10**5]
)
def test_a_damaged_address_is_none(tmp_path: Path, state: Path, text: str) -> None:
    write_address(tmp_path, "one", ADDRESS)
    [file] = [path for path in state.rglob("*") if path.is_file()]
    file.write_text(text, encoding="utf-8")
    assert read_address(tmp_path, "one") is None


def test_what_another_user_has_written_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_own(tmp_path / "a.json", json.dumps({"a": 1}))
    assert read_own(tmp_path / "a.json") == {"a": 1}
    monkeypatch.setattr("os.geteuid", lambda: tmp_path.stat().st_uid + 1, raising=False)
    assert read_own(tmp_path / "a.json") == {}
    assert read_own(tmp_path) == {} and read_own(tmp_path / "missing.json") == {}
