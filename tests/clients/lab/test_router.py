"""The configuration of a lab's router: who may connect, how often, and with which messages."""

from __future__ import annotations

import json
import socket
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import zenoh
from armrig.lab import pki
from armrig.lab.router import MOST_LINKS, open_router, router_config
from armrig_core.access import access_control
from armrig_core.access.access_list import read_access_list
from armrig_core.access.credential import read_credential
from armrig_core.access.owned_session import LANES
from armrig_core.errors import InputError
from armrig_core.telemetry.topics import EVERY_RIG


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """Give an authority's folder, with a router, two rigs and two people."""
    pki.make_authority(tmp_path)
    pki.issue_to_router(tmp_path, ["lab"])
    for rig in ("1", "7"):
        pki.issue_to_rig(tmp_path, rig, [])
    pki.issue_to_person(tmp_path, "ada", "operators")
    pki.issue_to_person(tmp_path, "bob", "observers")
    return tmp_path


def test_a_router_limits_its_links_and_messages_and_asks_the_access_list(made: Path) -> None:
    people = read_access_list(made / "access.toml")
    credential = read_credential(made / "router.pem", "router")

    config = router_config("tls/0.0.0.0:7447", credential, people)

    assert config["mode"] == "router"
    [listens] = config["listen"]["endpoints"]
    assert listens.startswith("tls/0.0.0.0:7447#")
    assert config["transport"]["unicast"]["max_sessions"] == MOST_LINKS
    assert config["transport"]["link"]["tls"] == credential.tls("listen")
    assert config["access_control"] == access_control.of_router(people)
    assert config["low_pass_filter"] == access_control.size_limits(EVERY_RIG)
    assert config["qos"]["network"][:-1] == LANES["network"]
    assert not config["scouting"]["multicast"]["enabled"]


def _opened(config: dict[str, Any]) -> closing[zenoh.Session]:
    return closing(zenoh.open(zenoh.Config.from_json5(json.dumps(config))))


@pytest.mark.parametrize("size", [60_000, 8_000_000])
def test_a_router_does_not_truncate_a_long_command(made: Path, size: int) -> None:
    """A run of 400 000 samples has 8 MB, and its parts fill each queue."""
    people = read_access_list(made / "access.toml")
    config = router_config("tls/h:1", read_credential(made / "router.pem", "router"), people)
    with closing(socket.create_server(("127.0.0.1", 0))) as found:
        where = {"endpoints": [f"tcp/127.0.0.1:{found.getsockname()[1]}"]}
    router = config | {"listen": where, "access_control": {"enabled": False}}
    plain = {"mode": "client", "connect": where, "scouting": {"multicast": {"enabled": False}}}
    arrived: list[int] = []

    def answer(query: zenoh.Query) -> None:
        arrived.append(len(query.payload or b""))
        query.reply(query.key_expr, b"")

    with _opened(router), _opened(plain) as rig, _opened(plain) as client:
        rig.declare_queryable("rig/1/cmd/run/*", answer)
        querier = client.declare_querier("rig/1/cmd/run/ada")
        while not querier.matching_status.matching:
            pass
        replies = [reply.ok is not None for reply in querier.get(payload=bytes(size))]

    assert (arrived, replies) == ([size], [True])


def test_a_router_without_certificates_is_refused_with_the_right_endpoint(made: Path) -> None:
    with pytest.raises(InputError, match=r"must be tls/HOST:PORT"):
        open_router("tcp/127.0.0.1:7447", made / "router.pem", made / "access.toml")
