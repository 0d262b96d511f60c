"""Protobuf descriptors of all published messages, built from one table.

The daemon serves the descriptors under `rig/<id>/schema/**` and writes them into each recording.
Any protobuf library can therefore read the messages without armrig.
"""

from __future__ import annotations

from functools import cache
from math import nan
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

from armrig_core.rig.channels import DeviceChannel
from armrig_core.telemetry.channels import CHANNELS, SAMPLE_FIELDS
from armrig_core.telemetry.telemetry import PACKAGE, sample_fields

_DISTRIBUTION = (
    ("p50", "double"),
    ("p90", "double"),
    ("p99", "double"),
    ("p999", "double"),
    ("max", "double"),
    ("n", "fixed64"),
    ("missed", "fixed64"),
)
_MESSAGES: dict[str, tuple[tuple[str, str], ...]] = {
    "Sample": SAMPLE_FIELDS,
    "Gap": (
        ("k_first", "fixed64"),
        ("count", "fixed64"),
        ("t_from_ns", "sfixed64"),
        ("t_to_ns", "sfixed64"),
        ("u_held_v", "double"),
        ("reason", "string"),
        ("code", "string"),
    ),
    "Distribution": _DISTRIBUTION,
    "Timing": (
        ("t_host_ns", "sfixed64"),
        ("wake_lateness_us", "Distribution"),
        ("device_tick_error_us", "Distribution"),
        ("link_round_trip_us", "Distribution"),
        ("queue_depth", "Distribution"),
        ("collections", "fixed64"),
        ("cpu_pressure_percent", "double"),
        ("run_queue", "sfixed32"),
    ),
    "Clock": (
        ("t_host_ns", "sfixed64"),
        ("offset_ns", "sfixed64"),
        ("offset_std_ns", "double"),
        ("drift_ppm", "double"),
        ("drift_std_ppm", "double"),
        ("bound_ns", "double"),
    ),
    "State": (
        ("t_host_ns", "sfixed64"),
        ("phase", "string"),
        ("reason", "string"),
        ("owner", "string"),
        ("Ts_s", "double"),
        ("device", "string"),
        ("fault", "string"),
        ("motor", "string"),
        ("remedy", "string"),
        ("owner_checked", "string"),
    ),
    "Trace": (
        ("t_host_ns", "sfixed64"),
        ("number", "fixed64"),
        ("state", "bytes"),
        ("steps", "bytes"),
        ("version", "fixed64"),
    ),
}

_CONTROL_FIELDS = (
    ("t_host_ns", "sfixed64"),
    ("k", "fixed64"),
    ("r", "double"),
    ("v", "double"),
    ("u_v", "double"),
    ("is_low", "bool"),
    ("is_high", "bool"),
    ("is_slewed", "bool"),
    ("predicted", "fixed64"),
    ("reference_n", "fixed64"),
)

SAMPLE, GAP, TIMING, CLOCK, STATE, TRACE = (
    f"{PACKAGE}.{name}" for name in ("Sample", "Gap", "Timing", "Clock", "State", "Trace")
)
CONTROL = f"{PACKAGE}.Control"
LOG = "foxglove.Log"
NOTE = "note"
"""`name` of a log record that a person wrote; all other records have another name."""
OF_STREAM = {
    "sample": SAMPLE,
    "gap": GAP,
    "event": LOG,
    "timing": TIMING,
    "clock": CLOCK,
    "state": STATE,
    "trace": TRACE,
    "control": CONTROL,
}
"""Full name of the message type of each stream."""

ABSENT: dict[str, float] = {
    **{"double": nan, "sfixed32": -1, "sfixed64": -1},
    **{"fixed32": (1 << 32) - 1, "fixed64": (1 << 64) - 1},
}
"""Value of a number that a message does not contain, by the number's type: NaN, or all bits set.

A message of an older release lacks the fields that were appended later. The value 0 would look like
a measurement.
"""

LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4, "fatal": 5}
"""Number of each level of a `foxglove.Log`."""


def _armrig_file(channels: tuple[DeviceChannel, ...]) -> descriptor_pb2.FileDescriptorProto:
    messages = _MESSAGES | {"Sample": sample_fields(channels)}
    return _file("armrig/v1/armrig.proto", messages)


