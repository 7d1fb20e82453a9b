"""Who may talk to the studio: token, Host and Origin checks, and headers that keep the page to itself.

The server listens on this machine only, but every web page the user visits can send requests to it. Three checks stand
against that: a random token that only the printed URL holds; the Host header, which a DNS-rebinding page cannot fake;
and the Origin header, which names the page that asks. No cookie is used, so no request carries authority by itself.
"""

from __future__ import annotations

import ipaddress
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import parse_qs

ASGIApp = Callable[..., Awaitable[None]]
Scope = MutableMapping[str, Any]

TOKEN_HEADER = b"x-keypose-token"


def is_loopback(host: str) -> bool:
    """Whether an address or name can only be reached from this machine."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def bracketed(host: str) -> str:
    """The host as it stands in a URL: IPv6 addresses in brackets."""
    return f"[{host}]" if ":" in host and not host.startswith("[") else host


class Guard:
    """Wraps the application; refuses what does not come from the studio's own page.

    ``host`` and ``port`` are what the server is bound to. A server that was deliberately bound to a wider address
    answers under every IP address (a rebinding page needs a name), and under that name if it is one.
    """

    def __init__(self, app: ASGIApp, *, token: str, host: str, port: int) -> None:
        self._app, self._token, self._port = app, token, port
        self._names = {"127.0.0.1", "localhost", "[::1]", bracketed(host)}
        self._any_address = not is_loopback(host)

    async def __call__(self, scope: Scope, receive: Any, send: Any) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers: dict[bytes, bytes] = dict(scope["headers"])
        refusal = self._refusal(scope, headers)
        if refusal:
            await _refuse(scope, receive, send, refusal)
            return

        async def guarded_send(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *self._headers(headers[b"host"])]
            await send(message)

        await self._app(scope, receive, guarded_send)

    def _refusal(self, scope: Scope, headers: dict[bytes, bytes]) -> str:
        host = headers.get(b"host", b"").decode("latin-1")
        if not self._known_host(host):
            return "this address is not the studio's"
        origin = headers.get(b"origin")
        if origin is not None and origin.decode("latin-1") != f"http://{host}":
            return "requests from other pages are refused"
        path: str = scope["path"]
        if headers.get(b"sec-fetch-site") == b"cross-site" and path != "/":
            return "requests from other pages are refused"
        if (path == "/" or path.startswith("/api/")) and not self._has_token(scope, headers):
            return "the session token is missing or wrong; open the URL that keypose printed"
        return ""

    def _known_host(self, host: str) -> bool:
        name, _, port = host.rpartition(":")
        if not name or port != str(self._port):
            return False
        if name in self._names:
            return True
        if not self._any_address:
            return False
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return True

    def _has_token(self, scope: Scope, headers: dict[bytes, bytes]) -> bool:
        given = headers.get(TOKEN_HEADER)
        if given is None:
            query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
            given = query.get("token", [""])[-1].encode("latin-1", "replace")
        return secrets.compare_digest(given, self._token.encode())

    @staticmethod
    def _headers(host: bytes) -> list[tuple[bytes, bytes]]:
        policy = (
            b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; font-src 'self'; "
            b"connect-src 'self' ws://" + host + b"; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )
        return [
            (b"content-security-policy", policy),
            (b"x-content-type-options", b"nosniff"),
            (b"referrer-policy", b"no-referrer"),
            (b"cross-origin-opener-policy", b"same-origin"),
            (b"cross-origin-resource-policy", b"same-origin"),
            (b"cache-control", b"no-store"),
        ]


async def _refuse(scope: Scope, receive: Any, send: Any, reason: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 4403, "reason": reason})
        return
    body = f"403: {reason}\n".encode()
    headers = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"content-length", str(len(body)).encode()),
        (b"x-content-type-options", b"nosniff"),
        (b"connection", b"close"),
    ]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": body})
