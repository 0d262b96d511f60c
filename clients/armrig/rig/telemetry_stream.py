"""Live messages of a rig, and gaps between them, reported by the daemon or detected here."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from math import nan
from pathlib import Path
from threading import Lock
from typing import Any, Generic, TypeVar

import zenoh
from armrig_core.commands.codes import GapCode
from armrig_core.errors import InputError
from armrig_core.telemetry import protobuf, telemetry, topics
from armrig_core.telemetry.channels import SAMPLE_NAMES
from armrig_core.telemetry.telemetry import Sample, sample_class
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError

from armrig.rig.session import (
    MOST_RECEIVED,
    NoReplyError,
    RigError,
    open_connection,
    service_has_stopped,
    service_stop_sentence,
)

SILENCE_S = 1.0
"""Time in s without a message; after this time the listener checks whether the daemon runs."""
_LOOK_TIMEOUT_S = 1.0
_SCHEMA_TIMEOUT_S = 5.0
_LISTEN_INTERVAL_S = 0.002
_RING_MESSAGES = 10_000  # a slower listener misses the oldest messages
_RING_BYTES = MOST_RECEIVED  # of all messages; one message may be this long
MOST_TOLD, MOST_TOLD_BYTES = 10_000, 1 << 20
"""Largest number and largest total size, in B, of stored gaps.

A gap is stored until a later sample arrives.
"""
_T = TypeVar("_T")


def stream(
    key: str, *, connect: str | None = None, certificate: str | Path | None = None
) -> Iterator[Any]:
    """Iterate over the live messages of a key such as `rig/1/sample`.

    In a stream of samples, a `LiveGap` replaces missing samples. The field `reason` of the gap
    contains the reason that the daemon reports. If the daemon reports no reason, this listener was
    too slow and missed the samples.

    Parameters
    ----------
    key : str
        `rig/<id>/STREAM`; STREAM is sample, gap, event, timing, clock or state.
    connect : str, optional
        zenoh endpoint of the daemon; by default the endpoint that `armrig.Rig` uses.
    certificate : str or Path, optional
        Credential of the client, for an endpoint such as tls/lab-1.local:7447.

    Yields
    ------
    Sample, LiveGap or protobuf message
        A sample is a named tuple; the names of its fields are those of the rig and contain the unit
        (`u_applied_v`, `T1_degC`). A `LiveGap` is a gap between two samples. Every other
        message is an `armrig.v1` message.

    Raises
    ------
    NoReplyError
        There is no daemon, or the daemon stopped.
    RigError
        Another user owns the socket's directory or may write to it, or a message did not come from
        armrigd.
    ValueError
        The key is not a stream of a rig.

    Examples
    --------
    The example needs a running rig, such as the emulated rig of `armrig lab`.

    >>> for sample in armrig.stream("rig/1/sample"):
    ...     if not isinstance(sample, armrig.LiveGap):
    ...         break
    >>> sample.u_applied_v
    0.0
    """
    rig, _ = _stream_of(key)
    connection = open_connection(connect, rig=rig, certificate=certificate)
    with connection.session as session:
        yield from listen(session, key, connection.endpoint)


def listen(session: zenoh.Session, key: str, where: str) -> Iterator[Any]:
    """Iterate over the messages of a key in an open session: see `stream`."""
    rig, name = _stream_of(key)
    # Only the stream of samples has gaps; who hears a sample also hears the gaps after it.
    gaps: AbstractContextManager[Callable[[], list[Any]]] = nullcontext(list)
    if name == "sample":
        gaps = arrivals(session, topics.stream_key(rig, "gap"))
    with gaps as gaps_since, arrivals(session, key) as messages_since:
        before: Sample | None = None
        reported = gap_store()

        def is_over(gap: Any) -> bool:  # all its missing samples are before the last sample
            return before is not None and bool(gap.k_first + gap.count <= before.k)

        for messages in _until_gone(session, rig, where, messages_since):
            # The daemon publishes a gap first, then the sample that follows the gap.
            for gap in gaps_since():
                reported.add(gap, gap.ByteSize())
            for message in messages:
                if name == "sample":
                    if before is not None:
                        yield from gaps_between(before, message, reported)
                    before = message
                    reported.forget_while(is_over)
                yield message


def _until_gone(
    session: zenoh.Session, rig: str, where: str, messages_since: Callable[[], list[Any]]
) -> Iterator[list[Any]]:
    """Yield lists of messages as they arrive; raise NoReplyError if the daemon has stopped."""
    with session.liveliness().declare_subscriber(
        topics.alive_key(rig), zenoh.handlers.RingChannel(8)
    ) as alive:
        heard_s = time.monotonic()
        while True:
            if messages := messages_since():
                yield messages
                heard_s = time.monotonic()
            if (change := alive.try_recv()) is not None and change.kind == zenoh.SampleKind.DELETE:
                raise _stop_error(rig, where)
            if time.monotonic() - heard_s > SILENCE_S:
                # The daemon withdraws its token over a connection that ends with the daemon. The
                # withdrawal may therefore never arrive.
                if not _is_alive(session, rig):
                    raise _stop_error(rig, where)
                heard_s = time.monotonic()
            time.sleep(_LISTEN_INTERVAL_S)


@contextmanager
def arrivals(session: zenoh.Session, key: str) -> Iterator[Callable[[], list[Any]]]:
    """Yield a function that returns the messages since the previous call, without waiting."""
    rig, name = _stream_of(key)
    ring: Newest[bytes] = Newest(_RING_MESSAGES, _RING_BYTES)

    def receive(received: zenoh.Sample) -> None:
        payload = received.payload.to_bytes()
        ring.add(payload, len(payload))

    def messages_since() -> list[Any]:
        messages = [_read(rig, name, payload) for payload in ring.take()]
        return [kind._make(message) for message in messages] if name == "sample" else messages

    # The callback runs in the receiving thread. For another thread, zenoh would use a queue that
    # limits only the number of messages.
    callback = zenoh.handlers.Callback(receive, indirect=False)
    with session.declare_subscriber(key, callback):
        kind = _sample_kind(session, rig) if name == "sample" else Sample
        yield messages_since


def _sample_kind(session: zenoh.Session, rig: str) -> type[Sample]:
    """Return the type of a rig's samples, named by its schema; without a schema, by number."""
    for reply in session.get(topics.schema_key(rig, protobuf.SAMPLE), timeout=_SCHEMA_TIMEOUT_S):
        if reply.ok is None:
            raise NoReplyError(f"rig {rig}: its daemon does not report the names of its samples")
        try:
            files = FileDescriptorSet.FromString(reply.ok.payload.to_bytes()).file
        except DecodeError as err:
            raise RigError(f"rig {rig}: the schema of its samples cannot be read ({err})") from err
        fields = {
            field.number: field.name
            for file in files
            for message in file.message_type
            if f"{file.package}.{message.name}" == protobuf.SAMPLE
            for field in message.field
        }
        by_number = enumerate(Sample._fields, 1)
        return sample_class(tuple(fields.get(number, name) for number, name in by_number))
    return Sample


