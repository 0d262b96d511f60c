"""The zenoh session of the service: streams out, commands in, schemas served."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import secrets
import time
from collections.abc import Callable, Iterator
from enum import Enum
from typing import Any, Self

import msgspec
import zenoh
from armrig_core import protobuf
from armrig_core.commands import REQUESTS, Calibrate, Refused, Renew, Status, Stop, json_schema
from armrig_core.history import HistoryRequest
from armrig_core.owned_session import owned_session
from armrig_core.topics import (
    STREAMS,
    alive_key,
    command_key,
    history_key,
    schema_key,
    stream_key,
)

from armrig_daemon.service import admission, token_bucket
from armrig_daemon.service.history import History

MOST_WAITING = 64  # commands of a kind that nobody has looked at yet; more are refused

MOST_BYTES = 88 << 20  # the longest run, 20 B a sample as JSON, and its details
_URGENT = (Stop.name, Renew.name)
"""Commands with a thread of zenoh's for themselves: none of the others stands before them."""
_SCHEMA, _HISTORY = "schema", "history"
_COUNTED = (*REQUESTS, _SCHEMA, _HISTORY)
_LONGEST_QUESTION = 64  # B, for a history


class Kind(Enum):
    """Commands that wait for each other; those of another kind do not stand before them."""

    STOP = Stop.name
    SIGN = Renew.name
    STATUS = Status.name
    LEASED = "leased"
    """Of the holder, a sign of whom is a kind of its own."""
    CALIBRATE = Calibrate.name
    """Long, and seldom: one of them waits at most."""
    OTHER = "other"


def kind_of(name: str) -> Kind:
    """Return the kind of a command, whether there is such a one or not."""
    if name in (Stop.name, Renew.name, Status.name, Calibrate.name):
        return Kind(name)
    return Kind.LEASED if name in admission.LEASED else Kind.OTHER


def session_config(endpoint: str) -> zenoh.Config:
    """Return the configuration of a session that only listens at `endpoint`, found by nobody."""
    return zenoh.Config.from_json5(json.dumps(owned_session(endpoint, most_received=MOST_BYTES)))


def _opened(endpoint: str) -> zenoh.Session:
    """Return a session whose socket the group may open, too: to connect is to write to it."""
    before = os.umask(0o007)
    try:
        return zenoh.open(session_config(endpoint))
    finally:
        os.umask(before)


class Command:
    """A query that waits for its answer; exactly one is given."""

    def __init__(self, name: str, query: zenoh.Query) -> None:
        self.name = name
        self._key = str(query.key_expr)
        self._query: zenoh.Query | None = query
        self.came_s = time.monotonic()
        self.payload = query.payload.to_bytes() if query.payload is not None else b""

    def answer(self, body: Any) -> None:
        """Answer with JSON."""
        query, self._query = self._query, None
        if query is not None:
            query.reply(self._key, msgspec.json.encode(body), encoding="application/json")
            query.drop()

    def refuse(self, error: str) -> None:
        """Answer with an error for a person."""
        query, self._query = self._query, None
        if query is not None:
            _refuse(query, error)


