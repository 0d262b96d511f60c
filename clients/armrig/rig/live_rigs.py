"""The rigs that are there now: found by their liveliness tokens, and asked how they are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import msgspec
import zenoh
from armrig_core.commands import Status, StatusReport
from armrig_core.errors import MalformedReplyError
from armrig_core.topics import EVERY_RIG, alive_key, command_key, rig_of_alive

from armrig.rig.replies import refusal_of, reply_of
from armrig.rig.session import (
    Connection,
    RigError,
    configured_connect,
    default_endpoint,
    local_rigs,
    open_connection,
    open_endpoint,
)

MOST_RIGS = 500
"""More are not listed: what is connected there is no lab's router."""
_LOOK_S = 2.0
_STATUS_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveRig:
    """A rig that is there."""

    rig: str
    endpoint: str
    """Where it was found."""
    status: StatusReport | None
    """None where it does not answer."""
    why: str = ""
    """Why there is no status."""


def live_rigs(connect: str | None) -> tuple[str, list[LiveRig]]:
    """Return where was looked, and the rigs that are there, by their ids.

    Parameters
    ----------
    connect : str, optional
        Endpoint of a router or a daemon; None is that of `[client]`, and where that names none all
        daemons of this machine.

    Raises
    ------
    RigError
        Nobody listens there, or the way there cannot be used.
    """
    if where := connect or configured_connect():
        connection = open_endpoint(where)
        with connection.session:
            return where, _all_of(connection)
    found = []
    for rig in local_rigs():
        try:
            connection = open_connection(None, rig=rig)
        except RigError as err:
            found.append(
                LiveRig(rig=rig, endpoint=default_endpoint(rig), status=None, why=str(err))
            )
            continue
        with connection.session:
            found += _all_of(connection)
    return "this machine", found


def ids_alive(session: zenoh.Session) -> list[str]:
    """Return the ids of the rigs that are there now."""
    replies = session.liveliness().get(alive_key(EVERY_RIG), timeout=_LOOK_S)
    keys = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
    return sorted({rig for key in keys if (rig := rig_of_alive(key))})[:MOST_RIGS]


def _all_of(connection: Connection) -> list[LiveRig]:
    """Return the rigs at an endpoint; all are asked before the first is waited for."""
    ids = ids_alive(connection.session)
    question = msgspec.json.encode(Status())
    asked = [
        connection.session.get(
            command_key(rig, Status.name, connection.name), payload=question, timeout=_STATUS_S
        )
        for rig in ids
    ]
    return [
        _answered(rig, connection.endpoint, replies)
        for rig, replies in zip(ids, asked, strict=True)
    ]


def _answered(rig: str, endpoint: str, replies: Iterable[zenoh.Reply]) -> LiveRig:
    why = "does not answer"
    try:
        for reply in replies:
            if reply.ok is not None:
                status = reply_of(Status.name, reply.ok.payload.to_bytes(), StatusReport)
                return LiveRig(rig=rig, endpoint=endpoint, status=status)
            if reply.err is not None and str(reply.err.payload) != "Timeout":
                why = refusal_of(Status.name, reply.err.payload.to_bytes()).error
    except MalformedReplyError as err:
        why = f"is no armrigd of this version: {err}"
    return LiveRig(rig=rig, endpoint=endpoint, status=None, why=why)
