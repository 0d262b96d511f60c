"""Settings of the service's sessions, and the names in the keys of commands."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import pytest
from armrig_core.access.owned_session import LANES, session_configuration, strangers, transport
from armrig_daemon.service import listener
from armrig_daemon.service.access import Network
from armrig_daemon.service.listener import Listener, session_config

TLS = {"link": {"tls": {"enable_mtls": True}}}


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the settings returned as they are."""
    config = SimpleNamespace(from_json5=json.loads)
    monkeypatch.setattr(listener, "zenoh", SimpleNamespace(Config=config))


def _network(**changes: Any) -> Network:
    fields: dict[str, Any] = {
        "endpoint": "tls/h:7447",
        "access_control": {"rules": ["ours"]},
        "low_pass_filter": ["short"],
        "tls": TLS["link"]["tls"],
        "operators": 0,
        "observers": 0,
        "expires": None,
    }
    return Network(**{**fields, **changes})


def test_the_daemon_tries_a_lost_router_every_second() -> None:
    assert session_config("tls/h:7447", _network(is_router=True)) == {
        "mode": "client",
        "connect": {"endpoints": ["tls/h:7447"], "retry": {"period_max_ms": 1000}},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "adminspace": {"enabled": False},
        "access_control": {"rules": ["ours"]},
        "low_pass_filter": ["short"],
        "qos": LANES,
        "transport": {**(plain := transport(8 << 20)), "link": {**plain["link"], **TLS["link"]}},
    }


def test_network_clients_have_limits_that_the_unix_socket_has_not() -> None:
    local: Any = session_config("unixsock-stream//s")
    tls: Any = session_config("tls/h:7447", _network())

    assert local == json.loads(
        json.dumps(session_configuration("unixsock-stream//s", most_received=88 << 20))
    )
    assert tls["listen"]["endpoints"] == ["tls/h:7447#tls_handshake_timeout_ms=3000"]
    assert (tls["access_control"], tls["low_pass_filter"]) == ({"rules": ["ours"]}, ["short"])
    assert tls["transport"]["unicast"] == strangers(250)
    assert tls["transport"]["link"]["rx"] == {"max_message_size": 8 << 20}
    assert tls["transport"]["link"]["tls"] == {"enable_mtls": True}


@pytest.mark.parametrize(
    ("is_network", "key", "parts"),
    [
        (False, "rig/lab-2/cmd/arm", ("arm", "")),
        (True, "rig/lab-2/cmd/stop/bob", ("stop", "certificate bob")),
    ],
)
def test_the_key_of_a_command_names_the_network_client(
    is_network: bool, key: str, parts: tuple[str, str]
) -> None:
    made = Listener.__new__(Listener)
    made._is_network = is_network

    assert made._parts(SimpleNamespace(key_expr=key)) == parts  # type: ignore[arg-type]
