"""Who may open the studio: who has a token, also on this machine; checked for every request and every websocket.

Any account of this machine can send requests to its loopback address: so a token is always needed. So can a page of another site:
the `Host` header must name an address the studio is bound to (against DNS rebinding), and the `Origin` header, where there is
one, must be the studio's own.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import re
import secrets
import socket
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal
from urllib.parse import quote, urlencode

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, Response

from posefuse.core import InputError

Role = Literal["owner", "viewer"]
COOKIE = "posefuse_studio"
# what a viewer's page is made of; everything else is the owner's
_VIEWER_PATHS = ("/phone", "/_nicegui/", "/_nicegui_ws/", "/studio/stream/live")
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
# what stands in an address and in a cookie as it is
_TOKEN = re.compile(r"[A-Za-z0-9._~-]{16,}")
_WRONG_S = 1.0
_log = logging.getLogger(__name__)
# scripts of the pages are inline, and their templates are compiled in the browser; but what runs there reaches this server alone
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; worker-src 'self' blob:; "
    "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {"x-frame-options": "DENY", "referrer-policy": "no-referrer", "x-content-type-options": "nosniff"}


@dataclass(frozen=True, kw_only=True)
class Access:
    """The rule.

    Attributes:
        host, port: what the server is bound to. token: of the owner. viewer_token: of the read-only phone page.
        names: what may stand in the `Host` header, without port, in small letters.
    """

    host: str
    port: int
    token: str
    viewer_token: str
    names: frozenset[str]

    @classmethod
    def of(cls, host: str, port: int, token: str = "") -> Access:
        """The rule for an address; a token is created if none is given. Raises InputError for a short one."""
        if token and not _TOKEN.fullmatch(token):
            raise InputError(
                f"token: expected at least 16 letters, digits, '.', '_', '~' or '-', got {len(token)} characters; leave it out"
                " for one made at random"
            )
        return cls(
            host=host,
            port=port,
            token=token or secrets.token_urlsafe(24),
            viewer_token=secrets.token_urlsafe(24),
            names=frozenset([*_LOOPBACK, *([] if is_loopback(host) else map(str.lower, own_names(host)))]),
        )

    def address(self, name: str = "") -> str:
        """The URL to open; `name`: of the machine as others reach it."""
        return f"http://{name or self.shown_name}:{self.port}/?{urlencode({'token': self.token})}"

    def phone_address(self, name: str) -> str:
        """The URL of the phone page."""
        return f"http://{name}:{self.port}/phone?{urlencode({'token': self.viewer_token})}"

    @property
    def shown_name(self) -> str:
        """The host as it stands in a URL on this machine."""
        return "127.0.0.1" if self.host in ("", "0.0.0.0", "::") else _bracketed(self.host)

    @property
    def network_names(self) -> list[str]:
        """Addresses under which a phone may reach the studio, those of a usual home or lab network first."""
        return sorted(self.names - set(_LOOPBACK), key=lambda name: (not name.startswith(("192.168.", "10.", "172.")), name))

    def refusal(self, headers: Mapping[str, str]) -> str:
        """Why a request with these headers (lower-case names) is refused; empty: it is not."""
        host = headers.get("host", "").lower()
        if host not in {f"{name}:{self.port}" for name in self.names} | ({*self.names} if self.port == 80 else set()):
            return f"host {host!r} is not an address of this studio"
        origin = headers.get("origin", "").lower()
        if origin and origin != f"http://{host}":
            return f"origin {origin!r} is not this studio"
        opened = headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document"
        if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none") and not opened:
            return "sent by a page of another site"
        return ""

    def role(self, given: Iterable[str]) -> Role | None:
        """What the tokens of a request allow; None: nothing."""
        tokens = [one for one in given if one]
        if any(_same(one, self.token) for one in tokens):
            return "owner"
        return "viewer" if any(_same(one, self.viewer_token) for one in tokens) else None


class AccessMiddleware:
    """Asks `access` before the application sees a request; a token in the URL moves into a cookie."""

    def __init__(self, app: Any, access: Access) -> None:
        self._app, self._access = app, access
        self._wrong, self._one_at_a_time = 0, asyncio.Lock()

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """See ASGI."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        request = HTTPConnection(scope)
        # cookies do not know ports: two studios on one machine must not take each other's
        cookie = f"{COOKIE}_{self._access.port}"
        in_url, in_cookie = request.query_params.get("token", ""), request.cookies.get(cookie, "")
        role, path = self._access.role([in_url, in_cookie]), scope["path"]
        why = self._access.refusal(request.headers)
        if why or role is None or (role == "viewer" and not may_view(path)):
            if not why and role is None and (in_url or in_cookie):
                await self._took_wrong(scope.get("client"))
            await _refuse(scope, receive, send, why or "a token is needed: open the address that `posefuse studio` has printed")
        elif scope["type"] == "http" and scope["method"] == "GET" and self._access.role([in_url]):
            await _to_cookie(path, f"{cookie}={in_url}")(scope, receive, send)
        else:
            await self._app(scope, receive, _guarded(send))

    async def _took_wrong(self, client: tuple[str, int] | None) -> None:
        """One wrong token a second, however many are tried at once; a line for the first, second, fourth, eighth ... of them."""
        async with self._one_at_a_time:
            self._wrong += 1
            if self._wrong.bit_count() == 1:
                _log.warning("wrong token from %s; %d so far", client[0] if client else "an unknown address", self._wrong)
            await asyncio.sleep(_WRONG_S)


def may_view(path: str) -> bool:
    """Whether a viewer may have this path."""
    return any(path == allowed or (allowed.endswith("/") and path.startswith(allowed)) for allowed in _VIEWER_PATHS)


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches it."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def own_names(host: str) -> list[str]:
    """Names and addresses under which others reach this machine when it is bound to `host`."""
    if host not in ("", "0.0.0.0", "::"):
        return [_bracketed(host)]
    import ifaddr

    addresses = [ip.ip if isinstance(ip.ip, str) else ip.ip[0] for adapter in ifaddr.get_adapters() for ip in adapter.ips]
    name = socket.gethostname()
    return [*(_bracketed(one) for one in addresses if not is_loopback(one)), name, f"{name}.local"]


def _same(one: str, other: str) -> bool:
    return secrets.compare_digest(one.encode(), other.encode())


def _guarded(send: Any) -> Any:
    """A page of another site cannot show the studio inside itself; a script that got into a page cannot send it elsewhere."""

    async def sending(message: dict[str, Any]) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.update(_HEADERS)
            # files of the workspace have a policy of their own, which is stricter
            headers.setdefault("content-security-policy", _POLICY)
        await send(message)

    return sending


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host and not host.startswith("[") else host


async def _refuse(scope: Any, receive: Any, send: Any, why: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": why[:100]})
    else:
        await PlainTextResponse(f"posefuse studio: {why}\n", status_code=403)(scope, receive, send)


def _to_cookie(path: str, cookie: str) -> Response:
    """Have the browser load the page again without the token in its address.

    By `refresh`, not by a redirect: a browser that comes from elsewhere, e.g. from a link in a message, would not send a strict
    cookie along a redirect.
    """
    # one slash: with two, or with a backslash, the rest would name another site
    location = "/" + quote(path.lstrip("/\\"))
    return Response(
        headers={"refresh": f"0; url={location}", "set-cookie": f"{cookie}; Path=/; HttpOnly; SameSite=Strict", **_HEADERS}
    )
