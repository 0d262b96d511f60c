"""The sockets of a dashboard."""

from __future__ import annotations

from contextlib import closing

from armrig.dashboard.serving import HOST, _listening


def test_two_dashboards_that_start_at_once_have_a_port_each() -> None:
    """The first has its port from the moment that it is bound, and not only once it serves."""
    with closing(_listening(HOST, 0, None)) as free:
        port = free.getsockname()[1]
    with (
        closing(_listening(HOST, port, None)) as first,
        closing(_listening(HOST, port, None)) as second,
    ):
        assert first.getsockname()[1] == port
        assert second.getsockname()[1] != port
