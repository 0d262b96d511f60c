"""A program that connects again and again without permission, and prints its counts as JSON.

`python -m tests.integration.besieger ENDPOINT AUTHORITY NAME CREDENTIAL` reads one line from
its standard input. The line has the number of connections and the number of messages on each.
Or it has "flood" and a time in seconds, in which the program sends too many and too long messages
without a pause.
"""

from __future__ import annotations

import json
import sys
import time
from collections import Counter
from typing import Any

import zenoh

from tests.integration.stranger import (
    ANY,
    LIE,
    OPERATOR,
    STREAM_KEYS,
    answers,
    command_keys,
    opened,
)

_OVERSIZE = bytes(7 << 20)  # inside of what the connection stands, far beyond any command
_HUGE = bytes(9 << 20)  # beyond it: dropped piece by piece


def main(endpoint: str, authority: str, name: str, credential: str) -> None:
    """Obey the line of the standard input."""
    words = sys.stdin.readline().split()
    reach = endpoint, authority, credential
    if words[0] == "flood":
        found = flood(reach, name, float(words[1]))
    else:
        found = besiege(reach, name, int(words[0]), int(words[1]))
    print(json.dumps(found), flush=True)


def besiege(
    reach: tuple[str, str, str], name: str, connections: int, messages: int
) -> dict[str, int]:
    """Return how many links there were, messages sent, replies got and samples heard."""
    found: Counter[str] = Counter()
    # An observer may listen and request the state; permitted operations are not tried here.
    commands = [key for key in command_keys(OPERATOR) if not key.endswith(f"status/{name}")]
    commands += [key for key in command_keys(name) if name != "bob" or "/status/" not in key]
    for _ in range(connections):
        session = opened(*reach)
        found["connections"] += 1
        if session is None:
            continue
        found["links"] += 1
        with session:

            def hear(sample: zenoh.Sample) -> None:
                found["heard"] += (
                    sample.attachment is None
                )  # otherwise it is a forgery, its own or another's

            for heard in ("rig/1/**", *(STREAM_KEYS if name != "bob" else ())):
                session.declare_subscriber(heard, hear)
            for k in range(messages):
                _one(session, name, k, commands, found)
            found["messages"] += messages
    return dict(found)


def _one(
    session: zenoh.Session, name: str, k: int, commands: list[str], found: Counter[str]
) -> None:
    """Send one message: in turn a sample, the end of one, and commands."""
    text = f"forged by {name}"
    if k % 4 == 0:
        session.put(STREAM_KEYS[k % len(STREAM_KEYS)], text, attachment=text)
    elif k % 4 == 1:
        session.delete(STREAM_KEYS[k % len(STREAM_KEYS)], attachment=text)
    else:
        key = commands[k % len(commands)]
        found["replies"] += answers(session.get(key, payload="{}", timeout=5, **ANY))


def flood(reach: tuple[str, str, str], name: str, seconds: float) -> dict[str, int]:
    """Request the state a thousand times a second, and send too long messages, for a time."""
    found: Counter[str] = Counter()
    until = time.monotonic() + seconds
    session: Any = None
    while time.monotonic() < until:
        session = session or opened(*reach)
        if session is None:
            continue
        for payload in (*[b"{}"] * 300, _OVERSIZE, *[LIE] * 300, _HUGE):
            session.get(f"rig/1/cmd/status/{name}", lambda _: None, payload=payload, timeout=5)
            session.put("rig/1/sample", LIE)
            found["messages"] += 2
            found["bytes"] += len(payload)
            time.sleep(0.001)
        session.close()
        session = None
    return dict(found)


if __name__ == "__main__":
    main(*sys.argv[1:])
