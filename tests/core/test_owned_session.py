"""Settings of sessions in which only the owner publishes."""

from __future__ import annotations

import pytest
from armrig_core.access.owned_session import (
    LANES,
    listening,
    os_error_number,
    strangers,
    transport,
)
from armrig_core.telemetry.history import REPLY_LIMIT


def test_an_unauthenticated_tls_handshake_is_limited_to_three_seconds() -> None:
    assert listening("tls/h:1") == {
        "listen": {"endpoints": ["tls/h:1#tls_handshake_timeout_ms=3000"]}
    }
    assert listening("tcp/127.0.0.1:1") == {"listen": {"endpoints": ["tcp/127.0.0.1:1"]}}
    assert strangers(7) == {"accept_timeout": 3000, "accept_pending": 4096, "max_sessions": 7}


def test_a_blocked_client_is_closed_after_20_ms() -> None:
    made = transport(5)["link"]

    assert made["rx"]["max_message_size"] == 5
    assert made["tx"]["queue"]["congestion_control"] == {
        "drop": {"wait_before_drop": 0},
        "block": {"wait_before_close": 20_000},
    }


def test_the_queue_of_long_answers_holds_fifteen() -> None:
    """Zenoh drops an answer of several batches whose last batch has no room."""
    sizes = transport(5)["link"]["tx"]["queue"]["size"]

    assert sizes["data_low"] * 65_535 >= 15 * REPLY_LIMIT


def test_every_query_is_answered_in_a_queue_that_drops() -> None:
    [first, *others] = LANES["network"]

    assert first["key_exprs"] == ["**"]
    assert first["overwrite"]["congestion_control"] == "drop"
    for rule in LANES["network"]:
        assert (rule["messages"], rule["flows"]) == (["query"], ["ingress"])
    lanes = [rule["overwrite"]["priority"] for rule in LANES["network"]]
    assert len({*lanes, "data", "background"}) == len(lanes) + 2  # data: the samples
    assert {key for rule in others for key in rule["key_exprs"]} == {
        *("rig/*/history", "rig/*/schema/**", "rig/*/cmd/stop", "rig/*/cmd/stop/*"),
    }


@pytest.mark.parametrize(
    ("text", "number"),
    [("in use (os error 98)", 98), ("(os error 13) at x", 13), ("error 5", None)],
)
def test_the_number_of_an_error_is_read_from_its_text(text: str, number: int | None) -> None:
    assert os_error_number(RuntimeError(text)) == number