class Session:
    """An open session; use it in a `with` block."""

    def __init__(self, endpoint: str, rig: str, wake: Callable[[], None]) -> None:
        """Listen at `endpoint`; `wake` is called, from zenoh's thread, when a command has come.

        Raises
        ------
        zenoh.ZError
            The endpoint is taken or cannot be made.
        """
        self.lease = b""  # the one in force; without it no command of a holder is let in
        self._waiting = {
            kind: queue.Queue[Command](1 if kind is Kind.CALIBRATE else MOST_WAITING)
            for kind in Kind
        }
        self._wake = wake
        self._buckets: dict[str, token_bucket.Bucket] = {}
        self._session = _opened(endpoint)
        self._publishers = {
            stream: self._session.declare_publisher(
                stream_key(rig, stream),
                encoding=f"application/protobuf;{protobuf.OF_STREAM[stream]}",
                congestion_control=zenoh.CongestionControl.DROP,
            )
            for stream in STREAMS
        }
        self._served = {
            schema_key(rig, n): protobuf.descriptor_set(n) for n in protobuf.OF_STREAM.values()
        }
        for name in REQUESTS:
            self._served[schema_key(rig, f"cmd/{name}")] = json_schema(name)
        self._history = History(secrets.token_bytes(16))
        self._history_key = history_key(rig)
        self._session.declare_queryable(self._history_key, self._serve_history)
        self._session.declare_queryable(schema_key(rig, "**"), self._serve_schema)
        self._session.declare_queryable(command_key(rig, "*"), self._receive)
        for name in _URGENT:
            self._session.declare_queryable(command_key(rig, name), self._admit)
        self._alive = self._session.liveliness().declare_token(alive_key(rig))

    def __enter__(self) -> Self:
        """Return itself, open."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close; an open session would never let the interpreter end."""
        self._session.close()

    def put(self, stream: str, data: bytes) -> None:
        """Publish; dropped by zenoh where a subscriber does not keep up, and kept for a while."""
        self._publishers[stream].put(data)
        self._history.add(stream, data)

    def waiting(self, kind: Kind, most: int = MOST_WAITING) -> Iterator[Command]:
        """Iterate over the commands of a kind that wait, at most so many."""
        with contextlib.suppress(queue.Empty):
            for _ in range(most):
                yield self._waiting[kind].get_nowait()

    @property
    def is_asked(self) -> bool:
        """Whether a command waits."""
        return not all(waiting.empty() for waiting in self._waiting.values())

    def _serve_schema(self, query: zenoh.Query) -> None:
        if self._is_too_many(_SCHEMA):
            _refuse(query, token_bucket.refusal(_SCHEMA))
            return
        with query:
            for key, data in self._served.items():
                if query.key_expr.intersects(zenoh.KeyExpr(key)):
                    query.reply(key, data)

    def _serve_history(self, query: zenoh.Query) -> None:
        if self._is_too_many(_HISTORY):
            _refuse(query, token_bucket.refusal(_HISTORY))
            return
        payload = query.payload.to_bytes()[:_LONGEST_QUESTION] if query.payload else b"{}"
        try:
            asked = msgspec.json.decode(payload, type=HistoryRequest)
        except (msgspec.DecodeError, UnicodeDecodeError) as err:
            _refuse(query, f'history: {err}; ask with {{"first": 0}}')
            return
        offset_ns = time.time_ns() - time.monotonic_ns()
        reply = self._history.reply(asked.first, offset_ns)
        query.reply(self._history_key, reply)
        query.drop()

    def _receive(self, query: zenoh.Query) -> None:
        name = _name(query)
        if name in _URGENT:
            query.drop()  # it comes on its own way, too
        elif name not in admission.LEASED and self._is_too_many(name):
            _refuse(query, token_bucket.refusal(name))
        else:
            self._admit(query)

    def _is_too_many(self, name: str) -> bool:
        """Count a question that needs no lease. Only zenoh's thread of its queryable asks."""
        kind = name if name in _COUNTED else ""  # all that there are not are of one kind
        left = token_bucket.take(self._buckets.get(kind, token_bucket.Bucket()), time.monotonic())
        if left is not None:
            self._buckets[kind] = left
        return left is None

    def _admit(self, query: zenoh.Query) -> None:
        command = Command(_name(query), query)
        error = admission.refusal(command.name, command.payload, self.lease)
        if error:
            command.refuse(error)
            return
        try:
            self._waiting[kind_of(command.name)].put_nowait(command)
        except queue.Full:
            command.refuse("too many commands are waiting: try again")
        self._wake()


def _refuse(query: zenoh.Query, error: str) -> None:
    refused = msgspec.json.encode(Refused(error=error))
    query.reply_err(refused, encoding="application/json")
    query.drop()


def _name(query: zenoh.Query) -> str:
    return str(query.key_expr).rsplit("/", 1)[-1]
