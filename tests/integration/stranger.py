"""A program that tries every operation of zenoh on every key, and prints the results as JSON.

`python -m tests.integration.stranger ENDPOINT AUTHORITY NAME [CREDENTIAL]`. The program is no
client of armrig. It knows what anybody may know: the keys, the authority's certificate and the
operators' names. With the name "watch" it listens until its standard input ends, and then prints
the senders of the forgeries that it received.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import zenoh
from armrig_core.commands.commands import REQUESTS
from armrig_core.telemetry.topics import STREAMS

TIMES = int(os.environ.get("STRANGER_TIMES", "20"))
OPERATOR, WATCHER = "alice", "carol"
LIE = b"forged"
STREAM_KEYS = [f"rig/1/{stream}" for stream in STREAMS]
TOLD_KEYS = ["rig/1/schema/armrig.v1.Sample", "rig/1/schema/cmd/run", "rig/1/history"]
WILD_KEYS = ["rig/1/*", "rig/1/**", "rig/*/sample", "**", "rig/1/cmd/**", "rig/1/cmd/arm/*"]
ALIVE = "rig/1/alive"
FORGED = "rig/1/forged"
_LOOK_S = 0.1
_ROUND_S = 0.08
Counts = dict[str, int]
ANY: dict[str, Any] = {
    "target": zenoh.QueryTarget.ALL,
    "consolidation": zenoh.ConsolidationMode.NONE,  # else one reply of a key hides another
}


def command_keys(name: str) -> list[str]:
    """Return the keys of all commands, as `name` may query them."""
    return [f"rig/1/cmd/{command}/{name}" for command in REQUESTS]


def every_key(name: str) -> list[str]:
    """Return every key, another rig's, and those with wildcards."""
    commands = [f"rig/1/cmd/{command}" for command in REQUESTS]
    return [
        *(*STREAM_KEYS, ALIVE, *TOLD_KEYS, *WILD_KEYS, *commands),
        *dict.fromkeys((*command_keys(name), *command_keys(OPERATOR))),
    ]


def opened(endpoint: str, authority: str, credential: str) -> zenoh.Session | None:
    """Return a connected session; None if it is refused."""
    tls: dict[str, Any] = {"root_ca_certificate": authority}
    if credential:
        tls |= {"connect_private_key": credential, "connect_certificate": credential}
        tls |= {"enable_mtls": True}
    config = {
        "mode": "client",
        "connect": {"endpoints": [endpoint]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"link": {"tls": tls}},
    }
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    except zenoh.ZError:
        return None


def anywhere(endpoint: str) -> zenoh.Session:
    """Return the session of a default peer, which discovers others by itself."""
    config = {"connect": {"endpoints": [endpoint], "exit_on_failure": False, "timeout_ms": 0}}
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def main(endpoint: str, authority: str, name: str, credential: str = "") -> None:
    """Try everything, and print the results."""
    if name == "watch":
        watch(endpoint, authority, credential)
        return
    links = 0
    session = None
    for _ in range(TIMES):
        if session is not None:
            session.close()
        session = opened(endpoint, authority, credential)
        links += session is not None
    if session is not None:
        session.close()

    def enter() -> zenoh.Session:
        return opened(endpoint, authority, credential) or anywhere(endpoint)

    found: dict[str, Any] = {"links": links, **tried(enter, name)}
    print(json.dumps(found), flush=True)


def tried(enter: Callable[[], zenoh.Session], name: str) -> dict[str, Counts]:
    """Return the successes of each operation on each key, and the received messages."""
    with enter() as session:
        asked = _asked(session, name)
    return asked | _heard(enter, every_key(name))


def _asked(session: zenoh.Session, name: str) -> dict[str, Counts]:
    """Return how often each question was answered, and whose questions came here."""
    overheard: Counter[str] = Counter()
    keys = every_key(name)
    for key in ("**", "rig/1/cmd/*/*", f"rig/1/cmd/status/{WATCHER}"):
        session.declare_queryable(key, lambda query: _overhear(query, overheard))
    session.liveliness().declare_token(FORGED)
    for key in keys:
        for _ in range(TIMES):
            session.put(key, f"forged by {name}", attachment=f"forged by {name}")
            session.delete(key, attachment=f"forged by {name}")
        time.sleep(0.002)  # else our own end of the line drops them
    return {
        "query": {key: _count(lambda key=key: _answered(session, key)) for key in keys},
        "liveliness": {key: _count(lambda key=key: _alive(session, key)) for key in keys},
        # Other strangers may answer, too; the watcher's query reaches only the daemon.
        "overhear": {key: n for key, n in overheard.items() if key.endswith(f"/{WATCHER}")},
    }


