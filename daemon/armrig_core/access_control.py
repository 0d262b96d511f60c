"""What zenoh lets through: to a daemon, to a router, and from them. Pure.

A configuration for each way in. zenoh matches names literally. What a subscriber asks for must be
included in what is allowed. All of this holds on the very node that has it.
"""

from __future__ import annotations

from typing import Any, Literal

from armrig_core.access_list import AccessList
from armrig_core.calibration_file import RAW_LIMIT
from armrig_core.commands import MOST_REMOTE_BYTES, REQUESTS, Calibrate, Run, Status
from armrig_core.credential import RIG_PREFIX, ROUTER
from armrig_core.topics import (
    EVERY_RIG,
    STREAMS,
    alive_key,
    command_key,
    history_key,
    schema_key,
    stream_key,
)

Subject = Literal["cert_common_names", "usernames"]
"""By what zenoh knows who has connected."""
MOST_BYTES = 4096
"""Longest payload of any command but a run and a calibration."""
MOST_OF_CALIBRATION = (RAW_LIMIT + 2) // 3 * 4 + (1 << 16)
"""Longest payload of `calibrate`: its samples in base64, and its figures."""
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
    names = (*people.operators, *people.observers)
    return _denied_but(rules, policies, [{"id": name, subject: [name]} for name in names])


def of_router(people: AccessList) -> dict[str, Any]:
    """Return the access control of a router, between the rigs and the people of its access list.

    A person may do with every rig what he may do with one that he is connected to. A rig may
    publish, answer and stand alive under its own id, and is handed what is asked of it.
    """
    found = remote(EVERY_RIG, people, "cert_common_names")
    for name in people.rigs:
        its = _own(name.removeprefix(RIG_PREFIX))
        found["rules"] += [
            _allowed(f"{name} {what}", flow, messages, keys) for what, flow, messages, keys in its
        ]
        found["policies"].append(
            {"rules": [f"{name} {what}" for what, *_ in its], "subjects": [name]}
        )
        found["subjects"].append({"id": name, "cert_common_names": [name]})
    return found


def at_router(rig: str) -> dict[str, Any]:
    """Return the access control of a rig's daemon towards its router: that of a router, mirrored.

    Who has asked stands in the key; the router has seen his certificate, and vouches for it.
    """
    mirrored = {"ingress": "egress", "egress": "ingress"}
    rules = [
        _allowed(what, mirrored[flow], messages, keys) for what, flow, messages, keys in _own(rig)
    ]
    policies = [{"rules": [rule["id"] for rule in rules], "subjects": [ROUTER]}]
    return _denied_but(rules, policies, [{"id": ROUTER, "cert_common_names": [ROUTER]}])


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


def _own(rig: str) -> list[tuple[str, str, list[str], list[str]]]:
    """Return what is a rig's own, as its router sees it: what, which way, messages, keys."""
    asked = [schema_key(rig, "**"), history_key(rig), command_key(rig, "*", "*")]
    return [
        ("publishes", "ingress", ["put"], [stream_key(rig, stream) for stream in STREAMS]),
        ("is listened to", "egress", ["declare_subscriber"], [stream_key(EVERY_RIG, "*")]),
        ("is there", "ingress", ["liveliness_token"], [alive_key(rig)]),
        ("answers", "ingress", ["declare_queryable", "reply"], asked),
        ("is asked", "egress", ["query"], asked),
    ]


def _denied_but(rules: list[Any], policies: list[Any], subjects: list[Any]) -> dict[str, Any]:
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _watching(rig: str) -> list[dict[str, Any]]:
    """Return what all who are in a list may do: hear the rig, now and of late, and see it alive."""
    streams = [stream_key(rig, stream) for stream in STREAMS]
    any_stream, told = stream_key(rig, "*"), [schema_key(rig, "**"), history_key(rig)]
    sees = ["liveliness_query", "declare_liveliness_subscriber"]
    return [
        _allowed("listen", "ingress", ["declare_subscriber"], [any_stream]),
        _allowed("look for rigs", "ingress", sees, [any_stream, alive_key(EVERY_RIG)]),
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
