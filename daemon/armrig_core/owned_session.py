"""The configuration of a zenoh session that its owner alone publishes and answers in."""

from __future__ import annotations

from typing import Any


def _denied(what: str, flow: str, messages: list[str]) -> dict[str, Any]:
    return {
        "id": what,
        "permission": "deny",
        "flows": [flow],
        "messages": messages,
        "key_exprs": ["**"],
    }


_OURS_ALONE = (
    _denied(
        "what only the owner does",
        "ingress",
        ["put", "delete", "declare_queryable", "reply", "liveliness_token"],
    ),
    # A peer that says it is a router is passed all questions, queryable or not.
    _denied("what only the owner hears", "egress", ["query"]),
)
_ACCESS_CONTROL = {
    "enabled": True,  # without it all of this is passed over in silence
    "default_permission": "allow",
    "rules": list(_OURS_ALONE),
    "subjects": [{"id": "all who connect"}],
    "policies": [
        {"rules": [rule["id"] for rule in _OURS_ALONE], "subjects": ["all who connect"]},
    ],
}
"""What who connects may not do: publish, answer, or stand for the owner. We would pass it on, and
the others could not tell it from ours: zenoh's source of a sample is what its sender writes. Nor
may he hear what others ask: a command carries the lease."""


NOT_FOUND: dict[str, Any] = {
    "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    "adminspace": {"enabled": False},
}
"""The configuration of a session that is found by nobody, and tells nobody about itself."""


_ACCEPT_MS = 3000  # how long somebody may take to say who he is; zenoh has 10 s for each step


def listening(endpoint: str) -> dict[str, Any]:
    """Return the configuration of who listens for strangers, who have little time to prove much."""
    hurried = f"#tls_handshake_timeout_ms={_ACCEPT_MS}" if endpoint.startswith("tls/") else ""
    return {"listen": {"endpoints": [f"{endpoint}{hurried}"]}}


def strangers(most_links: int) -> dict[str, Any]:
    """Return zenoh's `transport/unicast` of who listens for strangers."""
    return {"accept_timeout": _ACCEPT_MS, "max_sessions": most_links}


ROUTED_US = 1_000_000
"""How long a router's way may be held up by who does not read, in µs; his link is closed then.

zenoh's own 5 s are longer than a loop goes on without its service.
"""


def transport(most_received: int, answer_us: int | None = None) -> dict[str, Any]:
    """Return zenoh's `transport` of a session that waits for no subscriber.

    Parameters
    ----------
    most_received : int
        Longest message that is received, in B.
    answer_us : int, optional
        How long an answer or a question may wait for who does not read; zenoh's own by default.
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
    """Return the configuration of a session that only listens at `endpoint`, found by nobody.

    Parameters
    ----------
    most_received : int
        Longest message that is received, in B.
    """
    return {
        "mode": "peer",
        "listen": {"endpoints": [endpoint]},
        **NOT_FOUND,
        "access_control": _ACCESS_CONTROL,
        "transport": transport(most_received),
    }
