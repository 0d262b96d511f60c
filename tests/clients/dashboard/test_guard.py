"""Passes of a dashboard."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence

import pytest
from armrig.dashboard.guard import HEADERS, MOST_BODY, Guard, Pass
from starlette.types import Message, Receive, Scope, Send


def test_a_pass_opens_once() -> None:
    once = Pass("right", until_s=time.monotonic() + 60)

    assert [once.opens(code) for code in (b"wrong", b"right", b"right")] == [False, True, False]


def test_a_pass_expires() -> None:
    assert not Pass("right", until_s=time.monotonic() - 1).opens(b"right")


def test_only_the_page_s_own_scripts_run_and_no_page_embeds_it() -> None:
    rules = dict(HEADERS)[b"content-security-policy"].decode().split("; ")

    assert {"default-src 'none'", "script-src 'self'", "frame-ancestors 'none'"} <= {*rules}


HOST = (b"Host", b"127.0.0.1:8807")
TOKEN = (b"authorization", b"Bearer right")
MOST = "at most 8388608 B"


def _asked(
    method: str, path: str, headers: list[tuple[bytes, bytes]], pieces: Sequence[bytes | None] = ()
) -> tuple[int, str]:
    """Return the status and body of an answer; the application returns its request."""
    came: list[Message] = [
        {"type": "http.disconnect"}
        if piece is None
        else {"type": "http.request", "body": piece, "more_body": i + 1 < len(pieces)}
        for i, piece in enumerate(pieces or [b""])
    ]
    sent: list[Message] = []

    async def receive() -> Message:
        return came.pop(0)

    async def send(message: Message) -> None:
        sent.append(message)

    async def echo(scope: Scope, receive: Receive, send: Send) -> None:
        message = await receive()
        await send({"type": "http.response.start", "status": 200, "headers": [(b"a", b"b")]})
        await send({"type": "http.response.body", "body": message["body"]})

    once = Pass("code", until_s=time.monotonic() + 60)
    origins = ["http://127.0.0.1:8807", "http://localhost:8807"]
    door = Guard(echo, origins=origins, token="right", once=once)
    scope = {"type": "http", "method": method, "path": path, "headers": headers}
    asyncio.run(door(scope, receive, send))
    assert set(HEADERS) <= set(sent[0]["headers"])
    return sent[0]["status"], sent[1]["body"].decode()


@pytest.mark.parametrize(
    ("method", "path", "headers", "status", "why"),
    [
        ("GET", "/", [HOST], 200, ""),
        ("HEAD", "/", [(b"host", b"localhost:8807")], 200, ""),
        ("GET", "/", [(b"host", b"evil:8807")], 403, "'evil:8807': the dashboard is at http://12"),
        ("GET", "/", [], 403, "Host '': the dashboard"),
        ("GET", "/", [HOST, (b"host", b"evil")], 400, "host came twice"),
        ("GET", "/", [HOST, (b"accept", b"a"), (b"accept", b"b")], 200, ""),
        ("POST", "/api/run", [HOST, TOKEN, TOKEN], 400, "authorization came twice"),
        ("GET", "/", [HOST, *2 * [(b"origin", b"null")]], 400, "origin came twice"),
        ("GET", "/", [HOST, (b"origin", b"null")], 403, "Origin 'null': only"),
        ("GET", "/", [HOST, (b"origin", b"http://localhost:8807")], 200, ""),
        ("GET", "/", [HOST, (b"sec-fetch-site", b"none")], 200, ""),
        ("GET", "/", [HOST, (b"sec-fetch-site", b"same-site")], 403, "another page asks"),
        ("PUT", "/api/run", [HOST, TOKEN], 405, "PUT: GET and POST are allowed"),
        ("POST", "/", [HOST, TOKEN], 405, "the page's files are for GET"),
        ("POST", "/api/run", [HOST], 403, "the token is missing or wrong"),
        ("POST", "/api/run", [HOST, (b"authorization", b"Basic right")], 403, "the token is"),
        ("POST", "/api/run", [HOST, (b"authorization", b"Bearer r\xe4ght")], 403, "the token is"),
        ("POST", "/api/run", [HOST, (b"authorization", b"Bearer code")], 403, "the token is"),
        ("POST", "/api/token", [HOST, TOKEN], 403, "the token is missing or wrong"),
        ("POST", "/api/token", [HOST, (b"authorization", b"Bearer code")], 200, ""),
        ("POST", "/api/run", [HOST, TOKEN, (b"content-length", b"8388609")], 413, MOST),
        ("POST", "/api/run", [HOST, TOKEN, (b"content-length", b"-1")], 413, MOST),
        ("POST", "/api/run", [HOST, TOKEN, (b"content-length", b"8388608")], 200, ""),
    ],
)
def test_permitted_requests_are_admitted_and_others_get_the_reason(
    method: str,
    path: str,
    headers: list[tuple[bytes, bytes]],
    status: int,
    why: str,
) -> None:
    found, body = _asked(method, path, headers)

    assert found == status
    assert why in body


@pytest.mark.parametrize(
    ("pieces", "status", "body"),
    [
        ((b"abc", b"", b"defghij"), 200, "abcdefghij"),
        ((bytes(MOST_BODY - 1), b"a"), 200, "a"),
        ((bytes(MOST_BODY - 1), b"ab"), 413, MOST),
        ((b"abc", None), 400, "the body is incomplete"),
    ],
    ids=["several pieces", "the longest", "too long", "incomplete"],
)
def test_the_size_limit_of_a_body_applies_to_the_sum_of_its_pieces(
    pieces: tuple[bytes | None, ...], status: int, body: str
) -> None:
    found, answered = _asked("POST", "/api/run", [HOST, TOKEN], pieces)

    assert found == status
    assert body in answered
