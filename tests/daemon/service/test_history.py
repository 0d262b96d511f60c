"""The newest messages are kept for who missed some, and no more of them than may be."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from armrig.rig.session import open_session
from armrig_core.telemetry.history import REPLY_LIMIT, decode_past
from armrig_daemon.service.publish import History, Session

LIFE = bytes(range(16))


def asked(history: History, first: int) -> tuple[int, list[bytes]]:
    """Return the number of the first message of an answer, and the messages."""
    past = decode_past(history.reply(first, 0))
    return past.first, [data for _, data in past.messages]


@pytest.mark.parametrize("most_bytes", [90, 100, 119])
def test_the_history_keeps_a_bounded_number_of_messages(most_bytes: int) -> None:
    history = History(LIFE, most_bytes=most_bytes)
    for k in range(50):
        history.add("gap", bytes([k]) * 30)

    assert asked(history, 0) == (47, [bytes([k]) * 30 for k in (47, 48, 49)])
    history.add("event", bytes(most_bytes + 1))
    assert asked(history, 0) == (51, [])


def test_the_length_of_a_history_reply_is_limited() -> None:
    history = History(LIFE)
    for _ in range(1000):
        history.add("event", bytes(1000))

    first, messages = asked(history, 0)
    assert len(messages) == -(-REPLY_LIMIT // 1000)
    assert asked(history, first + len(messages))[0] == len(messages)


@pytest.fixture
def session() -> Iterator[tuple[Session, zenoh.Session]]:
    """Give the daemon's session and a client's."""
    with tempfile.TemporaryDirectory(prefix="armrig-") as directory:
        where = f"unixsock-stream/{Path(directory) / '1.sock'}"
        with Session(where, "1", lambda: None) as ours, open_session(where, rig="1") as theirs:
            yield ours, theirs


def replies(session: zenoh.Session, payload: bytes | None) -> list[zenoh.Reply]:
    """Return the replies."""
    return list(session.get("rig/1/history", payload=payload, timeout=30))


def test_the_history_reply_contains_published_messages(
    session: tuple[Session, zenoh.Session],
) -> None:
    ours, theirs = session
    ours.put("sample", b"one")
    ours.put("gap", b"two")
    ours.put("sample", b"three")

    [reply] = replies(theirs, json.dumps({"first": 1}).encode())
    assert reply.ok is not None
    past = decode_past(reply.ok.payload.to_bytes())

    assert past.first == 1
    assert past.messages == (("gap", b"two"), ("sample", b"three"))


@pytest.mark.parametrize("payload", [b'{"first": -1}', b'{"from": 1}', b"\xff", b"[" * 5000])
def test_a_malformed_history_request_is_refused(
    session: tuple[Session, zenoh.Session], payload: bytes
) -> None:
    [reply] = replies(session[1], payload)

    assert reply.err is not None
    assert 'ask with {\\"first\\": 0}' in reply.err.payload.to_bytes().decode()
