"""Conversion of the loop's records to the protobuf messages that are published and recorded."""

from __future__ import annotations

import msgspec
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import Outgoing

from armrig_daemon.pipe import Clock, Control, Distribution, Gap, Log, State, Timing, Trace

_DISTRIBUTIONS = ("wake_lateness_us", "device_tick_error_us", "link_round_trip_us", "queue_depth")


Published = Gap | Log | Timing | Clock | State | Control
"""Records of the loop that the service publishes."""


def outgoing(record: Published | Trace, clock_offset_ns: int) -> Outgoing:
    """Return a record as a message.

    `clock_offset_ns` is the real-time clock minus the monotonic clock, in ns, for the wall-clock
    time in the message of a log record.
    """
    match record:
        case Gap() | Clock() | Trace() | Control():
            stream = type(record).__name__.lower()
            message = protobuf.message_class(protobuf.OF_STREAM[stream])(**_fields(record))
            t_ns = record.t_to_ns if isinstance(record, Gap) else record.t_host_ns
            return _out(stream, t_ns, message.SerializeToString())
        case Timing():
            return _out("timing", record.t_host_ns, _timing(record))
        case State():
            message = protobuf.message_class(protobuf.STATE)(
                t_host_ns=record.t_host_ns,
                phase=record.phase,
                reason=record.reason,
                owner=record.owner,
                Ts_s=record.ts_us / 1e6,
                device=msgspec.json.encode(record.device).decode(),
                fault=record.fault,
                motor=record.motor,
                remedy=record.remedy,
                owner_checked=record.owner_checked,
            )
            return _out("state", record.t_host_ns, message.SerializeToString())
        case Log():
            message = protobuf.message_class(protobuf.LOG)(
                level=protobuf.LEVELS[record.level],
                message=record.message,
                name="armrigd",
                emulator_stall_ns=record.emulator_stall_ns,
            )
            if record.is_note:
                message.name = protobuf.NOTE
                message.owner = record.fields["owner"]
                message.t_host_ns = record.t_host_ns
            message.timestamp.FromNanoseconds(record.t_host_ns + clock_offset_ns)
            return _out("event", record.t_host_ns, message.SerializeToString())


def _out(stream: str, t_ns: int, data: bytes) -> Outgoing:
    return Outgoing(stream, t_ns, t_ns, 0, data)


def _fields(record: Gap | Clock | Trace | Control | Distribution) -> dict[str, object]:
    return msgspec.structs.asdict(record)


def _timing(record: Timing) -> bytes:
    message = protobuf.message_class(protobuf.TIMING)(
        t_host_ns=record.t_host_ns,
        collections=record.collections,
        cpu_pressure_percent=record.cpu_pressure_percent,
        run_queue=record.run_queue,
    )
    for name in _DISTRIBUTIONS:
        part = getattr(message, name)
        for field, value in _fields(getattr(record, name)).items():
            setattr(part, field, value)
    data: bytes = message.SerializeToString()
    return data
