"""What zenoh lets through to the daemon, and from it: a configuration for each way in. Pure.

zenoh matches names literally. What a subscriber asks for must be included in what is allowed. All
of this holds on the very node that has it.
"""

from __future__ import annotations

from typing import Any, Literal

from armrig_core.access_list import AccessList
from armrig_core.commands import MOST_REMOTE_BYTES, REQUESTS, Calibrate, Run, Status
from armrig_core.topics import (
    STREAMS,
    alive_key,
    command_key,
    history_key,
    schema_key,
    stream_key,
)

from armrig_daemon.service.admission import MOST_BYTES, MOST_OF_CALIBRATION

Subject = Literal["cert_common_names", "usernames"]
"""By what zenoh knows who has connected."""
MOST_LOCAL_BYTES = 88 << 20  # the longest run, 20 B a sample as JSON, and its details
MOST_IN_A_MESSAGE = 8 << 20  # over a network: whoever is let in could have us hold so much for him


def remote(rig: str, people: AccessList, subject: Subject) -> dict[str, Any]:
    """Return the access control of a network: whoever is in no list may do nothing.

    Parameters
    ----------
    rig : str
        Id of the rig.
    people : AccessList
        Who may what; who was revoked is in none of its two lists, like a stranger.
    subject : {"cert_common_names", "usernames"}
        By what they are known.
    """
    rules, policies = _watching(rig), []
    shared = [rule["id"] for rule in rules]
    for role, commands in (("operators", "*"), ("observers", Status.name)):
        for name in getattr(people, role):
            own = command_key(rig, commands, name)
            rules += [
                _allowed(f"{name} asks", "ingress", ["query"], [own]),
                _allowed(f"{name} is answered", "egress", ["reply"], [own]),
            ]
            policies.append(
                {"rules": [*shared, f"{name} asks", f"{name} is answered"], "subjects": [name]}
            )
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [
            {"id": name, subject: [name]} for name in (*people.operators, *people.observers)
        ],
        "policies": policies,
    }


def size_limits(rig: str) -> list[dict[str, Any]]:
    """Return zenoh's `low_pass_filter`: what is longer than a command may be is dropped unread."""
    longest = {Run.name: MOST_REMOTE_BYTES, Calibrate.name: MOST_OF_CALIBRATION}
    return [
        {
            "id": f"size of {name}",
            "flows": ["ingress"],
            "messages": ["query"],
            "key_exprs": [command_key(rig, name, "*")],
            "size_limit": longest.get(name, MOST_BYTES),
        }
        for name in REQUESTS
    ]


def _watching(rig: str) -> list[dict[str, Any]]:
    """Return what all who are in a list may do: hear the rig, now and of late, and see it alive."""
    streams = [stream_key(rig, stream) for stream in STREAMS]
    any_stream, told = stream_key(rig, "*"), [schema_key(rig, "**"), history_key(rig)]
    hears = ["declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]
    return [
        _allowed("listen", "ingress", hears, [any_stream]),
        _allowed("hear", "egress", ["put"], streams),
        _allowed("see alive", "egress", ["liveliness_token"], [alive_key(rig)]),
        _allowed("ask what is told to all", "ingress", ["query"], told),
        _allowed("get it", "egress", ["reply"], told),
        _allowed("find", "egress", ["declare_queryable"], [*told, command_key(rig, "*", "*")]),
    ]


def _allowed(what: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {
        "id": what,
        "permission": "allow",
        "flows": [flow],
        "messages": messages,
        "key_exprs": keys,
    }
