"""Configuration of a zenoh session in which only its owner, the opening program, publishes."""

from __future__ import annotations

import re
from typing import Any

_OS_ERROR = re.compile(r"os error (\d+)")


def _denied(what: str, flow: str, messages: list[str]) -> dict[str, Any]:
    return {
        "id": what,
        "permission": "deny",
        "flows": [flow],
        "messages": messages,
        "key_exprs": ["**"],
    }


_OWNER_RULES = (
    _denied(
        "what only the owner does",
        "ingress",
        ["put", "delete", "declare_queryable", "reply", "liveliness_token"],
    ),
    # zenoh sends all queries to a peer that claims to be a router, even without a queryable.
    _denied("what only the owner hears", "egress", ["query"]),
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


_ACCEPT_MS = 3000  # time for a client's authentication; zenoh allows 10 s for each step


def listening(endpoint: str) -> dict[str, Any]:
    """Return the configuration of a listener, with a short time limit on a TLS handshake."""
    hurried = f"#tls_handshake_timeout_ms={_ACCEPT_MS}" if endpoint.startswith("tls/") else ""
    return {"listen": {"endpoints": [f"{endpoint}{hurried}"]}}


def strangers(most_links: int) -> dict[str, Any]:
    """Return zenoh's `transport/unicast` of a listener, with limits on unauthenticated clients."""
    return {"accept_timeout": _ACCEPT_MS, "max_sessions": most_links}


ROUTED_US = 1_000_000
"""Longest time for which a client that does not read may block a router, in µs.

After this time, the client's link is closed. zenoh's default of 5 s is longer than the time for
which a loop runs without its service.
"""


def transport(most_received: int, answer_us: int | None = None) -> dict[str, Any]:
    """Return zenoh's `transport` settings of a session that never waits for a subscriber.

    Parameters
    ----------
    most_received : int
        Longest received message, in B.
    answer_us : int, optional
        Time for which an answer or a query may wait for a client that does not read, in µs; the
        default is zenoh's own limit.
    """
    control: dict[str, Any] = {"drop": {"wait_before_drop": 0}}
    if answer_us is not None:
        control["block"] = {"wait_before_close": answer_us}
    return {
        "shared_memory": {"enabled": False},
        "link": {
            "rx": {"max_message_size": most_received},
            "tx": {"queue": {"congestion_control": control}},
        },
    }


def owned_session(endpoint: str, *, most_received: int) -> dict[str, Any]:
    """Return the configuration of a session that listens only at `endpoint` and is not discovered.

    Parameters
    ----------
    most_received : int
        Longest received message, in B.
    """
    return {
        "mode": "peer",
        "listen": {"endpoints": [endpoint]},
        **NOT_FOUND,
        "access_control": _ACCESS_CONTROL,
        "transport": transport(most_received),
    }


def os_error_number(err: Exception) -> int | None:
    """Return the errno in the text of an error of zenoh; None if the text contains no errno."""
    found = _OS_ERROR.search(str(err))
    return int(found[1]) if found else None
