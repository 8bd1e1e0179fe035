"""Tokens, hosts and origins: checked before the application sees a request or a websocket."""

import asyncio
import signal
import threading
import time
from pathlib import Path
from typing import Any

import httpx
import ifaddr
import pytest
from checks import refusal
from marked import ON_LINUX

from posefuse.core import InputError
from posefuse_studio import access as rules
from posefuse_studio.access import Access, AccessMiddleware, is_loopback, may_view
from posefuse_studio.pages.live import record_or_stop
from posefuse_studio.session import SessionStatus
from posefuse_studio.state import Studio
from posefuse_studio.workspace import StudioWorkspace
from tools.studio_server import PATIENCE_S, TOKEN, free_port, server

OWN, LOOK = "owner-of-the-tests", "viewer-of-the-tests"
LOCAL = Access(host="127.0.0.1", port=8765, token=OWN, viewer_token=LOOK, names=Access.of("127.0.0.1", 8765).names)
OPEN = Access(host="0.0.0.0", port=8765, token=OWN, viewer_token=LOOK, names=frozenset({"127.0.0.1", "localhost", "192.168.1.7"}))


@pytest.fixture(autouse=True)
def waits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """How long wrong tokens were made to wait, s; here they are not."""
    waited: list[float] = []

    waiting = threading.Lock()
    give_way = asyncio.sleep

    async def sleep(seconds: float) -> None:
        # two that wait at once are two guesses a second
        assert waiting.acquire(blocking=False)
        waited.append(seconds)
        await give_way(0)
        waiting.release()

    monkeypatch.setattr(rules.asyncio, "sleep", sleep)
    return waited


def guarded(access: Access, *headers: tuple[bytes, bytes]) -> AccessMiddleware:
    """An application that answers 200 with these headers, and its guard."""

    async def application(scope: dict[str, Any], receive: Any, send: Any) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": [*headers]})

    return AccessMiddleware(application, access)


def ask(access: Access | AccessMiddleware, *where: str, cookie: str | None = OWN, **headers: str) -> dict[str, Any]:
    """What a request gets first, with the token of a cookie; the application behind answers 200."""
    if cookie is not None:
        headers["cookie"] = cookie if "=" in cookie else f"posefuse_studio_8765={cookie}"
    guard = access if isinstance(access, AccessMiddleware) else guarded(access)
    return asyncio.run(asked(guard, headers, *where))


async def asked(
    guard: AccessMiddleware, headers: dict[str, str], path: str = "/", query: str = "", kind: str = "http"
) -> dict[str, Any]:
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "websocket.connect"}

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    lines = [(name.replace("_", "-").encode(), value.encode()) for name, value in ({"host": "127.0.0.1:8765"} | headers).items()]
    about = {"type": kind, "method": "GET", "path": path, "query_string": query.encode(), "client": ("1.2.3.4", 5)}
    await guard({**about, "headers": lines}, receive, send)
    return sent[0]


def status(*args: Any, **kwargs: Any) -> int:
    return int(ask(*args, **kwargs)["status"])


def closes(access: Access, **headers: Any) -> bool:
    """Whether a websocket is refused."""
    return bool(ask(access, "/", "", "websocket", **headers)["type"] == "websocket.close")


def test_a_token_is_always_needed_also_on_this_machine() -> None:
    for host in ("127.0.0.1", "localhost", "192.168.1.7"):
        assert len(Access.of(host, 8765).token) >= 20 and Access.of(host, 8765).token != Access.of(host, 8765).token
    assert "token=" in Access.of("127.0.0.1", 8765).address()
    for access in (LOCAL, OPEN):
        assert status(access) == 200
        assert status(access, cookie=None) == 403 and status(access, cookie="wrong") == 403 and status(access, cookie="") == 403
        assert closes(access, cookie=None)


def test_a_token_that_can_be_guessed_is_refused() -> None:
    assert Access.of("127.0.0.1", 8765, "sixteen-letters_").token == "sixteen-letters_"
    for token in ("a", "fifteen-letters", "seventeen;letters", "a token with spaces", "ein Schlüssel für uns"):
        refusal(InputError, "at least 16", Access.of, "127.0.0.1", 8765, token)


def test_wrong_tokens_wait_for_each_other_and_are_noted(waits: list[float], caplog: pytest.LogCaptureFixture) -> None:
    guard, ways = guarded(LOCAL), [("token=wrong", {}), ("", {"cookie": "posefuse_studio_8765=wrong"})]

    async def try_many() -> None:
        await asyncio.gather(*(asked(guard, headers, "/", query) for query, headers in ways * 50))

    asyncio.run(try_many())
    assert waits == [rules._WRONG_S] * 100 and rules._WRONG_S >= 1
    assert [line.split("; ")[1] for line in caplog.messages] == [f"{n} so far" for n in (1, 2, 4, 8, 16, 32, 64)]
    assert "1.2.3.4" in caplog.text and "=wrong" not in caplog.text
    # those who have none, or the right one, do not wait
    assert status(guard, cookie=None) == 403 and status(guard) == 200 and len(waits) == 100


@pytest.mark.parametrize("host", ["evil.example:8765", "127.0.0.1", "127.0.0.1:80", "", "192.168.1.8:8765"])
def test_a_foreign_host_is_refused(host: str) -> None:
    assert status(LOCAL, host=host) == 403


def test_a_foreign_origin_is_refused_also_for_websockets() -> None:
    good, bad = {"origin": "http://127.0.0.1:8765"}, {"origin": "http://evil.example"}
    assert status(LOCAL, **good) == 200 and status(LOCAL, **bad) == 403
    assert closes(LOCAL, **bad) and closes(OPEN, cookie=None, **good) and not closes(LOCAL, **good)


