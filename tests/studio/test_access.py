"""Tokens, hosts and origins: checked before the application sees a request or a websocket."""

import asyncio
from pathlib import Path
from typing import Any

import httpx
import pytest

from posefuse.studio.access import Access, AccessMiddleware, is_loopback, may_view
from posefuse.studio.pages.phone import record_or_stop
from posefuse.studio.state import Studio
from posefuse.studio.workspace import StudioWorkspace
from tools.studio_server import free_port, server

LOCAL = Access.of("127.0.0.1", 8765)
OPEN = Access(
    host="0.0.0.0", port=8765, token="own", viewer_token="look", names=frozenset({"127.0.0.1", "localhost", "192.168.1.7"})
)


def ask(access: Access, path: str = "/", query: str = "", kind: str = "http", **headers: str) -> list[dict[str, Any]]:
    """What a request gets; the application behind answers 200."""
    sent: list[dict[str, Any]] = []

    async def application(scope: dict[str, Any], receive: Any, send: Any) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def receive() -> dict[str, Any]:
        return {"type": "websocket.connect"}

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    lines = [(name.replace("_", "-").encode(), value.encode()) for name, value in ({"host": "127.0.0.1:8765"} | headers).items()]
    scope = {"type": kind, "method": "GET", "path": path, "query_string": query.encode(), "headers": lines}
    asyncio.run(AccessMiddleware(application, access)(scope, receive, send))
    return sent


def status(*args: Any, **kwargs: Any) -> int:
    return int(ask(*args, **kwargs)[0]["status"])


def test_this_machine_needs_no_token() -> None:
    assert LOCAL.token == "" and status(LOCAL) == 200


def test_beyond_loopback_there_always_is_a_token() -> None:
    assert len(Access.of("192.168.1.7", 8765).token) >= 20
    assert Access.of("192.168.1.7", 8765, "mine").token == "mine"
    assert status(OPEN) == 403 and status(OPEN, query="token=wrong") == 403


@pytest.mark.parametrize("host", ["evil.example:8765", "127.0.0.1", "127.0.0.1:80", "", "192.168.1.8:8765"])
def test_a_foreign_host_is_refused(host: str) -> None:
    assert status(LOCAL, host=host) == 403


def test_a_foreign_origin_is_refused_also_for_websockets() -> None:
    good, bad = {"origin": "http://127.0.0.1:8765"}, {"origin": "http://evil.example"}
    assert status(LOCAL, **good) == 200 and status(LOCAL, **bad) == 403
    assert ask(LOCAL, kind="websocket", **bad)[0]["type"] == "websocket.close"
    assert ask(LOCAL, kind="websocket", **good)[0]["type"] != "websocket.close"
    assert ask(OPEN, kind="websocket", **good)[0]["type"] == "websocket.close"


def test_a_page_of_another_site_cannot_embed_or_fetch_but_a_link_opens() -> None:
    assert status(LOCAL, sec_fetch_site="cross-site", sec_fetch_mode="no-cors", sec_fetch_dest="image") == 403
    assert status(LOCAL, sec_fetch_site="cross-site", sec_fetch_mode="navigate", sec_fetch_dest="iframe") == 403
    assert status(LOCAL, sec_fetch_site="cross-site", sec_fetch_mode="navigate", sec_fetch_dest="document") == 200
    assert (b"x-frame-options", b"DENY") in ask(LOCAL)[0]["headers"]


def test_a_token_moves_from_the_address_into_a_cookie() -> None:
    answer = ask(OPEN, "/live", "token=own")[0]
    headers = dict(answer["headers"])
    assert answer["status"] == 303 and headers[b"location"] == b"/live"
    cookie = headers[b"set-cookie"].decode()
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    assert status(OPEN, cookie=cookie.split(";")[0]) == 200
    assert status(OPEN, cookie="posefuse_studio_9999=own") == 403
    # never what somebody else wrote
    assert status(OPEN, query="token=x%0d%0aSet-Cookie:a=b", cookie=cookie.split(";")[0]) == 200


def test_a_redirect_stays_on_this_site() -> None:
    assert dict(ask(OPEN, "//evil.example/live", "token=own")[0]["headers"])[b"location"].startswith(b"/live")


def test_a_viewer_sees_the_phone_page_only() -> None:
    cookie = "posefuse_studio_8765=look"
    assert status(OPEN, "/phone", cookie=cookie) == 200
    assert [status(OPEN, path, cookie=cookie) for path in ("/", "/live", "/recordings", "/studio/file/x")] == [403] * 4
    assert may_view("/studio/stream/live") and not may_view("/studio/stream/other") and not may_view("/phonebook")


def test_loopback_addresses_are_known() -> None:
    assert [is_loopback(host) for host in ("127.0.0.1", "127.8.9.1", "localhost", "::1", "0.0.0.0", "192.168.1.7", "lab")] == [
        True, True, True, True, False, False, False,
    ]  # fmt: skip


def test_a_phone_records_only_where_the_owner_allows_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    studio, asked = Studio.of(StudioWorkspace(tmp_path), OPEN), list[str]()
    monkeypatch.setattr(studio.live, "ask", lambda request, **values: asked.append(request))
    record_or_stop(studio)
    assert asked == []
    studio.phone_may_record = True
    record_or_stop(studio)
    studio.live.status = {"recording": {"folder": "recordings/walk"}}
    record_or_stop(studio)
    assert asked == ["record", "stop_recording"]
    studio.phone_may_record = False
    record_or_stop(studio)
    assert asked == ["record", "stop_recording"]


@pytest.mark.slow
def test_beyond_this_machine_a_token_is_demanded_and_host_and_origin_are_checked(tmp_path: Path) -> None:
    """From an address of this machine that is not loopback, as another machine comes; with the real server."""
    address = outward_address()
    if not address:
        pytest.skip("this machine has no address besides loopback")
    port, token = free_port(), "own-token"
    base = f"http://{address}:{port}"
    with server(tmp_path, port, "--host", "0.0.0.0", "--token", token), httpx.Client(timeout=30) as client:
        assert client.get(base).status_code == 403
        assert "token is needed" in client.get(base).text
        assert client.get(f"{base}/?token=wrong").status_code == 403
        moved = client.get(f"{base}/live?token={token}")
        assert moved.status_code == 303 and moved.headers["location"] == "/live" and "HttpOnly" in moved.headers["set-cookie"]
        assert client.get(f"{base}/simulate").status_code == 200  # the cookie is enough now
        assert client.get(f"{base}/simulate", headers={"host": f"evil.example:{port}"}).status_code == 403
        assert client.get(f"{base}/simulate", headers={"origin": "http://evil.example"}).status_code == 403
        # loopback, too, is no way around the token
        assert httpx.get(f"http://127.0.0.1:{port}/").status_code == 403


def outward_address() -> str:
    """An IPv4 address of this machine under which others reach it; empty where there is none."""
    import ifaddr

    found = [ip.ip for adapter in ifaddr.get_adapters() for ip in adapter.ips if isinstance(ip.ip, str)]
    return next((ip for ip in found if not is_loopback(ip)), "")
