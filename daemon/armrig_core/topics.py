"""Names under which a rig is found: zenoh keys, and topics of a recording with a leading slash."""

from __future__ import annotations

import re

from armrig_core.errors import InputError, InputTypeError

STREAMS = ("sample", "gap", "event", "timing", "clock", "state")
"""What a rig publishes."""
RECORDED = (*STREAMS, "trace")
"""What a recording holds: the steps of the core, too, for replay."""

EVERY_RIG = "*"
"""In place of a rig's id in a key: all of them."""
_LONGEST = 40
PLAYED = "played-"
"""How the id begins under which a recording is played again; no rig's id begins so."""


def is_rig_id(text: str) -> bool:
    """Return whether a text can be a rig's id."""
    return re.fullmatch(rf"[a-z0-9-]{{1,{_LONGEST}}}", text) is not None


def check_rig_id(rig: str) -> str:
    """Return `rig`, or raise ValueError where it cannot be part of a key."""
    _require_text(rig)
    if not is_rig_id(rig):
        raise InputError(f"rig id {rig!r}: 1 to {_LONGEST} of a-z, 0-9 and - are allowed")
    return rig


def check_own_id(rig: str) -> str:
    """Return `rig`, or raise ValueError where it cannot be a rig's: that of a recording played."""
    if check_rig_id(rig).startswith(PLAYED):
        msg = f"rig id {rig!r}: what begins with {PLAYED} is a recording that `armrig play` plays; "
        raise InputError(msg + "choose another id")
    return rig


def played_id(rig: str) -> str:
    """Return the id under which a recording of `rig` is played again, such as played-1."""
    return rig if rig.startswith(PLAYED) else f"{PLAYED}{rig}"[:_LONGEST]


def _require_text(rig: object) -> None:
    if not isinstance(rig, str):
        raise InputTypeError(f"rig id {rig!r} is no text: give its name in quotes, such as '{rig}'")


def stream_key(rig: str, stream: str) -> str:
    """Return the key of a stream, such as `rig/1/sample`."""
    return f"rig/{rig}/{stream}"


def command_key(rig: str, command: str, asker: str = "") -> str:
    """Return the key of a command, such as `rig/1/cmd/arm`.

    Over a network whoever asks stands behind it, as in `rig/1/cmd/arm/alice`: the daemon's access
    control lets each one take his own name only, so that what comes under a name is his.
    """
    return f"rig/{rig}/cmd/{command}" + (f"/{asker}" if asker else "")


def schema_key(rig: str, name: str) -> str:
    """Return the key of a schema, such as `rig/1/schema/armrig.v1.Sample`."""
    return f"rig/{rig}/schema/{name}"


def history_key(rig: str) -> str:
    """Return the key of what was published of late, such as `rig/1/history`."""
    return f"rig/{rig}/history"


def alive_key(rig: str) -> str:
    """Return the key of the liveliness token."""
    return f"rig/{rig}/alive"


def rig_of_alive(key: str) -> str:
    """Return the rig whose liveliness token has this key, "" where it is none."""
    parts = key.split("/")
    return (
        parts[1] if len(parts) == 3 and is_rig_id(parts[1]) and key == alive_key(parts[1]) else ""
    )


def topic(rig: str, stream: str) -> str:
    """Return the topic of a stream in a recording, such as `/rig/1/sample`."""
    return "/" + stream_key(rig, stream)


def stream_of(topic: str) -> str:
    """Return the stream of a topic such as /rig/1/sample, "" where it is none of ours."""
    found = re.fullmatch(r"/rig/[a-z0-9-]{1,40}/([a-z]{1,20})", topic)
    return found[1] if found and found[1] in RECORDED else ""