def test_a_page_of_another_site_cannot_embed_or_fetch_but_a_link_opens() -> None:
    for mode, where, answer in (("no-cors", "image", 403), ("navigate", "iframe", 403), ("navigate", "document", 200)):
        assert status(LOCAL, sec_fetch_site="cross-site", sec_fetch_mode=mode, sec_fetch_dest=where) == answer
    assert (b"x-frame-options", b"DENY") in ask(LOCAL)["headers"]


def test_a_script_in_a_page_can_send_nothing_elsewhere() -> None:
    policy = dict(ask(LOCAL)["headers"])[b"content-security-policy"].decode()
    assert "connect-src 'self';" in policy and "default-src 'self';" in policy and "form-action 'none'" in policy
    assert "http" not in policy and "*" not in policy


def test_a_file_keeps_its_own_stricter_policy() -> None:
    headers = ask(guarded(LOCAL, (b"content-security-policy", b"sandbox")))["headers"]
    assert [value for name, value in headers if name == b"content-security-policy"] == [b"sandbox"]


def test_a_token_moves_from_the_address_into_a_cookie() -> None:
    answer = ask(OPEN, "/live", f"token={OWN}", cookie=None)
    headers = dict(answer["headers"])
    assert answer["status"] == 200 and headers[b"refresh"] == b"0; url=/live"
    cookie = headers[b"set-cookie"].decode()
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    assert status(OPEN, cookie=cookie.split(";")[0]) == 200
    assert status(OPEN, cookie=f"posefuse_studio_9999={OWN}") == 403
    # never what somebody else wrote
    assert b"set-cookie" not in dict(ask(OPEN, "/", "token=x%0d%0aSet-Cookie:a=b")["headers"])


@pytest.mark.parametrize(
    ("path", "moved"),
    [
        ("//evil.example/live", b"/evil.example/live"),
        ("/\\evil.example", b"/evil.example"),
        ("/\\/evil.example", b"/evil.example"),
        ("/\u20ac", b"/%E2%82%AC"),
        ("/a\r\nset-cookie: a", b"/a%0D%0Aset-cookie%3A%20a"),
        ("/a; url=//evil.example", b"/a%3B%20url%3D//evil.example"),
    ],
)
def test_the_way_to_the_cookie_stays_on_this_site(path: str, moved: bytes) -> None:
    assert dict(ask(OPEN, path, f"token={OWN}")["headers"])[b"refresh"] == b"0; url=" + moved


def test_a_viewer_sees_the_phone_page_only() -> None:
    assert status(OPEN, "/phone", cookie=LOOK) == 200
    assert [status(OPEN, path, cookie=LOOK) for path in ("/", "/live", "/recordings", "/studio/file/x")] == [403] * 4
    assert may_view("/studio/stream/live") and not may_view("/studio/stream/other") and not may_view("/phonebook")


def test_loopback_addresses_are_known() -> None:
    assert [is_loopback(host) for host in ("127.0.0.1", "127.8.9.1", "localhost", "::1", "0.0.0.0", "192.168.1.7", "lab")] == [
        True, True, True, True, False, False, False,
    ]  # fmt: skip


def test_a_phone_records_only_where_the_owner_allows_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    studio, requests = Studio(StudioWorkspace(tmp_path), OPEN), list[str]()
    monkeypatch.setattr(studio.live, "ask", lambda request, **values: requests.append(request))
    for allowed, recording in ((False, ""), (True, ""), (True, "recordings/walk"), (False, "recordings/walk")):
        studio.phone_may_record, studio.live.status = allowed, SessionStatus(recording=recording)
        record_or_stop(studio)
    assert requests == ["record", "stop_recording"]


@pytest.mark.slow
def test_beyond_this_machine_a_token_is_demanded_and_host_and_origin_are_checked(tmp_path: Path) -> None:
    """From an address of this machine that is not loopback, as another machine comes; with the real server."""
    found = [ip.ip for adapter in ifaddr.get_adapters() for ip in adapter.ips if isinstance(ip.ip, str)]
    address = next((ip for ip in found if not is_loopback(ip)), "") or pytest.skip("this machine has no address besides loopback")
    port, token = free_port(), TOKEN
    base = f"http://{address}:{port}"
    with server(tmp_path, port, "--host", "0.0.0.0"), httpx.Client(timeout=30) as client:
        assert client.get(base).status_code == 403
        assert "token is needed" in client.get(base).text
        assert client.get(f"{base}/?token=wrong").status_code == 403
        moved = client.get(f"{base}/live?token={token}")
        assert moved.headers["refresh"] == "0; url=/live" and "HttpOnly" in moved.headers["set-cookie"]
        assert client.get(f"{base}/simulate").status_code == 200  # the cookie is enough now
        assert client.get(f"{base}/simulate", headers={"host": f"evil.example:{port}"}).status_code == 403
        assert client.get(f"{base}/simulate", headers={"origin": "http://evil.example"}).status_code == 403
        # loopback, too, is no way around the token
        assert httpx.get(f"http://127.0.0.1:{port}/").status_code == 403


@ON_LINUX
def test_ctrl_c_twice_ends_the_server_without_a_trace(tmp_path: Path) -> None:
    port, log = free_port(), tmp_path / "printed.txt"
    with server(tmp_path, port, log=log) as process:
        assert httpx.get(f"http://127.0.0.1:{port}", timeout=PATIENCE_S).status_code == 403
        process.send_signal(signal.SIGINT)
        # within the time that the server gives to its connections
        time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
    printed = log.read_text(encoding="utf-8")
    assert "stopped by Ctrl-C" in printed and "Traceback" not in printed, printed
