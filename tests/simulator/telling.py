"""The loop's ways to the service, with the checks at their ends."""

from __future__ import annotations

from typing import TYPE_CHECKING

from armrig_core.telemetry.telemetry import Sample, decode_sample
from armrig_daemon.loop.outbox import Outbox
from armrig_daemon.pipe import Record, take_records

if TYPE_CHECKING:
    from tests.simulator.rig import Rig


class Silent:
    """A meter that measures nothing, because no decision depends on the timing."""

    def _nothing(self, *_: object) -> None:
        return None

    note_wake = note_round_trip = note_queue = note_sample = forget_device = is_second_over = (
        _nothing
    )


class Teller:
    """A pipe that always has room, read at once."""

    def __init__(self, rig: Rig) -> None:
        """Begin without any record."""
        self._rig = rig

    @property
    def waiting(self) -> int:
        """Number of records that wait for room."""
        return 0

    def put(self, record: Record) -> None:
        """Hand over a record."""
        self._rig.checks.told(self._rig.emulation_ns, record)
        self._rig.heard(record)

    def put_sample(self, sample: Sample) -> None:
        """Hand over a sample."""
        self._rig.checks.sampled(self._rig.now, sample)
        self._rig.checks.published(self._rig.now, sample)

    def flush(self) -> None:
        """Do nothing: nothing waits."""


class FullPipe(Teller):
    """The real outbox, before a pipe that is full at times; `read` is the pipe's other end."""

    def __init__(self, rig: Rig) -> None:
        """Begin with an empty pipe."""
        super().__init__(rig)
        self._outbox = Outbox(rig)

    @property
    def waiting(self) -> int:
        """Number of records that wait for room."""
        return len(self._outbox._waiting)

    def put(self, record: Record) -> None:
        """Hand over a record; a decision of the core is judged before it waits."""
        self._rig.checks.told(self._rig.emulation_ns, record)
        self._outbox.put(record)

    def put_sample(self, sample: Sample) -> None:
        """Hand over a sample."""
        self._rig.checks.sampled(self._rig.now, sample)
        self._outbox.put_sample(sample)

    def flush(self) -> None:
        """Hand over what waits."""
        self._outbox.flush()


def read(rig: Rig, text: bytes) -> None:
    """Take what came through the pipe."""
    for record in take_records(bytearray(text)):
        if isinstance(record, bytes):
            sample = decode_sample(record)
            if sample is not None:
                rig.checks.published(rig.now, sample)
            continue
        rig.heard(record)
