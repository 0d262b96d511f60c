"""A recording of 1 MiB cut at every byte: the beginning comes back without a hole.

To load a million files would take days. What is read before the last record that is whole does not
depend on where the cut is behind it: so each cut is read from that record on, by the same reader,
and a whole load is done at the edges of every record and at every so many bytes.
"""

from __future__ import annotations

import struct
import tempfile
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from random import Random

import numpy as np
from armrig.recordings import container
from armrig.recordings.loading import load
from armrig.recordings.recording import RecordingError
from armrig_core import telemetry
from armrig_core.manifest import INPUT
from armrig_core.recording_file import file_records
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.file_records import Wanted
from mcap.opcode import Opcode

from fuzz.files import in_memory, in_one_line, recording

STRIDE = 4099
"""Bytes from one whole load to the next."""


def noisy(n: int, seed: int) -> Iterator[telemetry.Sample]:
    """Give samples that do not pack well, as a rig's do not."""
    rng = Random(seed)
    for k in range(n):
        t_ns, late_ns = k * 10_000_000, rng.randrange(100_000)
        counts = rng.randrange(65536), rng.randrange(65536)
        yield telemetry.Sample(k, t_ns, t_ns + late_ns, k, 0.1, 0.2, 1.0, 1.0, *counts, 3)


def fuzz(most: int, seed: int) -> Counter[str]:
    """Cut a recording of at least `most` bytes, or a few less, at every byte."""
    data = recording(noisy(most // 50, seed), checked=True, flush_every=50)[:most]
    found = _by_record(data)
    found["bytes"] = len(data)
    with tempfile.TemporaryDirectory(prefix="armrig-fuzz-", dir=in_memory()) as directory:
        path = Path(directory) / "cut.mcap.active"
        path.write_bytes(data)
        near = {edge + off for edge in edges(data) for off in (-1, 0, 1)}
        last = None
        with path.open("r+b") as file:
            for cut in sorted(near.union(range(0, len(data), STRIDE)), reverse=True):
                if 0 <= cut <= len(data):
                    file.truncate(cut)
                    last = _check_load(path, last)
                    found["whole loads"] += 1
    return found


def edges(data: bytes) -> Iterator[int]:
    """Give where each record begins."""
    at = len(file_records.MAGIC)
    while at + 9 <= len(data):
        yield at
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]


def _by_record(data: bytes) -> Counter[str]:
    """Read what is left of each record when it is cut at each of its bytes."""
    found: Counter[str] = Counter()
    reader = container._Reader(container.Content(size=len(data)), container.READ, 1 << 30)
    begins = list(edges(data))
    for begin, end in zip(begins, [*begins[1:], len(data)], strict=True):
        if data[begin] == Opcode.DATA_END:
            break
        before = _taken(reader)
        for cut in range(begin, end):
            assert _said(reader, data[begin:cut]), f"cut at {cut} B"
            assert _taken(reader) == before, f"cut at {cut} B: a part of a record was taken"
            found["cuts"] += 1
        _said(reader, data[begin:end])
        for what in reader.budget.spent:
            reader.budget.regain(what)
    return found


def _said(reader: container._Reader, rest: bytes) -> str:
    try:
        source = ByteSource(BytesIO(rest), len(rest))
        for record in file_records.file_records(source, Wanted(left=INPUT), reader.spend_work):
            reader.add(record)
    except DamageError as damage:
        return str(damage)
    return ""


def _taken(reader: container._Reader) -> tuple[int, ...]:
    rows, content = reader.rows, reader.content
    kept = (content.messages, content.metadata, content.attachments)
    return rows.size, rows._pending_size, *map(len, kept)


def _check_load(path: Path, last: int | None) -> int | None:
    """Load; return how many samples there were, never more than in a file that is longer."""
    try:
        cut = load(path)
    except RecordingError as err:
        in_one_line(err)
        return -1
    assert np.array_equal(cut.samples["k"], np.arange(cut.samples.size))
    assert last is None or cut.samples.size <= last
    assert last != -1, "a shorter file gave more than a longer one"
    return int(cut.samples.size)