def decode(name: str, payload: bytes) -> Any:
    """Decode one message of the stream `name`; missing numbers are `protobuf.ABSENT`."""
    if name != "sample":
        return protobuf.decode_message(protobuf.OF_STREAM[name], payload)
    sample = telemetry.decode_sample(payload)
    if sample is not None:
        return sample
    # A sample of another version, with more or fewer fields; their numbers are those of every rig.
    message = protobuf.decode_message(protobuf.SAMPLE, payload)
    return Sample._make(getattr(message, field) for field in SAMPLE_NAMES)


def _read(rig: str, name: str, payload: bytes) -> Any:
    """Decode one message of a stream; raise RigError if it cannot be decoded."""
    try:
        return decode(name, payload)
    except DecodeError as err:
        raise RigError(
            f"rig {rig}: {len(payload)} B of its stream {name!r} cannot be read ({err}); the "
            "sender is not an armrigd of this version"
        ) from err


def _is_alive(session: zenoh.Session, rig: str) -> bool:
    replies = session.liveliness().get(topics.alive_key(rig), timeout=_LOOK_TIMEOUT_S)
    return any(reply.ok is not None for reply in replies)


def _stop_error(rig: str, where: str) -> NoReplyError:
    return NoReplyError(
        service_stop_sentence(rig)
        if service_has_stopped(rig, where)
        else f"rig {rig}: its daemon stopped; start it with `armrig lab` or `armrigd run`"
    )


