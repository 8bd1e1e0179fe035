"""Keys lie outside of workspaces, for this user only; what another user could have written is not read."""

from pathlib import Path

import pytest

from posefuse_studio.job_process import JobReporter
from posefuse_studio.jobs import JOBS_FOLDER, Jobs
from posefuse_studio.workspace import SessionAddress, StudioWorkspace, address_file, private_folder, read_stored, write_stored

ADDRESS = SessionAddress(port=4711, key=bytes(range(32)))


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stands for the user's folder of state."""
    monkeypatch.setattr("posefuse_studio.workspace.platformdirs.user_state_dir", lambda *_, **__: str(tmp_path / "state"))
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
    write_stored(address_file(tmp_path / "a", "one"), ADDRESS)
    assert read_stored(address_file(tmp_path / "a", "one"), SessionAddress) == ADDRESS
    for workspace, job in (("b", "one"), ("a", "two")):
        assert read_stored(address_file(tmp_path / workspace, job), SessionAddress) is None


@pytest.mark.parametrize(
    "text", ["{", "[]", "{}", '{"port": 1}', '{"port": [], "key": "00"}', '{"port": 1, "key": "xy"}', "[" * 10**5]
)
def test_a_damaged_address_is_none(tmp_path: Path, text: str) -> None:
    file = address_file(tmp_path, "one")
    file.write_text(text, encoding="utf-8")
    assert read_stored(file, SessionAddress) is None


def test_what_another_user_has_written_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_stored(tmp_path / "a.json", {"a": 1})
    assert read_stored(tmp_path / "a.json", dict) == {"a": 1}
    monkeypatch.setattr("os.geteuid", lambda: tmp_path.stat().st_uid + 1, raising=False)
    for name in ("a.json", "", "missing.json"):
        assert read_stored(tmp_path / name, dict) is None
