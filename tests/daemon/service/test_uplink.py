"""Lines of the daemon's log about its router."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import cast

import pytest
import zenoh
from armrig_daemon.service import uplink as uplink_module
from armrig_daemon.service.listener import Listener
from armrig_daemon.service.uplink import Uplink


def test_each_connection_to_and_loss_of_the_router_is_logged() -> None:
    way = SimpleNamespace(has_router=True)
    uplink = Uplink("tls/lab:7447", lambda: cast("Listener", way))
    uplink._thread.join(30.0)

    told = [uplink.look(), uplink.look()]
    way.has_router = False
    told += [uplink.look(), uplink.look()]

    levels = [line and (line[0], line[1].partition(",")[0]) for line in told]
    assert levels == [
        ("info", "[access] connected to the router tls/lab:7447"),
        None,
        ("warning", "[access] no connection to the router tls/lab:7447"),
        None,
    ]


class _Way:
    """Listener at a router that answers."""

    has_router = True

    def __init__(self) -> None:
        self.published: list[tuple[str, bytes]] = []
        self.closed = 0

    def put(self, stream: str, data: bytes) -> None:
        """Note a message."""
        self.published.append((stream, data))

    def close(self) -> None:
        """Count the calls."""
        self.closed += 1


def test_a_router_that_does_not_answer_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uplink_module, "RETRY_S", 0.0)
    way, may_open = _Way(), threading.Event()
    attempts: list[None] = []

    def open_way() -> Listener:
        may_open.wait(30)
        attempts.append(None)
        if len(attempts) < 3:
            raise zenoh.ZError("no answer")
        return cast("Listener", way)

    uplink = Uplink("tls/lab:7447", open_way)
    uplink.put("sample", b"missed")
    assert not uplink.has_router
    may_open.set()
    uplink._thread.join(30.0)
    uplink.put("gap", b"sent")
    uplink.close()

    assert (len(attempts), uplink.has_router) == (3, True)
    assert (way.published, way.closed) == ([("gap", b"sent")], 1)


def test_a_connection_that_succeeds_after_the_end_is_closed() -> None:
    way, has_begun, may_open = _Way(), threading.Event(), threading.Event()

    def open_way() -> Listener:
        has_begun.set()
        may_open.wait(30)
        return cast("Listener", way)

    uplink = Uplink("tls/lab:7447", open_way)
    assert has_begun.wait(30)
    uplink.close()
    may_open.set()
    uplink._thread.join(30.0)

    assert way.closed == 1