def _file(
    path: str, messages: dict[str, tuple[tuple[str, str], ...]]
) -> descriptor_pb2.FileDescriptorProto:
    file = descriptor_pb2.FileDescriptorProto(name=path, package=PACKAGE, syntax="proto3")
    for name, fields in messages.items():
        message = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields, 1):
            entry = message.field.add(name=field, number=number, label="LABEL_OPTIONAL")
            if kind in _MESSAGES:
                entry.type = descriptor_pb2.FieldDescriptorProto.TYPE_MESSAGE
                entry.type_name = f".{PACKAGE}.{kind}"
                continue
            entry.type = descriptor_pb2.FieldDescriptorProto.Type.Value(f"TYPE_{kind.upper()}")
            # `optional`: zeros are written, too, so that a sample's length is constant.
            _make_optional(message, entry)
    return file


def _make_optional(
    message: descriptor_pb2.DescriptorProto, entry: descriptor_pb2.FieldDescriptorProto
) -> None:
    entry.proto3_optional = True
    entry.oneof_index = len(message.oneof_decl)
    message.oneof_decl.add(name=f"_{entry.name}")


def _log_file() -> descriptor_pb2.FileDescriptorProto:
    # Foxglove's schema of log messages, which viewers show as text, with three fields of armrig.
    file = descriptor_pb2.FileDescriptorProto(
        name="foxglove/Log.proto",
        package="foxglove",
        syntax="proto3",
        dependency=[timestamp_pb2.DESCRIPTOR.name],
    )
    message = file.message_type.add(name="Log")
    level = message.enum_type.add(name="Level")
    for number, name in enumerate(("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")):
        level.value.add(name=name, number=number)
    fields = (
        *(("timestamp", "MESSAGE"), ("level", "ENUM"), ("message", "STRING"), ("name", "STRING")),
        *(("file", "STRING"), ("line", "FIXED32"), ("owner", "STRING"), ("t_host_ns", "SFIXED64")),
        ("emulator_stall_ns", "SFIXED64"),
    )
    for number, (name, kind) in enumerate(fields, 1):
        entry = message.field.add(name=name, number=number, label="LABEL_OPTIONAL")
        entry.type = descriptor_pb2.FieldDescriptorProto.Type.Value(f"TYPE_{kind}")
    _make_optional(message, message.field[-1])  # not in version 1, where 0 would mean "no stall"
    message.field[0].type_name = ".google.protobuf.Timestamp"
    message.field[1].type_name = ".foxglove.Log.Level"
    return file


def _files(
    name: str, channels: tuple[DeviceChannel, ...] = CHANNELS
) -> list[descriptor_pb2.FileDescriptorProto]:
    if name == CONTROL:  # a file of its own, so that the schemas of other messages do not change
        return [_file("armrig/v1/control.proto", {"Control": _CONTROL_FIELDS})]
    if name != LOG:
        return [_armrig_file(channels)]
    timestamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(timestamp)
    return [timestamp, _log_file()]


@cache
def descriptor_set(name: str, channels: tuple[DeviceChannel, ...] = CHANNELS) -> bytes:
    """Return the serialised FileDescriptorSet of the message with the full name `name`.

    `channels` are the channels of the rig, which name fields of a sample.
    """
    return descriptor_pb2.FileDescriptorSet(file=_files(name, channels)).SerializeToString()


@cache
def message_class(name: str) -> Any:
    """Return the protobuf class of the message with the full name `name`, of the arm's rig."""
    pool = descriptor_pool.DescriptorPool()
    for file in _files(name):
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def decode_message(name: str, data: bytes) -> Any:
    """Decode `data` as a message with the full name `name`; missing numbers are `ABSENT`.

    Raises google.protobuf.message.DecodeError if `data` is not a protobuf message.
    """
    message = message_class(name)()
    message.CopyFrom(_without_numbers(name))
    message.MergeFromString(data)
    return message


@cache
def _without_numbers(name: str) -> Any:
    """Return a message in which each number has the `ABSENT` value of its type."""
    fields = (_MESSAGES | {"Control": _CONTROL_FIELDS}).get(name.removeprefix(f"{PACKAGE}."), ())
    return message_class(name)(**{field: ABSENT[kind] for field, kind in fields if kind in ABSENT})
