"""Rigs whose daemons run now: their ids, found by liveliness tokens; their status, also as text."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import msgspec
import zenoh
from armrig_core.commands.commands import Status, StatusReport
from armrig_core.errors import MalformedReplyError
from armrig_core.process.printable import plural
from armrig_core.telemetry.topics import EVERY_RIG, alive_key, command_key, rig_of_alive

from armrig.rig.replies import refusal_of, reply_of
from armrig.rig.session import (
    Connection,
    RigError,
    connect_setting,
    default_endpoint,
    local_rigs,
    open_connection,
    open_endpoint,
)

MOST_RIGS = 500
"""Largest number of listed rigs; a lab's router serves fewer rigs."""
_LOOK_TIMEOUT_S = 2.0
_STATUS_TIMEOUT_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveRig:
    """A rig whose daemon runs."""

    rig: str
    endpoint: str
    """Endpoint at which the rig was found."""
    status: StatusReport | None
    """Status of the rig; None if the rig does not answer."""
    why: str = ""
    """Reason for a missing status."""


def live_rigs(connect: str | None) -> tuple[str, list[LiveRig]]:
    """Return the searched endpoint, or "this machine", and the rigs found there, sorted by id.

    The endpoint, of a router or a daemon, is by default the endpoint in `[client]`. If there is no
    endpoint, all daemons of this machine are queried.

    Raises RigError if nobody listens at the endpoint, or the connection cannot be used.
    """
    if where := connect or connect_setting():
        connection = open_endpoint(where)
        with connection.session:
            return where, _all_of(connection)
    rigs = []
    for rig in local_rigs():
        try:
            connection = open_connection(None, rig=rig)
        except RigError as err:
            rigs.append(LiveRig(rig=rig, endpoint=default_endpoint(rig), status=None, why=str(err)))
            continue
        with connection.session:
            rigs += _all_of(connection)
    return "this machine", rigs


def ids_alive(session: zenoh.Session) -> list[str]:
    """Return the ids of the rigs whose daemons run now."""
    replies = session.liveliness().get(alive_key(EVERY_RIG), timeout=_LOOK_TIMEOUT_S)
    keys = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
    return sorted({rig for key in keys if (rig := rig_of_alive(key))})[:MOST_RIGS]


def _all_of(connection: Connection) -> list[LiveRig]:
    """Return the rigs at an endpoint; all queries are sent before the first reply is awaited."""
    ids = ids_alive(connection.session)
    question = msgspec.json.encode(Status())
    pending = [
        connection.session.get(
            command_key(rig, Status.name, connection.name),
            payload=question,
            timeout=_STATUS_TIMEOUT_S,
        )
        for rig in ids
    ]
    return [
        _read_status(rig, connection.endpoint, replies)
        for rig, replies in zip(ids, pending, strict=True)
    ]


def _read_status(rig: str, endpoint: str, replies: Iterable[zenoh.Reply]) -> LiveRig:
    why = "does not answer"
    try:
        for reply in replies:
            if reply.ok is not None:
                status = reply_of(Status.name, reply.ok.payload.to_bytes(), StatusReport)
                return LiveRig(rig=rig, endpoint=endpoint, status=status)
            if reply.err is not None and str(reply.err.payload) != "Timeout":
                why = refusal_of(Status.name, reply.err.payload.to_bytes()).error
    except MalformedReplyError as err:
        why = f"is not an armrigd of this version: {err}"
    return LiveRig(rig=rig, endpoint=endpoint, status=None, why=why)


def status_rows(report: StatusReport) -> list[tuple[str, str]]:
    """Return the names and values of a status as text; for a fault, also its cause and remedy.

    The texts may contain unprintable characters: escape them before printing.
    """
    last = report.last_run
    device = ", ".join(f"{name} {value}" for name, value in report.device.items())
    silent = report.line or ("" if device else "has not answered yet")
    return [
        ("rig", f"{report.rig}, armrig {report.version}, at {report.endpoint}"),
        ("phase", report.phase),
        *(
            row
            for row in (("fault", f"{report.fault}: {report.reason}"), ("to do", report.remedy))
            if report.reason
        ),
        *([("device", silent)] if silent else []),
        ("motor" if report.described.arm else "input", report.motor or "not known"),
        ("owner", report.owner or "nobody"),
        (
            "last run",
            "none"
            if last is None
            else f"{last.recording}, {plural(last.samples, 'sample')}, "
            + (last.outcome if last.finished else f"running; {last.synced} are on the disk"),
        ),
        ("recordings", report.recordings),
        ("Ts", f"{report.Ts:g} s"),
        ("limits", "; ".join(_limit_texts(report))),
        *_rig_rows(report),
        ("host", "; ".join(scheduling_sentences(report.host))),
        *([("device", device)] if not silent else []),
    ]


def _limit_texts(report: StatusReport) -> Iterable[str]:
    """Yield the limits of the voltage and of each output as text."""
    port = report.described.input
    volts = f"{report.u_min:g} to {report.u_max:g} V"
    yield port.both(report.u_min, report.u_max) if port.is_scaled else volts
    units = {channel.name: channel.unit for channel in report.described.channels}
    for name, limit in report.limits.items():
        ends = (("at least", limit.low), ("at most", limit.high))
        parts = [f"{side} {end:g} {units.get(name, '')}" for side, end in ends if end is not None]
        parts += [f"less than {limit.turns:g} turns in a run"] if limit.turns else []
        yield f"{name} {', '.join(parts)}"


def _rig_rows(report: StatusReport) -> list[tuple[str, str]]:
    """Return the rows about the calibration and the arm, or about the outputs of another rig."""
    described = report.described
    if not described.arm:
        return described.rows()[:-1]
    return [
        ("calibration", report.calibration or "not reported by this daemon"),
        ("arm", "removed, according to [arm] removed" if report.arm_removed else "mounted"),
    ]


def scheduling_sentences(host: dict[str, Any]) -> list[str]:
    """Return the daemon's report on real-time scheduling as a list of sentences."""
    if not host:
        return ["not known yet"]
    fifo = host.get("fifo")
    sentences = [f"real-time scheduling at priority {fifo}" if fifo else "no real-time scheduling"]
    refused = host.get("refused", [])
    sentences += [
        f"not allowed: {call}" for call in (refused if isinstance(refused, list) else [refused])
    ]
    return sentences


def scheduling_line(host: dict[str, Any]) -> str:
    """Return the daemon's report on real-time scheduling as one line, without the remedies."""
    scheduling, *refused = scheduling_sentences(host)
    if not refused:
        return scheduling
    settings = plural(len(refused), "setting")
    return f"{scheduling}: the host refuses {settings}; `armrig doctor` shows the remedies"
