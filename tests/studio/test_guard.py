"""Who may talk to the studio."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from keypose.studio.guard import Guard, is_loopback

TOKEN = "right"


def ask(
    path: str = "/",
    *,
    query: str = f"token={TOKEN}",
    headers: dict[str, str] | None = None,
    host: str = "127.0.0.1",
    kind: str = "http",
) -> list[dict[str, Any]]:
    """What a guarded application answers to one request; without the guard's refusal it says 200."""
    sent: list[dict[str, Any]] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def receive() -> dict[str, Any]:
        return {"type": "websocket.connect"}

    async def send(message: Any) -> None:
        sent.append(message)

    given = {"host": "127.0.0.1:8000", **(headers or {})}
    scope = {
        "type": kind,
        "path": path,
        "query_string": query.encode(),
        "headers": [(k.encode(), v.encode()) for k, v in given.items()],
    }
    asyncio.run(Guard(app, token=TOKEN, host=host, port=8000)(scope, receive, send))
    return sent


def status(*arguments: Any, **options: Any) -> int:
    return int(ask(*arguments, **options)[0]["status"])


def test_the_right_token_opens_the_page() -> None:
    assert status() == 200
    assert status("/api/scenes/s1", query="", headers={"x-keypose-token": TOKEN}) == 200


@pytest.mark.parametrize("query", ["", "token=wrong", "token=", "token=right&token=wrong", "Token=right"])
@pytest.mark.parametrize("path", ["/", "/api/scenes/s1", "/api/events", "/api/"])
def test_without_it_nothing_opens(path: str, query: str) -> None:
    assert status(path, query=query) == 403


def test_a_wrong_header_is_not_saved_by_a_right_query() -> None:
    assert status("/api/scenes/s1", headers={"x-keypose-token": "wrong"}) == 403


@pytest.mark.parametrize("host", ["evil.example:8000", "127.0.0.1", "127.0.0.1:8001", "127.0.0.1.evil.example:8000", "", ":8000", "0.0.0.0:8000"])  # fmt: skip
def test_a_name_that_only_points_here_is_refused(host: str) -> None:
    assert status(headers={"host": host}) == 403
    assert status("/assets/a.js", headers={"host": host}) == 403


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "localhost:8000", "[::1]:8000"])
def test_names_of_this_machine_are_accepted(host: str) -> None:
    assert status(headers={"host": host}) == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:8000", "http://127.0.0.1:8001", "http://localhost:8000"])  # fmt: skip
def test_requests_from_other_pages_are_refused(origin: str) -> None:
    assert status("/api/scenes", headers={"origin": origin}) == 403


def test_requests_from_the_own_page_are_accepted() -> None:
    assert status("/api/scenes", headers={"origin": "http://127.0.0.1:8000"}) == 200


def test_a_cross_site_embedding_is_refused_but_a_link_is_not() -> None:
    assert status("/assets/a.js", headers={"sec-fetch-site": "cross-site"}) == 403
    assert status("/", headers={"sec-fetch-site": "cross-site"}) == 200


def test_a_refused_websocket_is_closed_before_it_opens() -> None:
    sent = ask("/api/events", query="token=wrong", kind="websocket")
    assert [m["type"] for m in sent] == ["websocket.close"]


def test_every_answer_carries_the_policy() -> None:
    headers = dict(ask()[0]["headers"])
    policy = headers[b"content-security-policy"].decode()
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert headers[b"x-content-type-options"] == b"nosniff"
    assert headers[b"referrer-policy"] == b"no-referrer"


def test_a_studio_opened_to_the_network_answers_under_addresses_only() -> None:
    assert status(host="0.0.0.0", headers={"host": "192.168.1.7:8000"}) == 200
    assert status(host="0.0.0.0", headers={"host": "evil.example:8000"}) == 403
    assert status(host="studio.lan", headers={"host": "studio.lan:8000"}) == 200


@pytest.mark.parametrize(("host", "local"), [("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("::", False), ("10.0.0.1", False), ("example.com", False)])  # fmt: skip
def test_loopback_is_recognised(host: str, local: bool) -> None:
    assert is_loopback(host) is local
