"""The service's zenoh session, with real peers that mean no good."""

from __future__ import annotations

import json
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh
from armrig_daemon.service import admission
from armrig_daemon.service.admission import BURST
from armrig_daemon.service.listener import Command
from armrig_daemon.service.publish import CommandKind, Session

WITHIN_S = 30.0
SPREAD_S = 0.5
"""Time in which a stranger's declaration reaches the others, if it does."""
FORGED, OURS = b"forged", b"ours"
MODES = ["client", "peer", "router"]


@pytest.fixture
def where() -> Iterator[str]:
    """Give an endpoint; not pytest's own directory, whose path may be too long for a socket."""
    with tempfile.TemporaryDirectory(prefix="armrig-") as directory:
        yield f"unixsock-stream/{Path(directory)}/1.sock"


@pytest.fixture
def session(where: str) -> Iterator[Session]:
    """Give the session of a passive service."""
    with Session(where, "1", lambda: None) as opened:
        yield opened


def _connected(where: str, mode: str = "client") -> zenoh.Session:
    config = {
        "mode": mode,
        "connect": {"endpoints": [where]},
        "listen": {"endpoints": []},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def _until(what: Callable[[], object]) -> None:
    until = time.monotonic() + WITHIN_S
    while not what():
        assert time.monotonic() < until, "it did not happen in time"
        time.sleep(0.005)


@pytest.mark.parametrize("mode", MODES)
def test_another_peer_cannot_publish_a_sample(session: Session, where: str, mode: str) -> None:
    ours = session._listeners[0]._publishers["sample"]
    with _connected(where) as watcher, _connected(where, mode) as stranger:
        heard: list[bytes] = []
        watcher.declare_subscriber(
            "rig/1/sample", lambda sample: heard.append(sample.payload.to_bytes())
        )
        publisher = stranger.declare_publisher("rig/1/sample")
        _until(lambda: ours.matching_status and publisher.matching_status)
        for sn in range(20):
            publisher.put(FORGED)
            stranger.put("rig/1/sample", FORGED, source_info=zenoh.SourceInfo(ours.id, sn))
            stranger.delete("rig/1/sample")
            time.sleep(0.01)  # otherwise the sender's end of the line may drop them
        # The sender's query comes after all of them: they have been processed by then.
        list(stranger.get("rig/1/schema/armrig.v1.Sample", timeout=WITHIN_S))
        session.put("sample", OURS)
        _until(lambda: OURS in heard)

    assert set(heard) == {OURS}


@pytest.mark.parametrize("mode", MODES)
def test_another_peer_cannot_answer_a_query(session: Session, where: str, mode: str) -> None:
    overheard: list[str] = []

    def forge(query: zenoh.Query) -> None:
        overheard.append(str(query.key_expr))
        with query:
            query.reply(query.key_expr, FORGED)

    with _connected(where, mode) as stranger, _connected(where) as client:
        for key in ("rig/1/cmd/*", "rig/1/cmd/status", "rig/1/**"):
            stranger.declare_queryable(key, forge, complete=True)
        time.sleep(SPREAD_S)
        for target in (zenoh.QueryTarget.BEST_MATCHING, zenoh.QueryTarget.ALL):
            replies = client.get(
                "rig/1/cmd/status",
                target=target,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=WITHIN_S,
            )
            commands: list[Command] = []
            _until(
                lambda found=commands: found.extend(session.waiting(CommandKind.STATUS)) or found
            )
            for command in commands:
                command.answer("ours")
            assert [r.ok.payload.to_bytes() for r in replies if r.ok] == [b'"ours"']
    assert overheard == []


@pytest.mark.parametrize("mode", MODES)
def test_another_peer_cannot_impersonate_a_daemon(session: Session, where: str, mode: str) -> None:
    with _connected(where) as client, _connected(where, mode) as stranger:

        def alive() -> int:
            return len(list(client.liveliness().get("rig/1/*", timeout=WITHIN_S)))

        tokens = [stranger.liveliness().declare_token(f"rig/1/{key}") for key in ("alive", "a")]
        time.sleep(SPREAD_S)
        _until(lambda: alive() == 1)
        session._listeners[0]._alive.undeclare()
        _until(lambda: alive() == 0)
        for token in tokens:  # it is withdrawn where nobody keeps it
            token.undeclare()


MOST_AT_ONCE = 20
"""Fewer than may wait for the service, which is another bound."""
LEASE = "0123456789abcdef" * 2


@contextmanager
def _answering(session: Session) -> Iterator[Counter[str]]:
    """Answer all admitted requests, and count them, as the service's thread does."""
    let_in: Counter[str] = Counter()
    ended = threading.Event()

    def answer() -> None:
        while not ended.wait(0.001):
            for kind in CommandKind:
                for command in session.waiting(kind):
                    let_in[command.name] += 1
                    command.answer("ours")

    service = threading.Thread(target=answer)
    service.start()
    try:
        yield let_in
    finally:
        ended.set()
        service.join()


class _Asking:
    """Asks without waiting for the answers, and counts them: "" is an answer without refusal."""

    def __init__(self, asking: zenoh.Session) -> None:
        self._session = asking
        self.sent = 0
        self.answers: Counter[str] = Counter()

    def ask(self, key: str, payload: str = "") -> None:
        self.sent += 1
        self._session.get(f"rig/1/{key}", self._answered, payload=payload, timeout=30)

    def _answered(self, reply: zenoh.Reply) -> None:
        error = "" if reply.err is None else json.loads(reply.err.payload.to_bytes())["error"]
        self.answers[error] += 1


@pytest.fixture
def unfilled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no token come again, so that however slow the machine is a burst is all."""
    monkeypatch.setattr(admission, "PER_S", 0)


@pytest.mark.usefixtures("unfilled")
@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("cmd/status", "status"),
        ("cmd/arm", "arm"),
        ("schema/armrig.v1.Sample", "schema"),
        ("history", "history"),
    ],
)
def test_a_flood_of_queries_is_answered_up_to_a_bound(
    session: Session, where: str, key: str, name: str
) -> None:
    with _answering(session) as let_in, _connected(where) as stranger:
        asking = _Asking(stranger)
        for _ in range(2 * BURST):
            asking.ask(key)
            _until(lambda: asking.sent - asking.answers.total() < MOST_AT_ONCE)
        _until(lambda: asking.answers.total() == asking.sent)

    assert asking.answers == {"": BURST, admission.too_many(name).error: asking.sent - BURST}
    assert let_in[name] == (BURST if key.startswith("cmd/") else 0)


@pytest.mark.usefixtures("unfilled")
def test_unknown_commands_share_one_rate_limit(session: Session, where: str) -> None:
    with _answering(session), _connected(where) as stranger:
        asking = _Asking(stranger)
        for k in range(2 * BURST):
            asking.ask(f"cmd/explode-{k}")
            _until(lambda: asking.sent - asking.answers.total() < MOST_AT_ONCE)
        _until(lambda: asking.answers.total() == asking.sent)

    assert asking.answers[""] == BURST


@pytest.mark.usefixtures("unfilled")
def test_a_flood_delays_neither_a_stop_nor_a_command_of_the_holder(
    session: Session, where: str
) -> None:
    session.lease = LEASE.encode()
    ended = threading.Event()
    with (
        _answering(session) as let_in,
        _connected(where) as stranger,
        _connected(where) as holder,
    ):
        flood, asking = _Asking(stranger), _Asking(holder)

        def pour() -> None:
            while not ended.wait(0.001):
                if flood.sent - flood.answers.total() < 200:
                    for name in ("status", "arm", "reset", "explode") * 5:
                        flood.ask(f"cmd/{name}")

        pouring = threading.Thread(target=pour)
        pouring.start()
        try:
            _until(lambda: any("too many queries" in told for told in list(flood.answers)))
            for name in ("stop", "renew", "set", "disarm"):
                for _ in range(2 * BURST):
                    asking.ask(f"cmd/{name}", f'{{"lease": "{LEASE}"}}')
                    _until(lambda: asking.sent - asking.answers.total() < MOST_AT_ONCE)
            _until(lambda: asking.answers.total() == asking.sent)
        finally:
            ended.set()
            pouring.join()

    assert asking.answers == {"": asking.sent}
    assert {let_in[name] for name in ("stop", "renew", "set", "disarm")} == {2 * BURST}
