"""Lines of the daemon's log about its router."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

from armrig_daemon.service.listener import Listener
from armrig_daemon.service.uplink import Uplink


def test_the_log_has_a_line_each_time_that_the_router_comes_or_goes() -> None:
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
