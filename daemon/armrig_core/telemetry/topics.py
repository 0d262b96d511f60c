"""Names of a rig's streams and commands: zenoh keys, and topics of a recording."""

from __future__ import annotations

import re

from armrig_core.errors import InputError, InputTypeError

STREAMS = ("sample", "gap", "event", "timing", "clock", "state", "control")
"""Streams that a rig publishes; `control` contains the decisions of a control law."""
RECORDED = (*STREAMS, "trace")
"""Streams that a recording contains; `trace` contains the inputs of the daemon's decisions."""

EVERY_RIG = "*"
"""Wildcard for a rig's id in a key: all rigs."""
_MAX_LENGTH = 40
PLAYED = "played-"
"""First characters of the ids under which recordings are played; no rig has such an id."""


def is_rig_id(text: str) -> bool:
    """Return whether a text can be a rig's id."""
    return re.fullmatch(rf"[a-z0-9-]{{1,{_MAX_LENGTH}}}", text) is not None


def check_rig_id(rig: str) -> str:
    """Return `rig`; raise ValueError if it cannot be part of a key."""
    if not isinstance(rig, str):
        raise InputTypeError(f"rig id {rig!r} is not text: give the id in quotes, such as '{rig}'")
    if not is_rig_id(rig):
        raise InputError(f"rig id {rig!r}: use 1 to {_MAX_LENGTH} characters, each a-z, 0-9 or -")
    return rig


def check_own_id(rig: str) -> str:
    """Return `rig`; raise ValueError if the id is invalid or begins with `PLAYED`."""
    if check_rig_id(rig).startswith(PLAYED):
        msg = f"rig id {rig!r}: an id that begins with {PLAYED} belongs to a recording that "
        raise InputError(msg + "`armrig play` plays; choose another id")
    return rig


def playback_id(rig: str) -> str:
    """Return the id under which a recording of `rig` is played again, such as played-1."""
    return rig if rig.startswith(PLAYED) else f"{PLAYED}{rig}"[:_MAX_LENGTH]


def stream_key(rig: str, stream: str) -> str:
    """Return the key of a stream, such as `rig/1/sample`."""
    return f"rig/{rig}/{stream}"


def command_key(rig: str, command: str, asker: str = "") -> str:
    """Return the key of a command, such as `rig/1/cmd/arm`.

    Over a network, the client's name follows the command, as in `rig/1/cmd/arm/alice`. The daemon's
    access control permits each client only its own name. A name in a key therefore identifies a
    client.
    """
    return f"rig/{rig}/cmd/{command}" + (f"/{asker}" if asker else "")


def schema_key(rig: str, name: str) -> str:
    """Return the key of a schema, such as `rig/1/schema/armrig.v1.Sample`."""
    return f"rig/{rig}/schema/{name}"


def history_key(rig: str) -> str:
    """Return the key of the recent messages, such as `rig/1/history`."""
    return f"rig/{rig}/history"


def alive_key(rig: str) -> str:
    """Return the key of the liveliness token."""
    return f"rig/{rig}/alive"


def rig_of_alive(key: str) -> str:
    """Return the rig whose liveliness token has this key; "" for any other key."""
    rig = key.removeprefix("rig/").removesuffix("/alive")
    return rig if is_rig_id(rig) and key == alive_key(rig) else ""


def topic(rig: str, stream: str) -> str:
    """Return the topic of a stream in a recording, such as `/rig/1/sample`."""
    return "/" + stream_key(rig, stream)


def stream_of(topic: str) -> str:
    """Return the stream of a topic such as /rig/1/sample; "" for another program's topic."""
    match = re.fullmatch(r"/rig/[a-z0-9-]{1,40}/([a-z]{1,20})", topic)
    return match[1] if match and match[1] in RECORDED else ""
