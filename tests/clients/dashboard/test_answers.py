"""Answers to the page after an error: a mistake of the page, or a fault of armrig."""

from __future__ import annotations

import asyncio
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest
from armrig.dashboard.app import answered, application
from armrig_core.errors import InputError
from starlette.routing import Route


def _of_numpy(_: bytes) -> Any:
    np.zeros(2) + np.zeros(3)


def _of_ours(_: bytes) -> Any:
    raise InputError("u is 9 V: 0 to 5 V are allowed")


@pytest.mark.parametrize(
    ("does", "status", "said"),
    [
        (_of_numpy, 500, b"internal error, please report it: ValueError: operands"),
        (_of_ours, 400, b"u is 9 V: 0 to 5 V are allowed"),
    ],
    ids=["of numpy", "of ours"],
)
def test_an_error_of_numpy_is_not_the_pages_mistake(does: Any, status: int, said: bytes) -> None:
    app = application([Route("/does", answered(does), methods=["POST"])])
    scope = {"type": "http", "method": "POST", "path": "/does", "headers": [], "query_string": b""}
    sent: list[Any] = []

    async def receive() -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)

    logged = pytest.raises(ValueError, match="operands") if status == 500 else nullcontext()
    with logged:
        asyncio.run(app(scope, receive, send))

    assert sent[0]["status"] == status
    assert said in sent[1]["body"]
