"""The results of the suite, as text and as JSON."""

from __future__ import annotations

import json

import pytest
from armrig_daemon.conformance.rule import Result, behaviour_text
from armrig_daemon.conformance.suite import FAIL, NOT_TRIED, PASS, json_of, line_of, sum_of
from armrig_protocol import messages as wire
from armrig_protocol.messages import Cause, Code, State

HELD = Result(1, "A frame may arrive in any pieces", PASS, "")
BROKEN = Result(3, "Only CLEAR_FAULT leads out", FAIL, "ACK(OK), and " + "more " * 12)
LEFT_OUT = Result(5, "With oversampling", NOT_TRIED, "the device offers no oversampling")


def test_a_result_has_one_line_and_a_second_with_its_reason() -> None:
    assert line_of(HELD) == "pass       1  A frame may arrive in any pieces"
    assert line_of(BROKEN).splitlines() == [
        "FAIL       3  Only CLEAR_FAULT leads out",
        f"              came: {BROKEN.came}",
    ]
    assert line_of(LEFT_OUT).splitlines() == [
        "not tried  5  With oversampling",
        "              the device offers no oversampling",
    ]


@pytest.mark.parametrize("columns", [30, 40, 80])
def test_no_line_is_wider_than_the_screen(columns: int) -> None:
    lines = line_of(BROKEN, columns).splitlines()

    assert max(map(len, lines)) <= columns
    assert all(line.startswith(" " * 14) for line in lines[1:])
    assert " ".join(line.strip() for line in lines).split() == line_of(BROKEN).split()


def test_the_summary_counts_each_outcome_separately() -> None:
    assert sum_of([HELD, HELD, LEFT_OUT]) == "all 2 tested rules hold; 1 not tried"
    assert sum_of([BROKEN, HELD, HELD, LEFT_OUT, LEFT_OUT]) == (
        "1 of 5 rules are broken; 2 not tried"
    )


def test_a_program_gets_the_identity_in_hexadecimal_and_every_rule() -> None:
    facts = wire.HelloReply(State.IDLE, 77, *range(20, 20 + len(wire.HelloReply._fields) - 2))

    told = json.loads(json.dumps(json_of(facts, [HELD, BROKEN, LEFT_OUT, BROKEN])))

    hexadecimal = {"uid", "boot_id", "schema", "firmware"}
    assert told["device"] == {
        key: f"{value:x}" if key in hexadecimal else value
        for key, value in facts._asdict().items()
        if key != "seq"
    }
    assert told["broken"] == 2
    assert [rule["outcome"] for rule in told["rules"]] == [PASS, FAIL, NOT_TRIED, FAIL]
    assert told["rules"][1] == BROKEN._asdict()
    assert json_of(None, [])["device"] == {}


def test_messages_are_shown_by_their_protocol_names() -> None:
    def of(kind: type[wire.Message], **fields: int) -> wire.Message:
        return kind._make([0] * len(kind._fields))._replace(**fields)

    event = {"was": State.RUN, "state": State.FAULT, "cause": Cause.SLEW}
    said = {
        of(wire.Ack, code=Code.STALE): "ACK(STALE)",
        of(wire.Ack, code=250): "ACK(250)",
        of(wire.Event, **event): "EVENT(RUN to FAULT, SLEW)",
        of(wire.Event, was=99, state=98, cause=97): "EVENT(99 to 98, 97)",
        of(wire.ConfigReply, code=Code.BAD_VALUE): "CONFIG_R(BAD_VALUE)",
        of(wire.Sample, k=3, u_k=500, u_km1=9, flags=0x43): "SAMPLE(k=3, u_k=500, flags=0x0043)",
        of(wire.Pong, state=State.ARMED): "PONG in ARMED",
        of(wire.Keepalive): "Keepalive",
    }
    assert {message: behaviour_text(message) for message in said} == said
    assert behaviour_text([*said][:2]) == "ACK(STALE), ACK(250)"
    assert behaviour_text([]) == "nothing"
    assert behaviour_text("as it is") == "as it is"
