"""Samples of a file: rows of constant layout are read together, other rows one by one.

A row has the constant layout if it contains all fields of a sample, in the usual order and sizes.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import groupby
from operator import attrgetter
from typing import Any

import numpy as np
from armrig_core.recording_file.budget import SAMPLES_LIMIT, DamageError
from armrig_core.recording_file.file_records import MESSAGE_HEAD, RECORD_HEAD
from armrig_core.telemetry import channels as rig_channels
from armrig_core.telemetry import protobuf, telemetry
from mcap.opcode import Opcode
from numpy.typing import NDArray

_FORMATS = {"fixed64": "<u8", "sfixed64": "<i8", "double": "<f8", "fixed32": "<u4"}
SAMPLE_DTYPE = np.dtype([(name, _FORMATS[kind]) for name, kind in rig_channels.SAMPLE_FIELDS])
"""Type of one sample as a numpy record, with the fields of `telemetry.Sample`."""

ROW_LENGTH = MESSAGE_HEAD.size + telemetry.SAMPLE_LENGTH
"""Length of the record of a sample with constant layout, in B."""

_MAX_PENDING_BYTES = 1 << 19  # B; rows are converted when they exceed this size
_K_LIMIT = np.uint64(1 << 62)
_ROOM_MARGIN = 1.1  # relative to the estimated size of the rest of the file
_MIN_GROWTH, _MAX_GROWTH = 1.5, 64  # limits of the growth factor of an allocation


class SampleRows:
    """Collector of a file's samples; k must increase from sample to sample."""

    def __init__(self, spend: Callable[[], None] = lambda: None) -> None:
        """Set the function that `add` calls for each sample; the function may raise DamageError."""
        self.size = 0
        self.last_k = -1
        self._spend = spend
        self._share = 1.0
        self._samples = np.empty(0, SAMPLE_DTYPE)
        self._views: list[memoryview] = []  # views into the current chunk, which stays in memory
        self._pending: list[bytes] = []
        self._pending_size = 0

    def add_run(self, chunk: memoryview, at: int) -> int:
        """Add the run of records from byte `at` of the chunk on; return the size of the run in B.

        A run consists of consecutive messages of one channel; each has the length of a sample. The
        layout of the records is checked later, for many records together. Call `settle` before
        adding a run of another chunk.
        """
        match = _RUN.match(chunk, at)
        end = match.end() if match else at
        self._views.append(chunk[at:end])
        return end - at

    def add(self, message: bytes) -> None:
        """Add one sample of any layout; raises DecodeError if the message is not a sample."""
        self._spend()
        row = _HEAD + telemetry.encode_sample(telemetry.Sample(*_values(message)))
        self._views.append(memoryview(row))

    @property
    def is_empty(self) -> bool:
        """True if no sample was added yet."""
        return not self.size and not self._pending and not self._views

    def finish(self) -> NDArray[np.void]:
        """Remove and return the samples, `SAMPLE_DTYPE`; k increases strictly."""
        samples, self._samples = self._samples, np.empty(0, SAMPLE_DTYPE)
        samples.resize(self.size, refcheck=False)
        return samples

    def settle(self, share: float = 1.0) -> None:
        """Release the chunk; if many rows are collected, convert them as `pack` does.

        The memory for all samples is estimated from the share of the file's chunks that was read.
        """
        self._share = share
        self._copy()
        if self._pending_size > _MAX_PENDING_BYTES:
            self.pack()

    def _copy(self) -> None:
        if self._views:
            rows = b"".join(self._views)
            self._views.clear()
            self._pending.append(rows)
            self._pending_size += len(rows)

    def pack(self) -> None:
        """Convert the collected rows to samples.

        Raises DamageError or DecodeError if a row cannot be read, or k does not increase. The
        samples before this row are kept.
        """
        self._copy()
        if not self._pending:
            return
        data = b"".join(self._pending)
        self._pending, self._pending_size = [], 0
        row_count = len(data) // _ROW_SIZE
        n = min(row_count, SAMPLES_LIMIT - self.size)
        samples = self._room(n)
        _copy_fields(data, samples)
        tags = np.frombuffer(data, np.uint8).reshape(row_count, -1)[:n, _TAG_PLACES]
        for i in np.flatnonzero((tags != _TAGS).any(axis=1)).tolist():
            begin = i * _ROW_SIZE + len(_HEAD)
            try:
                self._spend()
                samples[i] = _values(data[begin : begin + telemetry.SAMPLE_LENGTH])
            except Exception:
                self._keep(samples[:i])
                raise
        self._keep(samples)
        if n < row_count:
            raise DamageError(f"more than {SAMPLES_LIMIT} samples")

    def _room(self, n: int) -> NDArray[np.void]:
        """Return memory for n samples, directly after the kept samples."""
        needed = self.size + n
        if needed > self._samples.size:
            # Unused memory that is reserved costs nothing. A copy of the samples costs memory and
            # time.
            growth = min(max(_ROOM_MARGIN / self._share, _MIN_GROWTH), _MAX_GROWTH)
            room = np.empty(min(int(growth * needed), SAMPLES_LIMIT), SAMPLE_DTYPE)
            room[: self.size] = self._samples[: self.size]
            self._samples = room
        return self._samples[self.size : self.size + n]

    def _keep(self, samples: NDArray[np.void]) -> None:
        """Count the newly written rows as samples; raise DamageError if k does not increase."""
        if not samples.size:
            return
        k = samples["k"]
        rising = np.empty(k.size, np.bool_)
        rising[0] = self.last_k < int(k[0])
        rising[1:] = k[1:] > k[:-1]
        good = k.size if rising.all() else int(rising.argmin())
        good = min(good, int(np.searchsorted(k[:good], _K_LIMIT)))
        if good:
            self.last_k = int(k[good - 1])
            self.size += good
        if good < k.size:
            raise DamageError(
                f"sample {k[good]} comes after sample {self.last_k}: each k must be larger than "
                "the previous k, and less than 2^62"
            )


