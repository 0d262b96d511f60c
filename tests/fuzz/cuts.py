"""A recording that ends anywhere: its beginning comes back without a hole, up to the last flush."""

from __future__ import annotations

import struct
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from random import Random
from typing import NamedTuple

import numpy as np
from armrig.recordings.files.loading import load
from armrig.recordings.recording import Recording
from armrig_core.errors import FileError
from armrig_core.recording_file import file_records
from armrig_core.recording_file.manifest import CONFIG, INPUT, Manifest, Outcome
from armrig_core.recording_file.recording_part import RecordingPart
from armrig_core.telemetry import telemetry
from armrig_core.telemetry.telemetry import Outgoing

from tests.fuzz.files import in_memory, in_one_line

SMALL, LARGE = 64 << 10, 1 << 20
"""Sizes of the files that are cut, in B."""
FLUSH = 100
"""Samples from one flush to the next: a tenth of a second at 1 kHz."""
_NS = 1_000_000  # from sample to sample
_OFFSET_NS = 10**18


class Flushed(NamedTuple):
    """State of a recording at a flush."""

    size: int
    """Size of the file, in B."""
    samples: int
    """In the file."""


def every_byte(_most: int, seed: int) -> Counter[str]:
    """Cut a file of 64 KiB at every byte."""
    return cut(SMALL, seed, lambda flushes: range(flushes[-1].size + 1))


def any_place(most: int, seed: int) -> Counter[str]:
    """Cut a file of 1 MiB at so many random places."""
    rng = Random(seed)
    return cut(LARGE, seed, lambda flushes: rng.sample(range(flushes[-1].size + 1), most))


def near_edges(most: int, seed: int) -> Counter[str]:
    """Cut a file of 64 KiB before, at and after each flush, and at so many random places."""
    rng = Random(seed)

    def places(flushes: list[Flushed]) -> set[int]:
        edges = {f.size + off for f in flushes for off in (-1, 0, 1)}
        return edges | set(rng.sample(range(flushes[-1].size), most))

    return cut(SMALL, seed, places)


def cut(size: int, seed: int, places: Callable[[list[Flushed]], Iterable[int]]) -> Counter[str]:
    """Cut a recording of at least `size` B, or some more, and load the rest each time."""
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="armrig-fuzz-", dir=in_memory()) as directory:
        path = Path(directory) / "cut.mcap"
        flushes = written(path, size, seed)
        found["B"] = whole = path.stat().st_size
        assert whole > size
        n = len(flushes) - 1
        with path.open("r+b") as file:
            for place in sorted(places(flushes), reverse=True):  # so that no byte comes back
                if place > whole:
                    continue
                file.truncate(place)
                while flushes[n].size > place and n:
                    n -= 1
                found[check(path, flushes[n] if flushes[n].size <= place else None)] += 1
                found["cuts"] += 1
    return found


def written(path: Path, size: int, seed: int) -> list[Flushed]:
    """Write a recording as the daemon does; return its content at each flush and at its end."""
    samples, flushes = noisy(10**6, seed), []
    part = RecordingPart(path).begin(
        _manifest(), {CONFIG: b"{}", INPUT: b"u_v\n" + b"1.0\n" * 1000}, 0
    )
    flushes.append(Flushed(part.size, 0))
    while part.size < size:
        for _ in range(FLUSH):
            sample = next(samples)
            data = telemetry.encode_sample(sample)
            part.add(Outgoing("sample", sample.t_host_ns, sample.t_sched_ns, sample.k, data))
        part.flush()
        flushes.append(Flushed(part.size, part.samples))
    part.finish(Outcome(outcome="stopped", samples=part.samples, missing=0))
    part.name()
    return [*flushes, Flushed(part.size, part.samples)]


def noisy(n: int, seed: int) -> Iterator[telemetry.Sample]:
    """Give samples that do not pack well, as a rig's do not."""
    rng = Random(seed)
    for k in range(n):
        t_ns, late_ns = k * _NS, rng.randrange(100_000)
        counts = rng.randrange(65536), rng.randrange(65536)
        yield telemetry.Sample(k, t_ns, t_ns + late_ns, k, 0.1, 0.2, 1.0, 1.0, *counts, 3)


def _manifest() -> Manifest:
    return Manifest(
        **{"rig": "1", "run_id": "r", "experiment": "fuzz", "Ts": _NS / 1e9, "samples": 10**6},
        **{"k_first": 0, "started": "2026-01-01T00:00:00+00:00", "clock_offset_ns": _OFFSET_NS},
        **{"armrig": "0", "protocol": "1"},
    )


def check(path: Path, last: Flushed | None) -> str:
    """Load a file that ends after its flush `last`; None if it ends before the first."""
    loaded = _loaded(path)
    if loaded is None:
        assert last is None, f"what was flushed of {path.stat().st_size} B is refused"
        return "refused"
    found = loaded.samples["k"]
    assert np.array_equal(found, np.arange(found.size))
    wanted = 0 if last is None else last.samples
    # The sizes and checksums after the samples of a flush may be cut off; they are not needed.
    assert wanted <= found.size <= wanted + FLUSH, f"{found.size} of {wanted} samples"
    return "cut" if loaded.truncated else "whole"


def _loaded(path: Path) -> Recording | None:
    try:
        return load(path)
    except FileError as err:
        in_one_line(err)
        return None


def edges(data: bytes) -> Iterator[int]:
    """Give where each record begins."""
    at = len(file_records.MAGIC)
    while at + 9 <= len(data):
        yield at
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
