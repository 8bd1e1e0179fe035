"""Downloads that survive: against a server that breaks off, lies, or is not there."""

import hashlib
import io
import subprocess
import sys
import threading
import time
import zipfile
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from checks import refusal

from posefuse.core import ModelError
from posefuse.detection.card import read_card
from posefuse.detection.download import UrlSource, downloaded
from posefuse.detection.files import fetch_all, model_path, status

CONTENT = np.random.default_rng(0).bytes(3_000_000)
SHA = hashlib.sha256(CONTENT).hexdigest()


class Server(ThreadingHTTPServer):
    """Serves files; breaks off after as many bytes as `break_off` lists; `asked` has the path and range of each request."""

    def __init__(self):
        self.files, self.break_off, self.asked, self.ranges, self.status = {}, [], [], True, 0
        super().__init__(("127.0.0.1", 0), Handler)

    def url(self, name):
        return f"http://127.0.0.1:{self.server_address[1]}/{name}"


class Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        server = self.server
        wanted = self.headers.get("Range")
        server.asked.append((self.path, wanted))
        content = server.files.get(self.path.rpartition("/")[2])
        if content is None or server.status:
            self.send_error(server.status or 404)
            return
        begin = int(wanted.removeprefix("bytes=").rstrip("-")) if wanted and server.ranges else 0
        if begin >= len(content):
            self.send_error(416)
            return
        self.send_response(206 if begin else 200)
        self.send_header("Content-Length", str(len(content) - begin))
        self.end_headers()
        until = begin + server.break_off.pop(0) if server.break_off else len(content)
        self.wfile.write(content[begin:until])

    def log_message(self, *_): ...


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    running = Server()
    threading.Thread(target=running.serve_forever, daemon=True).start()
    yield running
    running.shutdown()
    running.server_close()


@pytest.fixture
def get(tmp_path):
    def fetched(*urls, sha256=SHA, most=10_000_000):
        return downloaded(urls, tmp_path / "n.onnx", sha256, most, pause=lambda _: None)

    return fetched


def test_a_download_that_breaks_off_is_resumed(server, get, tmp_path):
    server.files["n.onnx"], server.break_off = CONTENT, [1_000_000, 700_000]
    assert get(server.url("n.onnx")).read_bytes() == CONTENT
    assert [wanted for _, wanted in server.asked] == [None, "bytes=1000000-", "bytes=1700000-"]
    assert [path.name for path in tmp_path.iterdir()] == ["n.onnx"]


def test_a_server_that_cannot_resume_gives_it_again(server, get):
    server.files["n.onnx"], server.break_off, server.ranges = CONTENT, [1_000_000], False
    assert get(server.url("n.onnx")).read_bytes() == CONTENT


def test_the_next_address_is_taken_where_one_is_dead(server, get):
    server.files["n.onnx"] = CONTENT
    dead = "http://127.0.0.1:9/n.onnx"
    assert get(dead, server.url("absent.onnx"), server.url("n.onnx")).read_bytes() == CONTENT


def test_a_file_that_never_comes_is_one_line_with_each_address_and_reason(server, get, tmp_path):
    server.files["n.onnx"], server.break_off = CONTENT, [100] * 20
    said = r"absent.onnx: HTTP 404 .*n.onnx: broke off after 400 of 3000000 bytes"
    refusal(ModelError, said, get, server.url("absent.onnx"), server.url("n.onnx"))
    # and the next run goes on
    server.break_off = []
    assert get(server.url("n.onnx")).read_bytes() == CONTENT
    assert server.asked[-1][1] == "bytes=400-"


def test_an_address_that_gives_nothing_leaves_nothing(get, tmp_path):
    refusal(ModelError, r"refused.*copy the cache folder", get, "http://127.0.0.1:9/n.onnx")
    assert not list(tmp_path.iterdir())


def test_another_file_is_refused_with_both_hashes_and_not_kept(server, get, tmp_path):
    server.files["n.onnx"] = CONTENT[::-1]
    refusal(ModelError, f"expected sha256 {SHA}, got {hashlib.sha256(CONTENT[::-1]).hexdigest()}", get, server.url("n.onnx"))
    assert not (tmp_path / "n.onnx").exists()
    server.files["n.onnx"] = CONTENT
    assert get(server.url("n.onnx")).read_bytes() == CONTENT


