"""The service's zenoh session, with real peers that mean no good."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh
from armrig_daemon.publish import Command, Kind, Session

WITHIN_S = 5.0
SPREAD_S = 0.5
"""What a stranger declares is with the others long before, where it gets there at all."""
FORGED, OURS = b"forged", b"ours"
MODES = ["client", "peer", "router"]


@pytest.fixture
def where() -> Iterator[str]:
    """Give an endpoint; not pytest's own directory, whose path may be too long for a socket."""
    with tempfile.TemporaryDirectory(prefix="armrig-") as directory:
        yield f"unixsock-stream/{Path(directory)}/1.sock"


@pytest.fixture
def session(where: str) -> Iterator[Session]:
    """Give the session of a service that does nothing by itself."""
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
def test_nobody_else_publishes_what_a_watcher_hears(
    session: Session, where: str, mode: str
) -> None:
    """Whatever he declares, and whosever he says that his samples are."""
    ours = session._publishers["sample"]
    with _connected(where) as watcher, _connected(where, mode) as stranger:
        heard: list[bytes] = []
        watcher.declare_subscriber(
            "rig/1/sample", lambda sample: heard.append(sample.payload.to_bytes())
        )
        publisher = stranger.declare_publisher("rig/1/sample")
        _until(lambda: ours.matching_status and publisher.matching_status)
        for sn in range(50):
            publisher.put(FORGED)
            stranger.put("rig/1/sample", FORGED, source_info=zenoh.SourceInfo(ours.id, sn))
            stranger.delete("rig/1/sample")
            time.sleep(0.01)  # else his own end of the line may drop them
        # A question of his comes behind all of them: then they have been dealt with.
        list(stranger.get("rig/1/schema/armrig.v1.Sample", timeout=WITHIN_S))
        session.put("sample", OURS)
        _until(lambda: OURS in heard)

    assert set(heard) == {OURS}


@pytest.mark.parametrize("mode", MODES)
def test_nobody_else_answers_a_question(session: Session, where: str, mode: str) -> None:
    """Not even one whose queryable is of the very command."""

    def forge(query: zenoh.Query) -> None:
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
            _until(lambda found=commands: found.extend(session.waiting(Kind.STATUS)) or found)
            for command in commands:
                command.answer("ours")
            assert [r.ok.payload.to_bytes() for r in replies if r.ok] == [b'"ours"']


@pytest.mark.parametrize("mode", MODES)
def test_nobody_else_stands_for_a_daemon(session: Session, where: str, mode: str) -> None:
    """Who listens goes by its token: with the daemon's gone there is none."""
    with _connected(where) as client, _connected(where, mode) as stranger:

        def alive() -> int:
            return len(list(client.liveliness().get("rig/1/*", timeout=WITHIN_S)))

        tokens = [stranger.liveliness().declare_token(f"rig/1/{key}") for key in ("alive", "a")]
        time.sleep(SPREAD_S)
        assert alive() == 1
        session._alive.undeclare()
        _until(lambda: alive() == 0)
        for token in tokens:  # it is withdrawn where nobody keeps it
            token.undeclare()
