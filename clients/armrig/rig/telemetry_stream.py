"""What a rig publishes, live."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import zenoh
from armrig_core import protobuf, telemetry, topics
from armrig_core.errors import InputError
from google.protobuf.message import DecodeError

from armrig.rig.live_gaps import Newest, gaps_between, told_gaps
from armrig.rig.session import (
    MOST_RECEIVED,
    NoReplyError,
    RigError,
    open_connection,
    service_has_stopped,
)

SILENCE_S = 1.0
"""After so long without a message the daemon is looked for, in s."""
_LOOK_S = 1.0  # how long a daemon may take to show that it is there
_LISTEN_S = 0.002
_RING = 10_000  # messages that a slow listener may be behind before it misses the oldest
_RING_BYTES = MOST_RECEIVED  # of them; a stranger's may be as long as that each


def stream(
    key: str, *, connect: str | None = None, certificate: str | Path | None = None
) -> Iterator[Any]:
    """Iterate over the live messages of a key such as `rig/1/sample`.

    A stream of samples has no silent break: where some are missing, a `LiveGap` stands in their
    place, with the reason that the daemon tells, or that this listener fell behind and missed the
    oldest ones.

    Parameters
    ----------
    key : str
        `rig/<id>/` and one of sample, gap, event, timing, clock and state.
    connect : str, optional
        zenoh endpoint of the daemon; found as by `armrig.Rig`.
    certificate : str or Path, optional
        Our credential, for an endpoint such as tls/lab-1.local:7447.

    Yields
    ------
    Sample, LiveGap or protobuf message
        Samples as named tuples whose fields carry their unit (`u_applied_v`, `theta_1_rad`), and
        between them gaps; everything else as `armrig.v1` messages.

    Raises
    ------
    NoReplyError
        There is no daemon, or it went away.
    RigError
        The directory of this user's socket may be another user's, or a message is not armrigd's.
    ValueError
        The key is not a stream of a rig.
    """
    rig, _ = _stream_of(key)
    connection = open_connection(connect, rig=rig, certificate=certificate)
    with connection.session as session:
        yield from listen(session, key, connection.endpoint)


def listen(session: zenoh.Session, key: str, where: str) -> Iterator[Any]:
    """Iterate over the messages of a key in an open session: see `stream`."""
    rig, name = _stream_of(key)
    with arrivals(session, key) as messages_since, _gaps_told(session, rig, name) as gaps_since:
        before: telemetry.Sample | None = None
        told = told_gaps()
        for messages in _until_gone(session, rig, where, messages_since):
            # A gap is published before the sample behind it: if that is here, so is the gap.
            for gap in gaps_since():
                told.add(gap, gap.ByteSize())
            for message in messages:
                if name == "sample":
                    if before is not None:
                        yield from gaps_between(before, message, told)
                    before = message
                    told.forget_while(partial(_is_over, message.k))
                yield message


def _is_over(k: int, gap: Any) -> bool:
    """Return whether a gap lies before sample k."""
    return bool(gap.k_first + gap.count <= k)


def _gaps_told(
    session: zenoh.Session, rig: str, name: str
) -> AbstractContextManager[Callable[[], list[Any]]]:
    """Give what returns the gaps told among the samples since its last call; else nothing."""
    if name != "sample":
        return nullcontext(list)
    return arrivals(session, topics.stream_key(rig, "gap"))


def _until_gone(
    session: zenoh.Session, rig: str, where: str, messages_since: Callable[[], list[Any]]
) -> Iterator[list[Any]]:
    """Give the messages as they come; raises NoReplyError when their daemon has gone."""
    with session.liveliness().declare_subscriber(
        topics.alive_key(rig), zenoh.handlers.RingChannel(8)
    ) as alive:
        heard_s = time.monotonic()
        while True:
            if messages := messages_since():
                yield messages
                heard_s = time.monotonic()
            if (change := alive.try_recv()) is not None and change.kind == zenoh.SampleKind.DELETE:
                raise _gone(rig, where)
            if time.monotonic() - heard_s > SILENCE_S:
                # The daemon's token is withdrawn over the connection that ends with the daemon, so
                # its withdrawal may never arrive: ask.
                if not _is_alive(session, rig):
                    raise _gone(rig, where)
                heard_s = time.monotonic()
            time.sleep(_LISTEN_S)


@contextmanager
def arrivals(session: zenoh.Session, key: str) -> Iterator[Callable[[], list[Any]]]:
    """Give a function that returns at once what a key has brought since its last call."""
    rig, name = _stream_of(key)
    ring: Newest[bytes] = Newest(_RING, _RING_BYTES)

    def receive(received: zenoh.Sample) -> None:
        payload = received.payload.to_bytes()
        ring.add(payload, len(payload))

    def messages_since() -> list[Any]:
        return [_read(rig, name, payload) for payload in ring.take()]

    # In the thread that receives: another one would be handed them through a queue of zenoh's,
    # whose bound is their number alone.
    callback = zenoh.handlers.Callback(receive, indirect=False)
    with session.declare_subscriber(key, callback):
        yield messages_since


def decoded(name: str, payload: bytes) -> Any:
    """Return one message of the stream `name`; numbers that it lacks are `protobuf.ABSENT`."""
    if name != "sample":
        return protobuf.decoded(protobuf.OF_STREAM[name], payload)
    sample = telemetry.decode_sample(payload)
    if sample is not None:
        return sample
    # The sample of another version, with more or fewer fields.
    message = protobuf.decoded(protobuf.SAMPLE, payload)
    return telemetry.Sample._make(getattr(message, field) for field in telemetry.Sample._fields)


def _read(rig: str, name: str, payload: bytes) -> Any:
    """Return one message of a stream; raises RigError where it cannot be decoded."""
    try:
        return decoded(name, payload)
    except DecodeError as err:
        raise RigError(
            f"rig {rig}: {len(payload)} B of its stream {name!r} cannot be read ({err}); who "
            "published them is no armrigd, or one of another version"
        ) from err


def _is_alive(session: zenoh.Session, rig: str) -> bool:
    replies = session.liveliness().get(topics.alive_key(rig), timeout=_LOOK_S)
    return any(reply.ok is not None for reply in replies)


def _gone(rig: str, where: str) -> NoReplyError:
    return NoReplyError(
        service_has_stopped(rig, where)
        or f"rig {rig}: its daemon went away; start it with `armrig lab` or `armrigd run`"
    )


def _stream_of(key: str) -> tuple[str, str]:
    parts = key.split("/")
    if len(parts) != 3 or parts[0] != "rig" or parts[2] not in topics.STREAMS:
        raise InputError(
            f"key {key!r}: a stream is rig/<id>/ and one of {', '.join(topics.STREAMS)}"
        )
    return topics.check_rig_id(parts[1]), parts[2]
