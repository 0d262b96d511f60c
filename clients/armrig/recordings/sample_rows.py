"""The samples of a file: rows of constant layout taken many at once, others one by one."""

from __future__ import annotations

import re
from operator import attrgetter
from struct import Struct
from typing import Any

import numpy as np
from armrig_core import telemetry
from mcap.opcode import Opcode
from numpy.typing import NDArray

_FORMATS = {"fixed64": "<u8", "sfixed64": "<i8", "double": "<f8", "fixed32": "<u4"}
SAMPLE_DTYPE = np.dtype([(name, _FORMATS[kind]) for name, kind in telemetry.SAMPLE_FIELDS])
"""One sample as a numpy record: the fields of `armrig_core.telemetry.Sample`."""

RECORD_HEAD = Struct("<BQ")
"""Opcode and length, before each record's content."""
CHANNEL = slice(RECORD_HEAD.size, RECORD_HEAD.size + 2)
"""Where a message record says its channel."""

SAMPLES_LIMIT = 1_100_000
"""Most samples of a file; a run has 1 000 000 at most."""

_SMALLEST_WINDOW, _FIRST_WINDOW, _GROWTH = 8, 512, 8  # rows
_PENDING_LIMIT = 8 << 20  # bytes of rows kept before they are turned into samples


class DamageError(Exception):
    """Reading cannot go on from here; says why."""


class SampleRows:
    """Collects samples, whose k must rise."""

    def __init__(self) -> None:
        self._last_k = -1
        self._size = 0
        self._batches: list[NDArray[np.void]] = []
        self._pending: list[bytes] = []
        self._pending_size = 0
        self._window = _FIRST_WINDOW

    def add_run(self, data: bytes, at: int) -> int:
        """Add the samples of constant layout that begin at `at`, and return their size in B.

        All are of the channel of the first, which holds samples.
        """
        if not _ONE_ROW.match(data, at):  # where no run begins, much faster than numpy
            return 0
        channel = tuple(data[at + CHANNEL.start : at + CHANNEL.stop])
        width, first, window = _ROW.itemsize, at, self._window
        # The windows grow, from about the size of the last run. A hostile file puts another message
        # after each sample: comparing all that is left each time would take quadratic time.
        while n := min(window, (len(data) - at) // width):
            rows = np.frombuffer(data, np.uint8, n * width, at).reshape(n, width)
            same = (rows[:, _FIXED] == _TEMPLATE).all(axis=1)
            same &= (rows[:, CHANNEL] == channel).all(axis=1)
            count = n if same.all() else int(same.argmin())
            at += count * width
            if count < n:
                break
            window *= _GROWTH
        self._window = min(max(2 * (at - first) // width, _SMALLEST_WINDOW), _FIRST_WINDOW)
        self._append(data[first:at])  # a copy: a view of a sample would keep its whole chunk
        return at - first

    def add(self, message: Any) -> None:
        """Add one sample, a protobuf message."""
        self._append(_HEAD + telemetry.encode_sample(telemetry.Sample(*_field_values(message))))

    def finish(self) -> str:
        """Add what is left; return what is wrong with it, or nothing."""
        try:
            self._pack()
        except DamageError as damage:
            return str(damage)
        return ""

    def samples(self) -> NDArray[np.void]:
        """Return what was added, `SAMPLE_DTYPE`, k rising strictly."""
        return np.concatenate(self._batches) if self._batches else np.zeros(0, SAMPLE_DTYPE)

    def _append(self, rows: bytes) -> None:
        self._pending.append(rows)
        self._pending_size += len(rows)
        if self._pending_size > _PENDING_LIMIT:
            self._pack()

    def _pack(self) -> None:
        """Turn the rows collected into samples."""
        if not self._pending:
            return
        rows = np.frombuffer(b"".join(self._pending), _ROW)
        self._pending, self._pending_size = [], 0
        samples = np.empty(rows.size, SAMPLE_DTYPE)
        for name in telemetry.Sample._fields:
            samples[name] = rows[name]
        self._keep(samples)

    def _keep(self, samples: NDArray[np.void]) -> None:
        k = samples["k"]
        rising = np.empty(k.size, np.bool_)
        rising[0] = self._last_k < int(k[0])
        rising[1:] = k[1:] > k[:-1]
        risen = k.size if rising.all() else int(rising.argmin())
        good = min(risen, SAMPLES_LIMIT - self._size)
        if good:
            self._batches.append(samples[:good])
            self._size += good
            self._last_k = int(k[good - 1])
        if good < risen:
            msg = f"more than {SAMPLES_LIMIT} samples"
            raise DamageError(msg)
        if good < k.size:
            msg = f"sample {k[good]} follows sample {self._last_k}: k must rise"
            raise DamageError(msg)


def _layout() -> tuple[np.dtype[np.void], list[int], NDArray[np.uint8]]:
    """Return the row of a sample's message record, where its constant bytes are, and what they are.

    A record is opcode, length, channel, sequence, log time, publish time; then the message.
    """
    head = RECORD_HEAD.size + 2 + 4 + 8 + 8
    names, formats, offsets = list(SAMPLE_DTYPE.names or ()), [], []
    at = head
    for name in names:
        formats.append(SAMPLE_DTYPE[name])
        offsets.append(at + 1)  # after the tag
        at += 1 + SAMPLE_DTYPE[name].itemsize
    row = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": at})
    places = [*range(RECORD_HEAD.size), *(offset - 1 for offset in offsets)]
    example = telemetry.encode_sample(telemetry.Sample(*(0,) * len(names)))
    record = (
        RECORD_HEAD.pack(Opcode.MESSAGE, at - RECORD_HEAD.size)
        + bytes(head - RECORD_HEAD.size)
        + example
    )
    return row, places, np.frombuffer(record, np.uint8)[places]


def _pattern() -> re.Pattern[bytes]:
    """Return what matches one row of constant layout."""
    parts = [b"."] * _ROW.itemsize
    for place, value in zip(_FIXED, _TEMPLATE.tolist(), strict=True):
        parts[place] = re.escape(bytes([value]))
    return re.compile(b"".join(parts), re.DOTALL)


_ROW, _FIXED, _TEMPLATE = _layout()
# Before a sample that was made from a message; nobody reads it.
_HEAD = bytes(_ROW.itemsize - telemetry.SAMPLE_LENGTH)
_ONE_ROW = _pattern()
_field_values = attrgetter(*telemetry.Sample._fields)