def _count(what: Callable[[], bool]) -> int:
    return sum(what() for _ in range(TIMES))


def _overhear(query: zenoh.Query, overheard: Counter[str]) -> None:
    overheard[str(query.key_expr)] += 1
    with query:
        query.reply(query.key_expr, LIE)


def _answered(session: zenoh.Session, key: str) -> bool:
    return answers(session.get(key, payload="{}", timeout=5, **ANY)) > 0


def answers(replies: Iterable[zenoh.Reply]) -> int:
    """Return how often the daemon has answered: of those who look for others some find each other.

    It says JSON, and a refusal is an answer.
    """
    texts = [(r.ok or r.err).payload.to_bytes() for r in replies]
    return sum(text != LIE and text not in (b"", b"Timeout") for text in texts)


def _alive(session: zenoh.Session, key: str) -> bool:
    """Return whether a daemon is visible."""
    replies = session.liveliness().get(key, timeout=5)
    return any(str(r.ok.key_expr) == ALIVE for r in replies if r.ok is not None)


def _heard(enter: Callable[[], zenoh.Session], keys: list[str]) -> dict[str, Counts]:
    """Return in how many rounds each key was heard, and each token's coming seen."""
    heard: dict[str, Counter[str]] = {"subscribe": Counter(), "tokens": Counter()}
    # A sample that comes for one is given to each of its session that fits it, also to one that was
    # declared while it was on its way: those that may be allowed apart.
    apart = [STREAM_KEYS, ["rig/1/*"], ["rig/*/sample"], [ALIVE]]
    groups = [[key for key in keys if not any(key in group for group in apart)], *apart]
    sessions = [enter() for _ in groups]
    for session, group in [*zip(sessions, groups, strict=True)] * TIMES:
        met: dict[str, set[str]] = {"subscribe": set(), "tokens": set()}
        declared: list[Any] = []
        for key in group:
            hear, see = partial(_hear, met["subscribe"], key), partial(_see, met["tokens"], key)
            declared += [
                session.declare_subscriber(key, hear),
                session.liveliness().declare_subscriber(key, see, history=True),
            ]
        time.sleep(_ROUND_S)
        for what in declared:
            what.undeclare()
        for kind, found in met.items():
            heard[kind].update(found)
    for session in sessions:
        session.close()
    return {kind: dict(found) for kind, found in heard.items()}


def _hear(met: set[str], key: str, sample: zenoh.Sample) -> None:
    if sample.attachment is None:  # else another stranger's
        met.add(key)


def _see(met: set[str], key: str, sample: zenoh.Sample) -> None:
    if str(sample.key_expr) == ALIVE:
        met.add(key)


def watch(endpoint: str, authority: str, credential: str) -> None:
    """Listen as an operator, query all the while, and print the forgeries."""
    session = opened(endpoint, authority, credential)
    assert session is not None
    forged: Counter[str] = Counter()
    heard: Counter[str] = Counter()

    def hear(sample: zenoh.Sample) -> None:
        text = b"" if sample.attachment is None else sample.attachment.to_bytes()
        if text.startswith(b"forged by "):
            kind = "PUT" if sample.kind == zenoh.SampleKind.PUT else "DELETE"
            forged[f"{kind} {text[10:].decode()}"] += 1
        heard[str(sample.key_expr)] += 1

    def see(sample: zenoh.Sample) -> None:
        forged[f"TOKEN {sample.key_expr}"] += str(sample.key_expr) == FORGED

    with session:
        for key in ("rig/1/*", "rig/1/cmd/*"):
            session.declare_subscriber(key, hear)
        session.liveliness().declare_subscriber("rig/1/*", see, history=True)
        print("there", flush=True)
        while not _ended(_LOOK_S):
            for reply in session.get(f"rig/1/cmd/status/{WATCHER}", timeout=5, **ANY):
                if reply.ok is not None and reply.ok.payload.to_bytes() == LIE:
                    forged["REPLY"] += 1
    print(json.dumps({"forged": dict(forged), "heard": dict(heard)}), flush=True)


def _ended(within_s: float) -> bool:
    import select

    return bool(select.select([sys.stdin], [], [], within_s)[0])


if __name__ == "__main__":
    main(*sys.argv[1:])
