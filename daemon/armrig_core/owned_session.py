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
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "adminspace": {"enabled": False},
        "access_control": _ACCESS_CONTROL,
        "transport": {
            "shared_memory": {"enabled": False},
            "link": {
                "rx": {"max_message_size": most_received},
                "tx": {"queue": {"congestion_control": {"drop": {"wait_before_drop": 0}}}},
            },
        },
    }
