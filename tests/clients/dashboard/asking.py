"""One request to an application, without a server."""

from __future__ import annotations

import asyncio
from typing import Any

from starlette.applications import Starlette


def asked(app: Starlette, path: str, body: bytes = b"", method: str = "POST") -> tuple[int, bytes]:
    """Return the status and the body of an answer."""
    scope = {"type": "http", "method": method, "path": path, "headers": [], "query_string": b""}
    sent: list[Any] = []
    came = [{"type": "http.request", "body": body, "more_body": False}]

    async def receive() -> Any:
        return came.pop() if came else await asyncio.Event().wait()  # the client stays

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(app(scope, receive, send))
    return sent[0]["status"], b"".join(message["body"] for message in sent[1:])
