"""Access control: the messages that zenoh passes to and from a daemon or a router.

Each listening session has its own configuration. zenoh compares clients' names literally. A
subscription is permitted only if the allowed keys include all keys of the subscription. The rules
of a node also apply to the messages that the node itself sends.
"""

from __future__ import annotations

from typing import Any

from armrig_core.access.access_list import AccessList
from armrig_core.access.credential import RIG_PREFIX, ROUTER
from armrig_core.commands.commands import (
    MOST_REMOTE_BYTES,
    REQUESTS,
    CalibrateRequest,
    RunOptions,
    Status,
)
from armrig_core.rig.calibration_file import RAW_LIMIT
from armrig_core.telemetry.topics import (
    EVERY_RIG,
    STREAMS,
    alive_key,
    command_key,
    history_key,
    schema_key,
    stream_key,
)

MOST_BYTES = 4096
"""Longest payload of any command except a run and a calibration, in B."""
MOST_CALIBRATION_BYTES = (RAW_LIMIT + 2) // 3 * 4 + (1 << 16)
"""Longest payload of `calibrate`, in B: the samples, as base64, and the values."""
MOST_LOCAL_BYTES = 88 << 20  # the longest run: 20 B per sample as JSON, and its details
MOST_MESSAGE_BYTES = 8 << 20  # longest message over a network, so that no client fills the memory


def remote(rig: str, people: AccessList) -> dict[str, Any]:
    """Return the access control for a network: only operators and observers have permissions.

    `people` is the access list of rig `rig`, with the operators and the observers; a revoked client
    is in neither list. zenoh identifies the clients by the common names of their certificates.
    """
    rules, policies = _watching(rig), []
    shared = [rule["id"] for rule in rules]
    for role, commands in (("operators", "*"), ("observers", Status.name)):
        for name in getattr(people, role):
            key = command_key(rig, commands, name)
            rules += [
                _allow(f"{name} asks", "ingress", ["query"], [key]),
                _allow(f"{name} is answered", "egress", ["reply"], [key]),
            ]
            policies.append(
                {"rules": [*shared, f"{name} asks", f"{name} is answered"], "subjects": [name]}
            )
    names = (*people.operators, *people.observers)
    subjects = [{"id": name, "cert_common_names": [name]} for name in names]
    return _deny_by_default(rules, policies, subjects)


def of_router(people: AccessList) -> dict[str, Any]:
    """Return the access control of a router between the rigs and the people in its access list.

    At every rig of the router, a person has the same permissions as at a rig without a router. A
    rig may publish, answer and hold a liveliness token under its own id, and receives the requests
    to this id.
    """
    control = remote(EVERY_RIG, people)
    for name in people.rigs:
        its = _own(name.removeprefix(RIG_PREFIX))
        control["rules"] += [
            _allow(f"{name} {action}", flow, messages, keys) for action, flow, messages, keys in its
        ]
        control["policies"].append(
            {"rules": [f"{name} {action}" for action, *_ in its], "subjects": [name]}
        )
        control["subjects"].append({"id": name, "cert_common_names": [name]})
    return control


def at_router(rig: str) -> dict[str, Any]:
    """Return the access control of a daemon for the connection to its router.

    The rules are the router's rules for this rig, with ingress and egress swapped.

    The router verifies each client's certificate, and guarantees that the client's name in the key
    of a message is true.
    """
    mirrored = {"ingress": "egress", "egress": "ingress"}
    rules = [
        _allow(action, mirrored[flow], messages, keys) for action, flow, messages, keys in _own(rig)
    ]
    policies = [{"rules": [rule["id"] for rule in rules], "subjects": [ROUTER]}]
    return _deny_by_default(rules, policies, [{"id": ROUTER, "cert_common_names": [ROUTER]}])


def size_limits(rig: str) -> list[dict[str, Any]]:
    """Return zenoh's `low_pass_filter`, by which zenoh discards overlong commands unread."""
    longest = {
        name: MOST_REMOTE_BYTES for name, kind in REQUESTS.items() if issubclass(kind, RunOptions)
    }
    longest[CalibrateRequest.name] = MOST_CALIBRATION_BYTES
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
    """Return a rig's permissions at its router, each as (name, direction, messages, keys)."""
    asked = [schema_key(rig, "**"), history_key(rig), command_key(rig, "*", "*")]
    return [
        ("publishes", "ingress", ["put"], [stream_key(rig, stream) for stream in STREAMS]),
        ("is listened to", "egress", ["declare_subscriber"], [stream_key(EVERY_RIG, "*")]),
        ("is there", "ingress", ["liveliness_token"], [alive_key(rig)]),
        ("answers", "ingress", ["declare_queryable", "reply"], asked),
        ("is asked", "egress", ["query"], asked),
    ]


def _deny_by_default(rules: list[Any], policies: list[Any], subjects: list[Any]) -> dict[str, Any]:
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _watching(rig: str) -> list[dict[str, Any]]:
    """Return the rules for operators and observers: streams, schema, history, liveliness."""
    streams = [stream_key(rig, stream) for stream in STREAMS]
    any_stream, public = stream_key(rig, "*"), [schema_key(rig, "**"), history_key(rig)]
    sees = ["liveliness_query", "declare_liveliness_subscriber"]
    return [
        _allow("listen", "ingress", ["declare_subscriber"], [any_stream]),
        _allow("look for rigs", "ingress", sees, [any_stream, alive_key(EVERY_RIG)]),
        _allow("hear", "egress", ["put"], streams),
        _allow("see alive", "egress", ["liveliness_token"], [alive_key(rig)]),
        _allow("ask for schema and history", "ingress", ["query"], public),
        _allow("get schema and history", "egress", ["reply"], public),
        _allow("find", "egress", ["declare_queryable"], [*public, command_key(rig, "*", "*")]),
    ]


def _allow(rule_id: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {
        "id": rule_id,
        "permission": "allow",
        "flows": [flow],
        "messages": messages,
        "key_exprs": keys,
    }