def _stream_of(key: str) -> tuple[str, str]:
    parts = key.split("/")
    if len(parts) != 3 or parts[0] != "rig" or parts[2] not in topics.STREAMS:
        raise InputError(
            f"key {key!r}: a stream is rig/<id>/ and one of {', '.join(topics.STREAMS)}"
        )
    return topics.check_rig_id(parts[1]), parts[2]


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveGap:
    """Gap in a live stream: consecutive samples that the listener did not receive.

    Examples
    --------
    A listener that receives the samples 502 and 505 missed the two samples between them.

    >>> from armrig.rig.telemetry_stream import gaps_between
    >>> from armrig_core.telemetry.telemetry import Sample
    >>> rows = armrig.example_recording().samples[[0, 3]]
    >>> (gap,) = gaps_between(*(Sample._make(row.tolist()) for row in rows), [])
    >>> gap.k_first, gap.count, gap.reason
    (503, 2, 'the listener, or the way to it, did not keep up')
    """

    k_first: int
    """Index of the first missing sample, as in `Sample.k`."""
    count: int
    """Number of missing samples."""
    t_from_ns: int
    """Beginning of the gap, in ns of the host's monotonic clock."""
    t_to_ns: int
    """End of the gap, in ns of the host's monotonic clock."""
    u_held_v: float
    """Voltage that the motor kept during the gap, in V; NaN if the listener cannot know it."""
    reason: str
    """Reason for the gap."""
    published: bool
    """True if the daemon published the samples, but this listener missed them."""
    code: str
    """Code of the reason: an `armrig_core.commands.codes.GapCode`."""


def gap_store() -> Newest[Any]:
    """Return a bounded store for the gaps that a daemon reports (`armrig.v1.Gap`)."""
    return Newest(MOST_TOLD, MOST_TOLD_BYTES)


def gaps_between(before: Sample, after: Sample, told: Iterable[Any]) -> Iterator[LiveGap]:
    """Yield the gaps between two consecutively received samples, in order.

    If `k` does not increase, the daemon was restarted, and no sample is missing. `told` are the
    gaps that the daemon reported (armrig.v1.Gap), in any order.
    """
    k, end = before.k + 1, after.k
    for gap in sorted(told, key=lambda gap: int(gap.k_first)):
        first, after_last = max(gap.k_first, k), min(gap.k_first + gap.count, end)
        if first >= after_last:
            continue
        if first > k:
            yield _gap_between(before, after, k, first)
        yield LiveGap(
            k_first=first,
            count=after_last - first,
            t_from_ns=gap.t_from_ns,
            t_to_ns=gap.t_to_ns,
            u_held_v=gap.u_held_v,
            reason=gap.reason,
            published=False,
            code=gap.code or GapCode.UNKNOWN,
        )
        k = after_last
    if k < end:
        yield _gap_between(before, after, k, end)


def _gap_between(before: Sample, after: Sample, first: int, end: int) -> LiveGap:
    return LiveGap(
        k_first=first,
        count=end - first,
        t_from_ns=before.t_host_ns,
        t_to_ns=after.t_host_ns,
        u_held_v=nan,
        reason=GapCode.LISTENER_LATE.sentence,
        published=True,
        code=GapCode.LISTENER_LATE,
    )


class Newest(Generic[_T]):
    """Bounded store that drops the oldest values.

    One thread may add values while another thread takes values.
    """

    def __init__(self, most: int, most_bytes: int) -> None:
        """Create a store of at most `most` values with a total size of at most `most_bytes`."""
        self._most, self._most_bytes = most, most_bytes
        self._kept: deque[tuple[_T, int]] = deque()
        self._size = 0
        self._lock = Lock()

    def __len__(self) -> int:
        """Return the number of kept values."""
        return len(self._kept)

    def __iter__(self) -> Iterator[_T]:
        """Iterate over the kept values, oldest first; do not add a value during the iteration."""
        return (value for value, _ in self._kept)

    def add(self, value: _T, size: int) -> None:
        """Add a value of `size` B; if a limit is exceeded, drop the oldest values."""
        with self._lock:
            self._kept.append((value, size))
            self._size += size
            while len(self._kept) > self._most or self._size > self._most_bytes:
                self._forget_oldest()

    def take(self) -> list[_T]:
        """Remove all values, and return them in order, the oldest first."""
        with self._lock:
            kept, self._kept, self._size = self._kept, deque(), 0
        return [value for value, _ in kept]

    def forget_while(self, is_over: Callable[[_T], bool]) -> None:
        """Remove the oldest values; stop before the first value for which `is_over` is False."""
        with self._lock:
            while self._kept and is_over(self._kept[0][0]):
                self._forget_oldest()

    def _forget_oldest(self) -> None:
        _, size = self._kept.popleft()
        self._size -= size
