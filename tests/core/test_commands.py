"""Commands are checked field by field; a refusal names the field and the allowed values."""

from __future__ import annotations

import json

import msgspec
import pytest
from armrig_core.commands.commands import (
    REQUESTS,
    ArmRequest,
    NoteRequest,
    RunRequest,
    SetRequest,
    StopRequest,
    json_schema,
    parse,
)

LEASE = "0" * 32


def _calibration(tables: str, beside: str = "") -> str:
    """Return the fields of `calibrate`, with these tables in the calibration."""
    return f'{{"calibration": {{{tables}}}{"," if beside else ""}{beside}}}'


def test_a_command_is_read_with_its_fields() -> None:
    assert parse("arm", b'{"owner": "a student", "Ts": 0.01}') == ArmRequest(
        owner="a student", Ts=0.01
    )
    assert parse("stop", b"") == StopRequest()
    assert parse("stop", b'{"by": "anna"}') == StopRequest(by="anna")
    assert msgspec.json.encode(StopRequest()) == b"{}"  # as a daemon of an earlier version takes it
    assert parse("note", '{"text": "#set $1 <b> 陈"}'.encode()) == NoteRequest(
        text="#set $1 <b> 陈"
    )
    assert parse("arm", '{"owner": "Zoë 陈 [red]"}'.encode()) == ArmRequest(owner="Zoë 陈 [red]")


@pytest.mark.parametrize(
    ("name", "payload", "complaint"),
    [
        ("fly", "{}", "allowed are arm, disarm"),
        ("arm", "{}", "missing required field `owner`"),
        ("arm", '{"owner": "x", "Ts": 0}', r"Ts"),
        ("arm", '{"owner": "x", "Tz": 0.01}', "unknown field `Tz`"),
        ("arm", "not json", "arm: "),
        (
            "arm",
            '{"owner": "a\\u001b[2J"}',
            r"owner 'a\\x1b\[2J': allowed are 1 to 80 print",
        ),
        ("arm", '{"owner": "a\\nb"}', r"owner 'a\\nb': allowed are 1 to 80"),
        ("arm", '{"owner": "\\u009b31m"}', r"owner '\\x9b31m': allowed are 1 to 80"),
        ("arm", '{"owner": "  "}', "owner '  ': allowed are .* a letter or a digit"),
        ("arm", '{"owner": "\\u2800"}', "owner '\u2800': allowed are"),  # a blank of Braille
        ("arm", '{"owner": "\\u3164\\u115f"}', "allowed are"),  # fillers, which are letters
        ("arm", '{"owner": "-"}', "owner '-': allowed are"),
        ("arm", f'{{"owner": "{81 * "x"}"}}', r"length <= 80.*\$.owner"),
        ("set", f'{{"lease": "{LEASE}", "n": 1, "u": 5.01}}', r"<= 5.0.*\$.u"),
        ("set", f'{{"lease": "{LEASE}", "n": 1, "u": -0.01}}', r">= 0.0.*\$.u"),
        ("set", f'{{"lease": "{LEASE}", "n": 1, "u": NaN}}', "set: "),
        ("set", f'{{"lease": "{LEASE}", "n": 1, "u": "3"}}', r"Expected `float`.*\$.u"),
        ("set", f'{{"lease": "{LEASE}", "n": 1, "u": 1e999}}', "set: "),
        ("set", f'{{"lease": "{LEASE}", "n": -1, "u": 1}}', r"\$.n"),
        ("run", f'{{"lease": "{LEASE}", "n": 1, "u": []}}', r"length >= 1.*\$.u"),
        ("run", f'{{"lease": "{LEASE}", "n": 1, "u": [1, 9]}}', r"\$.u\[1\]"),
        ("run", f'{{"lease": "{LEASE}", "n": 1, "u": [1], "experiment": "../x"}}', "experiment"),
        ("run", f'{{"lease": "{LEASE}", "n": 1, "u": [1], "dead_man": 0}}', r">= 0.5.*dead_man"),
        ("run", f'{{"lease": "{LEASE}", "n": 1, "u": [1], "dead_man": 61}}', r"<= 60.*dead_man"),
        ("note", "{}", "missing required field `text`"),
        ("note", '{"text": ""}', r"length >= 1.*\$.text"),
        ("note", f'{{"text": "{501 * "x"}"}}', r"length <= 500.*\$.text"),
        ("note", '{"text": "a\\u001b[2J"}', r"text 'a\\x1b\[2J': allowed are 1 to 500 print"),
        ("note", '{"text": " \\u3164"}', "not only blanks"),
        ("note", '{"text": "x", "t": 1}', "unknown field `t`"),
        ("calibrate", "{}", "missing required field `calibration`"),
        ("calibrate", _calibration('"driver": {"gain": 11}'), r"gain=11.0 .* 0.1 to 10.*\$.c"),
        ("calibrate", _calibration("", '"raw": "no base64!"'), r"Invalid base64.*\$.raw"),
    ],
)
def test_a_forbidden_field_of_a_command_is_refused(name: str, payload: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        parse(name, payload.encode())


@pytest.mark.parametrize(("length", "fits"), [((1 << 20) - 8, True), ((1 << 20) - 7, False)])
def test_the_details_of_a_run_have_a_mebibyte_at_most(length: int, fits: bool) -> None:
    details = {"a": "x" * length}
    payload = {"lease": LEASE, "n": 1, "u": [1.0], "details": details}

    if fits:
        assert parse("run", json.dumps(payload).encode()) == RunRequest(**payload)
        return
    with pytest.raises(ValueError, match=r"^run: details have more than 1048576 B of JSON$"):
        parse("run", json.dumps(payload).encode())


def test_every_command_serves_its_schema() -> None:
    names = {"arm", "disarm", "run", "renew", "set", "stop", "reset", "calibrate", "status"}
    names |= {"note", "control", "set_reference"}
    assert set(REQUESTS) == names
    text = json.loads(json_schema("set"))

    fields = text["$defs"][SetRequest.__name__]["properties"]
    assert fields["u"]["maximum"] == 5.0
    assert (
        json.loads(json_schema("run"))["$defs"][RunRequest.__name__]["additionalProperties"]
        is False
    )