def _values(message: bytes) -> tuple[Any, ...]:
    """Return the fields of a sample of any layout; missing fields are `protobuf.ABSENT`."""
    fields: tuple[Any, ...] = _field_values(protobuf.decode_message(protobuf.SAMPLE, message))
    return fields


def _copy_fields(data: bytes, samples: NDArray[np.void]) -> None:
    """Copy the fields of the first rows of `data` to `samples`."""
    n = samples.size
    # Fields of one size are copied together. Copies of single fields take three times as long.
    for count, size, at, place in _BLOCKS if n else ():
        kind = f"<u{size}"
        rows = np.ndarray((n, count), kind, data, at, (_ROW_SIZE, 1 + size))
        room = np.ndarray((n, count), kind, samples, place, (SAMPLE_DTYPE.itemsize, size))
        room[...] = rows


def _layout() -> tuple[list[tuple[int, int, int, int]], list[int], NDArray[np.uint8]]:
    """Return the blocks of fields of a record, and the places and values of its tag bytes."""
    # A block of consecutive fields of one size: their number, size, and places in row and sample.
    at, place = len(_HEAD), 0
    blocks: list[tuple[int, int, int, int]] = []
    places: list[int] = []
    sizes = [SAMPLE_DTYPE[name].itemsize for name in rig_channels.SAMPLE_NAMES]
    for size, fields in groupby(sizes):
        count = len(list(fields))
        blocks.append((count, size, at + 1, place))
        places += range(at, at + count * (1 + size), 1 + size)
        at, place = at + count * (1 + size), place + count * size
    example = telemetry.encode_sample(telemetry.Sample(*(0,) * len(sizes)))
    return blocks, places, np.frombuffer(bytes(len(_HEAD)) + example, np.uint8)[places]


def _run() -> re.Pattern[bytes]:
    """Return a pattern of consecutive records of one channel, each as long as a sample."""
    # Of about 35 samples between two messages of other streams, a pattern is four times as fast as
    # numpy. It never backtracks (`*+`), so that it needs no memory.
    head = re.escape(RECORD_HEAD.pack(Opcode.MESSAGE, ROW_LENGTH))
    tail = b".{%d}" % (ROW_LENGTH - 2)  # after the channel
    return re.compile(head + b"(..)" + tail + b"(?:" + head + rb"\1" + tail + b")*+", re.DOTALL)


_field_values = attrgetter(*rig_channels.SAMPLE_NAMES)
# Head of a row that was made from a single message; nothing reads its bytes.
_HEAD = bytes(RECORD_HEAD.size + MESSAGE_HEAD.size)
_ROW_SIZE = RECORD_HEAD.size + ROW_LENGTH
_BLOCKS, _TAG_PLACES, _TAGS = _layout()
_RUN = _run()
