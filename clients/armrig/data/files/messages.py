"""Columns of numbers from the messages of an MCAP file that another program wrote."""

from __future__ import annotations

import json
from array import array
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import redirect_stderr
from functools import partial
from io import BytesIO, StringIO
from itertools import chain
from math import nan
from types import SimpleNamespace
from typing import Any

import numpy as np
from armrig_core.errors import FileError
from armrig_core.process.imports import MissingPackageError, load_extra
from armrig_core.recording_file.budget import WORK, Budget, DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.chunks import Unpacker
from armrig_core.recording_file.file_records import (
    MAGIC,
    MESSAGE_HEAD,
    UNREADABLE,
    RecordSelection,
    file_records,
)
from armrig_core.recording_file.manifest import RUN
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from armrig.data.files.table import Column, ReadingError, Table, Vector, require_room, shorten
from armrig.data.step import DOUBT, Step

_DECODERS = {"protobuf": "mcap_protobuf.decoder", "cdr": "mcap_ros2.decoder"}
_STAMPS = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
"""Fields of a time: seconds and nanoseconds, in ROS 2, Foxglove's JSON, ROS 1 and protobuf."""
_MAX_ELEMENTS = 64  # of a list whose elements are columns; an image is longer
_MAX_LISTED = 12  # topics, and fields of a topic
_Series = tuple[list[int], dict[str, "array[float]"]]
"""Log times of the messages of a topic, in ns, and their numeric fields by name."""


def read_mcap(data: bytes, topic: str | None) -> Table:
    """Return the numeric fields of a topic's messages as columns, and their log times as `time`.

    The name of a column is the path of the field, such as `twist.linear.x`, or `position:2` for the
    second element of a list. A time in seconds and nanoseconds is one column, in s. If `topic`
    names several topics with commas, the last topic gives the times, and the newest values of the
    other topics are held. Without a known topic, an error lists the topics and their fields.
    """
    names = [*dict.fromkeys(filter(None, map(str.strip, (topic or "").split(","))))]
    series: dict[str, _Series] = {name: ([], {}) for name in names}
    notes: list[str] = []
    for name, log_time, fields in _messages(data, series, notes):
        times, columns = series[name]
        for field, value in fields().items():
            column = columns.setdefault(field, array("d"))
            column.extend([nan] * (len(times) - len(column)))
            column.append(value)
        times.append(log_time)
        require_room(8 * len(columns) * len(times), len(data))
    missing = [shorten(name) for name, (times, _) in series.items() if not times]
    if missing or not names:
        text = "".join(f"topic {n}: no such topic; " for n in missing) + _contents(data)
        raise ReadingError(text, "--topic NAME")
    if names[:-1]:
        others = " and ".join(map(shorten, names[:-1]))
        notes.append(f"held the newest value of {others} at the times of {shorten(names[-1])}")
    vectors = _join(series)
    named = [Column(name=name, unit="s" if name == "time" else "") for name in vectors]
    return Table(columns=named, values=[*vectors.values()], notes=notes)


def _join(series: Mapping[str, _Series]) -> dict[str, Vector]:
    """Return the times of the last topic, from 0 on, and the values of all topics at them."""
    *_, (last, _) = series.values()
    times_ns = np.sort(np.array(last, dtype=np.uint64))
    vectors: dict[str, Vector] = {"time": (times_ns - times_ns[0]) / 1e9}
    for topic, (times, columns) in series.items():
        own_ns = np.array(times, dtype=np.uint64)
        order = np.argsort(own_ns, kind="stable")
        at = np.searchsorted(own_ns[order], times_ns, side="right")
        if times is last:
            at = np.arange(1, times_ns.size + 1)  # messages with the same log time stay apart
        for name, column in columns.items():
            values = np.append(column, [nan] * (len(times) - len(column)))[order]
            # The column of the log times is recognised by its name.
            is_ambiguous = len(series) > 1 or name.casefold() in ("t", "time")
            vectors[f"{topic}.{name}" if is_ambiguous else name] = np.append(nan, values)[at]
    return vectors


def _contents(data: bytes) -> str:
    """Return a message with the topics and their numeric fields."""
    if RUN.encode() in data:
        return "is a recording and not a table; armrig.load(path).dataset() reads it"
    topics: dict[str, str] = {}
    notes: list[str] = []
    for topic, _, fields in _messages(data, None, notes):
        if topic not in topics and len(topics) < _MAX_LISTED:
            try:
                names = [shorten(name) for name in fields()]
                more = f", … {len(names)} fields" * (len(names) > _MAX_LISTED)
                topics[topic] = ", ".join(names[:_MAX_LISTED]) + more or "no numeric field"
            except FileError as err:
                topics[topic] = str(err)
    if not topics:
        return "; ".join(["another program wrote this MCAP file, and it has no messages", *notes])
    listed = "; ".join(f"{shorten(topic)} ({fields})" for topic, fields in topics.items())
    return (
        f"another program wrote this MCAP file; give --topic NAME{' (or A,B)' * (len(topics) > 1)},"
        f" --input FIELD and --signal FIELD of: {listed}"
    )


