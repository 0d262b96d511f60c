"""What the loop says to the service, through a pipe that it never waits for."""

from __future__ import annotations

from collections import deque

from armrig_core.telemetry import Sample, encode_sample

from armrig_daemon.loop.ports import Ports
from armrig_daemon.pipe import (
    Clock,
    Gap,
    Log,
    Record,
    State,
    Timing,
    Trace,
    record_bytes,
    sample_bytes,
)

MOST_WAITING = 1000
"""Records that may wait for room in the pipe before those that only inform are dropped."""
_INFORM = (Log, State, Timing, Clock, Trace)


class Outbox:
    """The way to the service: never waits, keeps the order, and tells what it drops.

    Samples that find no room are counted and told as one gap. Records wait for room; where too
    many wait, those that only inform are dropped and counted.
    """

    def __init__(self, ports: Ports) -> None:
        """Start with nothing waiting."""
        self._ports = ports
        self._waiting: deque[bytes] = deque()
        self._gap: Gap | None = None
        self._dropped = 0

    def put(self, record: Record) -> None:
        """Hand over a record, now or when there is room."""
        self.flush()
        if len(self._waiting) >= MOST_WAITING and isinstance(record, _INFORM):
            self._dropped += 1
            return
        self._close_gap()
        self._waiting.append(record_bytes(record))
        self.flush()

    def put_sample(self, sample: Sample) -> None:
        """Hand over a sample, now or never."""
        if self._has_room_after_gap() and self._ports.put(sample_bytes(encode_sample(sample))):
            return
        first = self._gap
        self._gap = Gap(
            k_first=first.k_first if first else sample.k,
            count=sample.k - first.k_first + 1 if first else 1,
            t_from_ns=first.t_from_ns if first else sample.t_host_ns,
            t_to_ns=sample.t_host_ns,
            u_held_v=sample.u_applied_v,
            reason="the service did not keep up",
        )

    def flush(self) -> None:
        """Hand over what waits, as far as there is room."""
        while self._waiting and self._ports.put(self._waiting[0]):
            self._waiting.popleft()
        if self._dropped and not self._waiting:
            text = f"{self._dropped} messages were dropped: the service did not keep up"
            self._dropped = 0
            self._waiting.append(
                record_bytes(Log(t_host_ns=self._ports.now_ns(), level="warning", message=text))
            )

    def _has_room_after_gap(self) -> bool:
        """Hand over what came before the next sample; return whether all of it went."""
        self.flush()
        if self._gap is not None and not self._waiting and self._ports.put(record_bytes(self._gap)):
            self._gap = None
        return not self._waiting and self._gap is None

    def _close_gap(self) -> None:
        """Put the gap in its place: before what comes now."""
        if self._gap is not None:
            self._waiting.append(record_bytes(self._gap))
            self._gap = None
