"""Settings of sessions in which only the owner publishes."""

from __future__ import annotations

import pytest
from armrig_core.owned_session import (
    listening,
    os_error_number,
    owned_session,
    strangers,
    transport,
)


def test_a_stranger_s_handshake_over_tls_has_three_seconds() -> None:
    assert listening("tls/h:1") == {
        "listen": {"endpoints": ["tls/h:1#tls_handshake_timeout_ms=3000"]}
    }
    assert listening("tcp/127.0.0.1:1") == {"listen": {"endpoints": ["tcp/127.0.0.1:1"]}}
    assert strangers(7) == {"accept_timeout": 3000, "max_sessions": 7}


def test_a_subscriber_that_does_not_read_is_not_waited_for() -> None:
    patient, hurried = transport(5), transport(6, answer_us=9)
    of_patient, of_hurried = (made["link"]["tx"]["queue"] for made in (patient, hurried))

    assert of_patient == {"congestion_control": {"drop": {"wait_before_drop": 0}}}
    assert of_hurried == {
        "congestion_control": {
            "drop": {"wait_before_drop": 0},
            "block": {"wait_before_close": 9},
        }
    }
    assert [made["link"]["rx"]["max_message_size"] for made in (patient, hurried)] == [5, 6]


def test_others_neither_publish_nor_answer_nor_find_the_session() -> None:
    config = owned_session("unixsock-stream//a", most_received=8)

    assert config["listen"] == {"endpoints": ["unixsock-stream//a"]}
    assert config["scouting"] == {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    denied = {
        (rule["flows"][0], message)
        for rule in config["access_control"]["rules"]
        for message in rule["messages"]
        if rule["permission"] == "deny"
    }
    asks = ("put", "delete", "declare_queryable", "reply", "liveliness_token")
    assert denied == {*(("ingress", message) for message in asks), ("egress", "query")}
    assert config["transport"] == transport(8)


@pytest.mark.parametrize(
    ("text", "number"),
    [("in use (os error 98)", 98), ("(os error 13) at x", 13), ("error 5", None)],
)
def test_the_number_of_an_error_is_found_in_its_text(text: str, number: int | None) -> None:
    assert os_error_number(RuntimeError(text)) == number