def mcap_records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the opcodes and the contents of all records of an MCAP file, also of those in chunks.

    Raises DamageError, or an exception of `UNREADABLE`, at a damage.
    """
    budget, source = Budget(len(data)), ByteSource(BytesIO(data), len(data))
    spend = partial(budget.spend, WORK)
    source.skip(len(MAGIC))
    records = file_records(source, RecordSelection(attachment=0), spend)
    for opcode, body in chain.from_iterable(map(Unpacker(budget).parts, records)):
        spend(1)
        yield opcode, body


def _messages(
    data: bytes, wanted: Collection[str] | None, notes: list[str]
) -> Iterator[tuple[str, int, Callable[[], dict[str, float]]]]:
    """Yield topic, log time in ns, and a function that returns the numeric fields, of messages."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    decoders: _Decoders = {}
    try:
        for opcode, body in mcap_records(data):
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(body)))
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(ReadDataStream(BytesIO(body)))
                if wanted is None or channel.topic in wanted:
                    channels[channel.id] = channel
            elif opcode == Opcode.MESSAGE:
                number, _, log_time, _ = MESSAGE_HEAD.unpack_from(body)
                if channel := channels.get(number):
                    schema, body = schemas.get(channel.schema_id), body[MESSAGE_HEAD.size :]
                    yield channel.topic, log_time, partial(_read, decoders, channel, schema, body)
    except (DamageError, *UNREADABLE) as err:
        text = f"only the messages before a damage are read ({err or type(err).__name__})"
        notes.append(Step(text, DOUBT))


_Decoders = dict[int, Callable[[bytes], Any]]
"""Functions that decode the messages of a channel, by the channel's number."""


def _read(
    decoders: _Decoders, channel: Channel, schema: Schema | None, body: bytes
) -> dict[str, float]:
    if channel.id not in decoders:
        decoders[channel.id] = _decoder(channel.message_encoding, schema)
    try:
        return dict(_fields(decoders[channel.id](body)))
    except Exception as err:  # a damaged message can raise any exception in its decoder
        why = f"{type(err).__name__}: {shorten(str(err))}"
        raise FileError(f"a message cannot be decoded ({why}); export its topic as CSV") from err


def _decoder(encoding: str, schema: Schema | None) -> Callable[[bytes], Any]:
    if encoding == "json":
        return json.loads
    why = "armrig reads json, protobuf, and cdr with ros2msg; export the topic as CSV"
    try:
        factory = load_extra(_DECODERS[encoding], "mcap").DecoderFactory()
        with redirect_stderr(StringIO()):  # mcap_ros2 prints the damaged line
            decoder: Callable[[bytes], Any] | None = factory.decoder_for(encoding, schema)
        if decoder:
            return decoder
    except MissingPackageError:
        why = "to read them, pip install 'armrig[mcap]'"
    except KeyError:
        pass  # another encoding
    except Exception as err:  # a damaged schema can raise any exception in its parser
        why = f"the schema is damaged ({shorten(str(err))}); export the topic as CSV"
    schema_text = f" with a schema in {shorten(schema.encoding)}" if schema else ""
    raise FileError(f"messages in {shorten(encoding)}{schema_text}: {why}")


def _fields(value: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield the paths and the values of the numeric fields in a decoded message."""
    if isinstance(value, bool | int | float):
        yield path or "value", float(value)
        return
    parts = _parts(value)
    for seconds, nanoseconds in _STAMPS:
        if path and parts.keys() == {seconds, nanoseconds}:
            yield path, parts[seconds] + parts[nanoseconds] * 1e-9
            return
    for name, part in parts.items():
        yield from _fields(part, f"{path}.{name}".removeprefix(".").replace(".:", ":"))


def _parts(value: Any) -> Mapping[str, Any]:
    """Return the fields of a message, or the elements of a short list, by name."""
    if isinstance(value, Mapping):
        return value
    if isinstance(value, SimpleNamespace):  # of ROS 2
        return {name: getattr(value, name) for name in getattr(value, "__slots__", ())}
    if hasattr(value, "DESCRIPTOR"):  # of protobuf
        fields = value.DESCRIPTOR.fields
        present = [f.name for f in fields if not f.has_presence or value.HasField(f.name)]
        return {name: getattr(value, name) for name in present}
    is_list = isinstance(value, Sequence) and not isinstance(value, str | bytes | memoryview)
    if is_list and len(value) <= _MAX_ELEMENTS:
        return {f":{i}": part for i, part in enumerate(value, 1)}
    return {}
