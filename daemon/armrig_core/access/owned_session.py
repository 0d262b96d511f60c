"""Configuration of a zenoh session in which only its owner, the opening program, publishes."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any, Final

from armrig_core.commands.commands import StopRequest
from armrig_core.telemetry.topics import EVERY_RIG, command_key, history_key, schema_key

_MASK: Final = 0o007  # to connect, a client needs permission to write
_LOCK: Final = Lock()
_OS_ERROR = re.compile(r"os error (\d+)")


def _deny(rule_id: str, flow: str, messages: list[str]) -> dict[str, Any]:
    return {
        "id": rule_id,
        "permission": "deny",
        "flows": [flow],
        "messages": messages,
        "key_exprs": ["**"],
    }


_OWNER_RULES = (
    _deny(
        "what only the owner does",
        "ingress",
        ["put", "delete", "declare_queryable", "reply", "liveliness_token"],
    ),
    # zenoh sends all queries to a peer that claims to be a router, even without a queryable.
    _deny("what only the owner hears", "egress", ["query"]),
)
_ACCESS_CONTROL = {
    "enabled": True,  # without this key zenoh silently ignores the others
    "default_permission": "allow",
    "rules": list(_OWNER_RULES),
    "subjects": [{"id": "all who connect"}],
    "policies": [
        {"rules": [rule["id"] for rule in _OWNER_RULES], "subjects": ["all who connect"]},
    ],
}
"""Rules that forbid clients to publish, to answer, and to hold a liveliness token.

Without these rules, zenoh would forward a message that a client publishes. The receivers could not
distinguish this message from the owner's messages, because each sender sets the source in its own
messages. A client must not receive the queries of other clients, because the query of a command
contains the lease.
"""


NOT_FOUND: dict[str, Any] = {
    "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    "adminspace": {"enabled": False},
}
"""Configuration of a session that nobody discovers and that publishes nothing about itself."""


def listening(endpoint: str) -> dict[str, Any]:
    """Return the configuration of a listener, with a short time limit on a TLS handshake."""
    hurried = f"#tls_handshake_timeout_ms={_ACCEPT_MS}" if endpoint.startswith("tls/") else ""
    return {"listen": {"endpoints": [f"{endpoint}{hurried}"]}}


_ACCEPT_MS = 3000
"""Time for a client's authentication, in ms; zenoh allows 10 s for each step.

If this time ends in the last step, the client is connected, but zenoh never reads its messages. The
time must therefore be longer than any delay of a busy machine.
"""
_MAX_SILENT = 4096  # unauthenticated connections; zenoh refuses new clients above 100
MOST_LOCAL_LINKS = 1000
"""Largest number of simultaneous links over a Unix socket."""


def strangers(most_links: int) -> dict[str, Any]:
    """Return zenoh's `transport/unicast` of a listener, with limits on unauthenticated clients."""
    return {
        "accept_timeout": _ACCEPT_MS,
        "accept_pending": _MAX_SILENT,
        "max_sessions": most_links,
    }


HELD_US = 20_000
"""Longest time for which a client that does not read may hold a thread of zenoh, in µs.

After this time zenoh closes the client's link. Only messages about declarations wait so long, the
ends of forbidden queries, and the answers to keys with an @, which no rule of zenoh finds.
"""


def lane(rule_id: str, keys: list[str], priority: str, control: str = "drop") -> dict[str, Any]:
    """Return a rule of zenoh's `qos/network`: the queue of these queries and of their answers."""
    return {
        "id": rule_id,
        "flows": ["ingress"],
        "messages": ["query"],
        "key_exprs": keys,
        "overwrite": {"congestion_control": control, "priority": priority},
    }


_STOPS = [command_key(EVERY_RIG, StopRequest.name), command_key(EVERY_RIG, StopRequest.name, "*")]
LANES = {
    "network": [
        lane("queries", ["**"], "interactive_low"),
        lane("long answers", [history_key(EVERY_RIG), schema_key(EVERY_RIG, "**")], "data_low"),
        lane("stops", _STOPS, "real_time"),
    ]
}
"""Queues of a link for the answers to its client's queries; zenoh answers as the query came in.

A client that does not read fills its own queues. zenoh then drops the client's answers at once, and
no thread waits for the client. Samples, long answers and stops have separate queues, because a
thread that waits for one queue of a link holds all senders to this queue. zenoh sends the end of a
link by the queue `background`, which therefore stays empty.
"""
_LONG_BATCHES = 16  # of 64 KiB: fifteen long answers; a longer answer would be dropped, not split


def transport(most_received: int, held_us: int = HELD_US) -> dict[str, Any]:
    """Return zenoh's `transport` settings of a session that never waits for a client.

    `most_received` is the longest received message, in B. `held_us` is the longest time for which a
    message that may not be dropped waits for a link, in µs.
    """
    control = {"drop": {"wait_before_drop": 0}, "block": {"wait_before_close": held_us}}
    return {
        "shared_memory": {"enabled": False},
        "link": {
            "rx": {"max_message_size": most_received},
            "tx": {"queue": {"congestion_control": control, "size": {"data_low": _LONG_BATCHES}}},
        },
    }


def session_configuration(endpoint: str, *, most_received: int) -> dict[str, Any]:
    """Return the configuration of a session that listens only at `endpoint` and is not discovered.

    `most_received` is the longest received message, in B.
    """
    return {
        "mode": "peer",
        "listen": {"endpoints": [endpoint]},
        **NOT_FOUND,
        "access_control": _ACCESS_CONTROL,
        "qos": LANES,
        "transport": transport(most_received) | {"unicast": strangers(MOST_LOCAL_LINKS)},
    }


def os_error_number(err: Exception) -> int | None:
    """Return the errno in the text of an error of zenoh; None if the text contains no errno."""
    match = _OS_ERROR.search(str(err))
    return int(match[1]) if match else None


@contextmanager
def group_may_open() -> Iterator[None]:
    """Permit the owner's group to open the sockets that the block creates.

    All threads of a process share the mask of file modes. Only one thread at a time changes the
    mask, so that each block restores the original mask.

    Examples
    --------
    >>> with group_may_open():
    ...     pass
    """
    with _LOCK:
        before = os.umask(_MASK)
        try:
            yield
        finally:
            os.umask(before)
