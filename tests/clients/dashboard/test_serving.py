"""The sockets of a dashboard."""

from __future__ import annotations

import logging
import threading
from contextlib import closing
from pathlib import Path

import pytest
from armrig.dashboard.serving import HOST, Settings, _listening, dashboard


def test_two_dashboards_that_start_at_once_have_a_port_each() -> None:
    """The first dashboard holds its port from the bind on, before it serves."""
    with closing(_listening(HOST, 0, None)) as free:
        port = free.getsockname()[1]
    with (
        closing(_listening(HOST, port, None)) as first,
        closing(_listening(HOST, port, None)) as second,
    ):
        assert first.getsockname()[1] == port
        assert second.getsockname()[1] != port


def test_a_broken_connection_writes_nothing_on_the_terminal(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The event loop warns of each connection that is lost during a write."""
    with dashboard(Settings(connect=f"unixsock-stream/{tmp_path}/none.sock")):
        logging.getLogger("asyncio").warning("socket.send() raised exception.")

    assert caplog.text == ""


def test_a_dashboard_that_has_ended_listens_to_no_rig(tmp_path: Path) -> None:
    before = {*threading.enumerate()}

    with dashboard(Settings(connect=f"unixsock-stream/{tmp_path}/none.sock")):
        pass

    assert not [t.name for t in {*threading.enumerate()} - before if t.name == "listener"]