def test_a_beginning_of_another_file_is_thrown_away(server, get, tmp_path):
    server.files["n.onnx"] = CONTENT
    for beginning in (b"something else", CONTENT + b"more"):
        (tmp_path / "n.onnx.part").write_bytes(beginning)
        assert get(server.url("n.onnx")).read_bytes() == CONTENT


def test_more_than_the_card_states_is_not_received(server, get, tmp_path):
    server.files["n.onnx"] = CONTENT
    refusal(ModelError, "expected at most 1000 bytes, got 3000000", lambda: get(server.url("n.onnx"), most=1000))


def test_a_server_in_trouble_is_asked_again(server, get):
    server.files["n.onnx"], server.status = CONTENT, 503
    refusal(ModelError, "Service Unavailable", lambda: get(server.url("n.onnx")))
    assert len(server.asked) == 4


def command(server, folder):
    """A process of its own that downloads."""
    call = f"downloaded([{server.url('n.onnx')!r}], Path({str(folder / 'n.onnx')!r}), {SHA!r}, 10_000_000)"
    return [sys.executable, "-c", f"from pathlib import Path; from posefuse.detection.download import downloaded; {call}"]


def test_two_processes_at_once_end_with_one_whole_file(server, tmp_path):
    server.files["n.onnx"], server.break_off = CONTENT, [500_000] * 3
    both = [subprocess.Popen(command(server, tmp_path)) for _ in range(2)]
    assert [one.wait(120) for one in both] == [0, 0]
    assert (tmp_path / "n.onnx").read_bytes() == CONTENT
    assert [path.name for path in tmp_path.iterdir()] == ["n.onnx"]


def test_a_download_that_was_killed_is_resumed(server, tmp_path):
    server.files["n.onnx"], server.break_off = CONTENT, [1_500_000] + [0] * 9
    running, part = subprocess.Popen(command(server, tmp_path)), tmp_path / "n.onnx.part"
    while not part.is_file() or part.stat().st_size < 1_500_000:
        time.sleep(0.05)
    running.kill()
    running.wait(60)
    server.break_off = []
    subprocess.run(command(server, tmp_path), check=True, timeout=120)
    assert (tmp_path / "n.onnx").read_bytes() == CONTENT
    assert (server.asked[-1][1] or "").startswith("bytes=1500000")


def archive(**members):
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as packed:
        for name, content in members.items():
            packed.writestr(name.replace("__", "/").replace("_onnx", ".onnx"), content)
    return made.getvalue()


@pytest.fixture
def card(server):
    whole = archive(d20230831__m__end2end_onnx=CONTENT, _etc__foreign=b"outside")
    server.files["m.zip"] = whole
    source = UrlSource(urls=(server.url("m.zip"),), member="end2end.onnx", archive_sha256=hashlib.sha256(whole).hexdigest())
    return replace(read_card("rtmpose_m"), source=source)


@pytest.fixture
def unhashed(card):
    """Where no source states a hash."""
    return replace(card, source=replace(card.source, archive_sha256=""))


def test_an_archive_gives_its_network_and_nothing_else(server, card, tmp_path):
    """Files that it names elsewhere are never written."""
    assert fetch_all([card], tmp_path, terms=True)[0].read_bytes() == CONTENT
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == ["m.onnx"]
    assert status(card, tmp_path) == "ready"
    assert len(server.asked) == 1
    # a second time nothing is asked, and terms that were accepted once stay accepted
    assert fetch_all([card], tmp_path) == [model_path(card, tmp_path)]
    assert len(server.asked) == 1
    server.files["m.zip"] = archive(end2end_onnx=b"another")
    refusal(ModelError, "expected sha256", fetch_all, [card], tmp_path / "cache", terms=True)


def test_two_networks_of_that_name_in_one_archive_are_none(server, unhashed, tmp_path):
    server.files["m.zip"] = archive(a__end2end_onnx=b"1", b__end2end_onnx=b"2")
    refusal(ModelError, r"holds no end2end\.onnx", fetch_all, [unhashed], tmp_path, terms=True)


def test_a_proxy_of_the_environment_is_asked(server, get, monkeypatch):
    server.files["n.onnx"] = CONTENT
    for name in ("NO_PROXY", "no_proxy"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("http_proxy", server.url("").rstrip("/"))
    assert get("http://models.invalid/n.onnx").read_bytes() == CONTENT
    assert server.asked[0][0] == "http://models.invalid/n.onnx"
