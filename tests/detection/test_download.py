"""Downloads that survive: against a server that breaks off, lies, or is not there."""

import hashlib
import io
import threading
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
    """Serves files; breaks off after as many bytes as `break_off` lists; `asked` has the path of each request."""

    def __init__(self):
        self.files, self.break_off, self.asked = {}, [], []
        super().__init__(("127.0.0.1", 0), Handler)

    def url(self, name):
        return f"http://127.0.0.1:{self.server_address[1]}/{name}"


class Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        server = self.server
        server.asked.append(self.path)
        content = server.files.get(self.path.rpartition("/")[2])
        if content is None:
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content[: server.break_off.pop(0)] if server.break_off else content)

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
    def fetched(*urls):
        return downloaded(urls, tmp_path / "n.onnx", SHA)

    return fetched


def test_the_next_address_is_taken_where_one_is_dead_or_breaks_off(server, get):
    server.files["n.onnx"], server.break_off = CONTENT, [1_000_000]
    dead = "http://127.0.0.1:9/n.onnx"
    assert get(dead, server.url("absent.onnx"), server.url("n.onnx"), server.url("again/n.onnx")).read_bytes() == CONTENT
    assert len(server.asked) == 3


def test_a_file_that_never_comes_is_one_line_with_each_address_and_reason(server, get):
    server.files["n.onnx"], server.break_off = CONTENT, [100]
    said = r"absent.onnx: HTTP 404 .*n.onnx: broke off after 100 of 3000000 bytes"
    refusal(ModelError, said, get, server.url("absent.onnx"), server.url("n.onnx"))


def test_an_address_that_gives_nothing_leaves_nothing(get, tmp_path):
    refusal(ModelError, r"refused.*copy the cache folder", get, "http://127.0.0.1:9/n.onnx")
    assert not list(tmp_path.iterdir())


def test_another_file_is_refused_with_both_hashes(server, get):
    server.files["n.onnx"] = CONTENT[::-1]
    refusal(ModelError, f"expected sha256 {SHA}, got {hashlib.sha256(CONTENT[::-1]).hexdigest()}", get, server.url("n.onnx"))


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
    assert server.asked[0] == "http://models.invalid/n.onnx"
