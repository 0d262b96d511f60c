"""Any program may listen: each of its answers becomes a message of one line."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import pytest
import zenoh
from armrig.cli import main
from armrig.rig.client import Rig
from armrig.rig.replies import MOST_BYTES, BusyError, RefusedError, refusal_of, reply_of
from armrig.rig.session import MOST_RECEIVED, NoReplyError, RigError
from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import Done, LeaseGranted, Refused, StatusReport, build_refusal
from armrig_core.errors import MalformedReplyError

from tests.clients.fake_daemon import FakeDaemon

HOSTILE = "\x1b]0;mine\x07\x1b[2Ja rig\r\x9b[red]\u202e"


class Rogue(FakeDaemon):
    """Answers everything alike."""

    body = b""
    refuses = False

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            if self.refuses:
                query.reply_err(self.body)
            else:
                query.reply(query.key_expr, self.body)


@pytest.fixture
def rogue(where: str) -> Iterator[Rogue]:
    with Rogue(where) as running:
        yield running


def _status(**changes: Any) -> bytes:
    report = json.loads(msgspec.json.encode(FakeDaemon("unixsock-stream/x").status()))
    return json.dumps(report | changes).encode()


GARBAGE = {
    "nothing": b"",
    "no JSON": b"\x1b[2J<html>",
    "no UTF-8": b'{"rig": "\xff"}',
    "a number": b"7",
    "a list": b"[]",
    "no fields": b"{}",
    "nested": b'{"device": ' + b'{"a":' * 100_000 + b"1" + b"}" * 100_001,
    "words for a number": _status(Ts="soon"),
    "no sampling time": _status(Ts=0),
    "a voltage that destroys the rig": _status(u_max=12.0),
    "a number that is none": _status(Ts=1).replace(b'"Ts": 1', b'"Ts": NaN'),
    "a device nested": _status(device={"uid": {"a": []}}),
    "a host that is none": _status(host=[1, 2]),
    "a run of -1 samples": _status(
        last_run={"run_id": "", "recording": "", "finished": True, "samples": -1, "outcome": ""}
    ),
    "too much": b'{"rig": "' + b"1" * MOST_BYTES + b'"}',
}


@pytest.mark.parametrize("body", GARBAGE.values(), ids=GARBAGE.keys())
def test_a_malformed_reply_is_reported(body: bytes) -> None:
    with pytest.raises(MalformedReplyError, match=r"^the answer to 'status' "):
        reply_of("status", body, StatusReport)


def test_a_reply_is_read() -> None:
    assert reply_of("status", _status(Ts=0.02), StatusReport).Ts == 0.02
    assert reply_of("stop", b'{"done": true}', Done) == Done(done=True)


@pytest.mark.parametrize(
    ("payload", "error"),
    [
        (b'{"error": "wait"}', "wait"),
        (b"wait", "stop: wait"),
        (b'{"error": 7}', 'stop: {"error": 7}'),
        (json.dumps({"error": "x" * 1001}).encode(), "x" * 1000 + " …"),
    ],
)
def test_a_refusal_is_reported_in_any_form(payload: bytes, error: str) -> None:
    assert refusal_of("stop", payload).error == error


def test_a_refusal_that_is_too_long_is_not_read() -> None:
    with pytest.raises(MalformedReplyError, match=f"at most {MOST_BYTES} B are read"):
        refusal_of("stop", b" " * (MOST_BYTES + 1))


@pytest.mark.parametrize(
    ("body", "passes", "code"),
    [
        (build_refusal(RefusalCode.LATE, "sleepy"), True, "late"),
        (build_refusal(RefusalCode.HELD, "a student said: try again"), False, "held"),
        (Refused(error="new", code="a code of tomorrow", passes=True), True, "a code of tomorrow"),
        (Refused(error="busy with STOP: try again", passes=True), True, ""),
        (Refused(error="in fault: correct the cause, then reset"), False, ""),
    ],
    ids=["passes", "does not", "a later daemon", "without a code", "another"],
)
def test_the_daemon_decides_whether_a_refusal_is_temporary(
    rogue: Rogue, where: str, body: Refused, passes: bool, code: str
) -> None:
    rogue.body, rogue.refuses = msgspec.json.encode(body), True

    with Rig(connect=where) as rig, pytest.raises(RefusedError) as refusal:
        rig.stop()

    assert isinstance(refusal.value, BusyError) == passes
    assert refusal.value.code == code
    assert str(refusal.value) == body.error


@pytest.mark.parametrize("command", ["status", "stop", "reset"])
def test_garbage_is_answered_with_one_line(
    rogue: Rogue, where: str, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rogue.body = GARBAGE["no JSON"]

    assert main([command, "--connect", where]) == 1

    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith("armrig: rig 1 at unixsock-stream/")
    assert told.err.endswith("not an armrigd of this version\n")
    assert told.err.count("\n") == 1
    assert told.err[:-1].isprintable()


def test_an_oversized_reply_is_not_received(
    rogue: Rogue, where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armrig.rig.client.REPLY_S", 1.0)
    rogue.body = b" " * (MOST_RECEIVED + (1 << 20))

    with Rig(connect=where) as rig, pytest.raises(NoReplyError, match="no reply from rig 1"):
        rig.status()


def test_a_malformed_lease_is_refused(rogue: Rogue, where: str) -> None:
    granted = {"lease": "0" * 32, "period_s": 0.1, "Ts": 0.01, "u_min": 0.0, "u_max": 5.0}
    with Rig(connect=where) as rig:
        for wrong in ({"lease": ""}, {"Ts": 0.0}, {"u_max": 24.0}, {"u_min": "0"}):
            rogue.body = json.dumps(granted | wrong).encode()
            with pytest.raises(RigError, match="the answer to 'arm' cannot be read"):
                rig.arm("me")
    assert reply_of("arm", json.dumps(granted).encode(), LeaseGranted).u_max == 5.0


def test_a_refusal_is_printed_without_control_characters(rogue: Rogue, where: str) -> None:
    rogue.body, rogue.refuses = json.dumps({"error": HOSTILE}).encode(), True

    with Rig(connect=where) as rig, pytest.raises(RefusedError, match="a rig") as refused:
        rig.stop()

    assert str(refused.value).isprintable()


@pytest.mark.parametrize("name", ["sample", "state", "event", "gap", "timing", "clock"])
def test_a_malformed_message_is_reported(rogue: Rogue, where: str, name: str) -> None:
    with Rig(connect=where) as rig, rig.arrivals(name) as come:
        stream = rig.stream(name)
        with _publishing(rogue, name):
            with pytest.raises(RigError, match=f"of its stream '{name}' cannot be read"):
                next(stream)
            with pytest.raises(RigError, match="not an armrigd of this version"):
                come()


@contextmanager
def _publishing(rogue: Rogue, name: str) -> Iterator[None]:
    """Publish malformed messages again and again, because a new subscriber misses the first."""
    ended = threading.Event()

    def publish() -> None:
        while not ended.wait(0.01):
            rogue.session.put(f"rig/1/{name}", b"\xff" * 10)

    publisher = threading.Thread(target=publish)
    publisher.start()
    try:
        yield
    finally:
        ended.set()
        publisher.join()


def test_a_status_is_printed_without_control_characters(
    rogue: Rogue, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = dict.fromkeys(
        ("rig", "version", "phase", "reason", "fault", "motor", "remedy", "owner"), HOSTILE
    )
    text |= dict.fromkeys(("endpoint", "recordings", "calibration"), HOSTILE)
    rogue.body = _status(
        **text,
        device={HOSTILE: HOSTILE, "list": [HOSTILE]},
        host={"fifo": HOSTILE, "refused": HOSTILE},
        last_run={
            "run_id": HOSTILE,
            "recording": HOSTILE,
            "finished": True,
            "samples": 1,
            "outcome": HOSTILE,
        },
    )

    assert main(["status", "--connect", where]) == 0
    told = capsys.readouterr().out
    assert main(["status", "--connect", where, "--json"]) == 0
    as_json = capsys.readouterr().out

    assert told.replace("\n", "").isprintable()
    assert told.count("a rig\\r\\x9b[red]\\u202e") == 18
    assert len(told.splitlines()) == 14
    assert as_json[:-1].isprintable()
    assert json.loads(as_json)["owner"] == HOSTILE
