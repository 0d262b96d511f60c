"""Records of the loop for the service, through a pipe for which the loop never waits."""

from __future__ import annotations

from collections import deque

from armrig_core.commands.codes import GapCode
from armrig_core.process.printable import plural
from armrig_core.telemetry.telemetry import Sample, encode_sample

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

MAX_WAITING_RECORDS = 1000
"""Number of waiting records above which further records of the types in `_INFORM` are dropped."""
_INFORM = (Log, State, Timing, Clock, Trace)


class Outbox:
    """Queue of records for the service; it never blocks, keeps the order and reports losses.

    Samples that find no room are counted and reported as one gap. Other records wait for room. If
    too many records wait, further records of the informative types (`_INFORM`) are dropped and
    counted.
    """

    def __init__(self, ports: Ports) -> None:
        """Start with an empty queue."""
        self._ports = ports
        self._waiting: deque[bytes] = deque()
        self._gap: Gap | None = None
        self._dropped = 0

    def put(self, record: Record) -> None:
        """Pass on a record, now or when the pipe has room."""
        self.flush()
        if len(self._waiting) >= MAX_WAITING_RECORDS and isinstance(record, _INFORM):
            self._dropped += 1
            return
        self._close_gap()
        self._waiting.append(record_bytes(record))
        self.flush()

    def put_sample(self, sample: Sample) -> None:
        """Pass on a sample now, or count it as missing."""
        waits = self._waiting or self._gap is not None or self._dropped
        has_room = not waits or self._has_room_after_gap()
        if has_room and self._ports.put(sample_bytes(encode_sample(sample))):
            return
        first = self._gap
        self._gap = Gap(
            k_first=first.k_first if first else sample.k,
            count=sample.k - first.k_first + 1 if first else 1,
            t_from_ns=first.t_from_ns if first else sample.t_host_ns,
            t_to_ns=sample.t_host_ns,
            u_held_v=sample.u_applied_v,
            reason=GapCode.SERVICE_LATE.sentence,
            code=GapCode.SERVICE_LATE,
        )

    def flush(self) -> None:
        """Pass on the waiting records as far as the pipe has room."""
        while self._waiting and self._ports.put(self._waiting[0]):
            self._waiting.popleft()
        if self._dropped and not self._waiting:
            text = (
                f"{plural(self._dropped, 'message was', 'messages were')} dropped: "
                f"{GapCode.SERVICE_LATE.sentence}"
            )
            self._dropped = 0
            self._waiting.append(
                record_bytes(Log(t_host_ns=self._ports.now_ns(), level="warning", message=text))
            )

    def _has_room_after_gap(self) -> bool:
        """Pass on the waiting records and the gap; return whether the pipe took all of them."""
        self.flush()
        if self._gap is not None and not self._waiting and self._ports.put(record_bytes(self._gap)):
            self._gap = None
        return not self._waiting and self._gap is None

    def _close_gap(self) -> None:
        """Put the gap into the queue, before the next record."""
        if self._gap is not None:
            self._waiting.append(record_bytes(self._gap))
            self._gap = None
