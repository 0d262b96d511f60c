"""Trace of a run: the core's inputs and its frames to the device, step by step, for a replay.

A trace begins with the state at the start of the run and contains the arguments of each later call
of `decisions/step.py: step`. `step` is pure: the same arguments result in the same decisions.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import msgspec
from msgspec import UNSET
from msgspec.structs import replace

from armrig_daemon.decisions.state import (
    Action,
    DecisionState,
    Event,
    LinkDown,
    LinkUp,
    Ordered,
    Received,
    Send,
    ServiceGone,
    Tick,
    Wakeup,
)
from armrig_daemon.pipe import Arm, Leased, Order, Orders, Run

VERSION = 2
"""Version of the names in a trace."""
CHUNK_BYTES = 3000
"""Largest size of a chunk's steps, in bytes; with the state, a chunk has at most 4096 bytes."""
_HELD = "held"  # replaces the lease in force
_STEP_BYTES, _EVENT_BYTES = 12, 24  # largest overhead of a step and of an event
_KINDS: tuple[type[Event], ...] = (
    Tick, Wakeup, Received, Ordered, LinkUp, LinkDown, ServiceGone,
)  # fmt: skip
_NUMBERS = {kind: number for number, kind in enumerate(_KINDS)}


class DecisionStep(NamedTuple):
    """One call of the core, and the frames to the device that it returned."""

    now_ns: int
    events: tuple[Event, ...]
    sent: tuple[bytes, ...]


_Written = list[tuple[int, list[tuple[int, bytes]], list[bytes]]]
_ENCODER, _STEPS = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(_Written)
_STATE = msgspec.msgpack.Decoder(DecisionState)
_EVENTS = [msgspec.msgpack.Decoder(kind) for kind in _KINDS]
_ORDER = msgspec.msgpack.Decoder(Orders)


class Chunk(NamedTuple):
    """Consecutive steps of a trace."""

    number: int
    """Number of the chunk, from 0 at the start of the run."""
    state: bytes
    """State before the first step of the trace; empty in all chunks except the first."""
    steps: bytes


class TraceBuffer:
    """Steps of a run that have not been returned in a chunk yet."""

    def __init__(self, state: DecisionState) -> None:
        """Begin with the state at the start of the run."""
        self._state = encode_state(state)
        self._lease = state.lease.lease if state.lease else ""
        self._number = 0
        self._noted: list[tuple[int, Iterable[Event], Iterable[Action]]] = []
        self._steps: _Written = []
        self._bytes = len(self._state)

    def note(self, now_ns: int, events: Iterable[Event], actions: Iterable[Action]) -> None:
        """Store a step. It is encoded later, because its actions must not wait."""
        self._noted.append((now_ns, events, actions))

    def full(self) -> list[Chunk]:
        """Encode the stored steps; return the chunks that are full."""
        chunks = []
        for now_ns, events, actions in self._noted:
            chunk = self._write(now_ns, events, actions)
            if chunk is not None:
                chunks.append(chunk)
        self._noted.clear()
        return chunks

    def rest(self) -> list[Chunk]:
        """Encode the stored steps; return all chunks that were not returned yet."""
        return [*self.full(), self._next_chunk()]

    def _write(
        self, now_ns: int, events: Iterable[Event], actions: Iterable[Action]
    ) -> Chunk | None:
        """Add a step; return the full chunk if the step begins a new chunk."""
        # Loops without comprehensions: each comprehension is a call, at each event of a run.
        written: list[tuple[int, bytes]] = []
        sent: list[bytes] = []
        size = _STEP_BYTES
        for event in events:
            data = event.data if type(event) is Received else _encode_event(event, self._lease)
            written.append((_NUMBERS[type(event)], data))
            size += _EVENT_BYTES + len(data)
        for action in actions:
            if type(action) is Send:
                sent.append(action.data)
                size += len(action.data)
        begun = self._steps or self._state  # a state leaves no room for a long first step
        full = self._next_chunk() if begun and self._bytes + size > CHUNK_BYTES else None
        if size > CHUNK_BYTES:  # too many orders: the step and a chunk's number are left out
            self._number += 1
            return full
        self._steps.append((now_ns, written, sent))
        self._bytes += size + 4 * len(sent)
        return full

    def _next_chunk(self) -> Chunk:
        chunk = Chunk(self._number, self._state, _ENCODER.encode(self._steps))
        self._number, self._state, self._steps, self._bytes = self._number + 1, b"", [], 0
        return chunk


def encode_state(state: DecisionState) -> bytes:
    """Return a state as bytes, without the codes or the reference of its run, and its lease.

    They are not needed, because the recording contains the input or the reference. The lease is
    left out, because a reader of the recording could otherwise control the rig. The list of missing
    samples is also left out. It has up to 45 kB, and affects neither a frame nor a sample.
    """
    run, lease = state.run, state.lease
    if run and run.control:
        run = replace(run, control=replace(run.control, reference=b""))
    if run and run.own:
        run = replace(run, own=replace(run.own, reference=b""))
    return _ENCODER.encode(
        replace(
            state,
            absent=(),
            run=replace(run, codes=b"") if run else None,
            lease=replace(lease, lease=_HELD) if lease else None,
        )
    )


def decode_state(data: bytes, source: bytes, version: int = VERSION) -> DecisionState:
    """Return the state that `encode_state` has encoded, with the codes or reference of its run.

    Raises
    ------
    msgspec.DecodeError
        The bytes do not encode a state, or the version is unknown.
    """
    _check(version)
    state = _STATE.decode(data)
    run = state.run
    if run is None:
        return state
    if run.control:
        control = replace(run.control, reference=source)
        return replace(state, run=replace(run, control=control))
    if run.own:
        return replace(state, run=replace(run, own=replace(run.own, reference=source)))
    return replace(state, run=replace(run, codes=source))


def steps_of(chunk: bytes, version: int = VERSION) -> list[DecisionStep]:
    """Return the steps of a chunk; raise as `decode_state` does."""
    _check(version)
    return [
        DecisionStep(now_ns, tuple(_event(number, data) for number, data in events), tuple(sent))
        for now_ns, events, sent in _STEPS.decode(chunk)
    ]


def _check(version: int) -> None:
    if version != VERSION:
        raise msgspec.DecodeError(f"trace of version {version}: only {VERSION} is known")


def _encode_event(event: Event, lease: str) -> bytes:
    if isinstance(event, Ordered):
        return _ENCODER.encode(_without_secrets(event.order, lease))
    return _ENCODER.encode(event)


def _without_secrets(order: Order, lease: str) -> Order:
    """Return an order without its input, which no refusal needs, and with a mark for the lease."""
    if isinstance(order, Run):
        order = replace(order, codes=b"", law=UNSET, reference=UNSET)
    if isinstance(order, Leased | Arm):
        order = replace(order, lease=_HELD if order.lease == lease else "")
    return order


def _event(number: int, data: bytes) -> Event:
    kind = _KINDS[number] if number < len(_KINDS) else None
    if kind is Received:
        return Received(data)
    if kind is Ordered:
        return Ordered(_ORDER.decode(data))
    if kind is None:
        raise msgspec.DecodeError(f"event of kind {number}: 0 to {len(_KINDS) - 1} are known")
    event: Event = _EVENTS[number].decode(data)
    return event
