"""A part of a recording is read without the rest, and a long recording within its memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from armrig.recordings.files.container import stream_messages
from armrig.recordings.files.loading import load
from armrig_core.errors import FileError
from armrig_core.recording_file.chunks import Unpacker
from armrig_core.recording_file.manifest import Outcome
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.clients.made_recordings import (
    TS,
    event,
    gap,
    manifest,
    recorded,
    sample,
    timing,
    turning,
    written,
)

N = 2000


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run of 20 s with a gap at its beginning, one in it, and reports each second."""
    readings = [30_000 + 100 * (k % 300) if k % 97 else 0 for k in range(N)]
    messages: list[object] = [gap(0, 50, 2.0)]
    for one in turning(readings)[50:]:
        k = one.k
        if k == 900:
            messages.append(gap(900, 30, 3.0))
        if not 900 <= k < 930:
            messages.append(one._replace(t_sched_ns=sample(k).t_sched_ns, u_applied_v=k / N))
        if k % 100 == 0:
            messages += [timing(k), event(k, f"at {k}")]
    about = manifest(k_first=0, samples=N)
    ended = Outcome(outcome="complete", samples=N - 80, missing=80)
    data = recorded(messages, manifest=about, outcome=ended, flush_every=20)
    return written(tmp_path_factory.mktemp("long"), data)


@settings(max_examples=40)
@example(50, 1)
@example(98, 50)  # the sample before the first is at a rail
@given(st.integers(0, N - 2), st.integers(1, N))
def test_a_part_is_the_same_as_that_part_of_the_whole(long: Path, first: int, n: int) -> None:
    whole, end = load(long), min(first + n, N)

    part = load(long, start=first * TS, stop=(first + n) * TS)

    assert (part.k_first, part.N, part.sha256) == (first, end - first, whole.sha256)
    for name in ("t", "u", "alpha", "valid", "valid_alpha", "present"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[first:end])
    turns = (part.theta_1 - whole.theta_1[first:end])[part.valid] / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    for of_part, of_whole in ((part.events, whole.events), (part.timing, whole.timing)):
        times = [x.t for x in of_whole if first * TS <= x.t < end * TS]
        assert [x.t for x in of_part] == times
    assert (part.part, whole.part) == (pytest.approx((first * TS, end * TS)), None)
    assert len(part.gaps) == (first < 50) + (first < 930 and end > 900)


def test_late_samples_belong_to_the_part_of_their_time(tmp_path: Path) -> None:
    late_ns = 5_000_000_000
    samples = [sample(k) for k in range(800)]
    samples[100:] = [s._replace(t_host_ns=s.t_host_ns + late_ns) for s in samples[100:]]
    path = written(tmp_path, recorded(samples, manifest=manifest(samples=800), flush_every=20))

    # The last one, 140, is alone in its chunk.
    part = load(path, start=0.5, stop=1.41)

    assert (part.k_first, part.N, part.missing) == (50, 91, 0)
    assert [str(step) for step in part.dataset().history] == ["took 0.5 to 1.41 s of the run"]


def test_a_second_around_the_part_is_read(tmp_path: Path) -> None:
    """A sample may come before it was due, and a report may follow the sample that it describes."""
    early_ns = 900_000_000
    messages: list[object] = [
        sample(k)._replace(t_host_ns=sample(k).t_host_ns - early_ns) for k in range(100, 800)
    ]
    messages.insert(190, event(200, "told 0.9 s later"))  # after sample 289
    path = written(tmp_path, recorded(messages, manifest=manifest(samples=800), flush_every=20))

    part = load(path, start=1.5, stop=2.1)

    assert (part.k_first, part.N, part.missing) == (250, 60, 0)
    assert [e.message for e in load(path, start=0.5, stop=1.1).events] == ["told 0.9 s later"]


def test_chunks_outside_the_part_are_not_unpacked(
    long: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first chunk is read, because it contains the comparison of the clocks."""
    unpacked = []
    records = Unpacker.records

    def counted(self: Unpacker, body: bytes) -> bytes:
        unpacked.append(len(body))
        return records(self, body)

    monkeypatch.setattr(Unpacker, "records", counted)
    load(long)
    of_the_whole = len(unpacked)
    load(long, start=10.0, stop=10.5)

    assert of_the_whole > 90
    assert len(unpacked) - of_the_whole < 20


@pytest.mark.parametrize(
    ("start", "stop", "why"),
    [
        (-1.0, 2.0, "0 <= start < stop"),
        (2.0, 2.0, "0 <= start < stop"),
        (float("nan"), None, "0 <= start < stop"),
        (100.0, None, r"it contains no sample from 100 s on; its run has \d+ s"),
        (1e300, 1e301, "it contains no sample"),
    ],
)
def test_a_range_without_samples_is_refused(
    long: Path, start: float, stop: float | None, why: str
) -> None:
    with pytest.raises(FileError, match=why):
        load(long, start=start, stop=stop)


_PEAK = """
import sys
from armrig.recordings.files.loading import load
peak = lambda: int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0]) / 1024
load(sys.argv[1])
before = peak()
rec = load(sys.argv[2])
names = ("t", "u", "theta_1", "alpha", "valid", "valid_alpha", "present", "samples")
print(peak() - before, sum(getattr(rec, name).nbytes for name in names) / 2**20)
"""


@pytest.mark.exhaustive
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc/self/status")
def test_memory_is_linear_in_the_arrays(tmp_path: Path) -> None:
    """At most twice the returned arrays, in addition to what any file may need."""
    N = 100_000
    small = written(tmp_path, recorded([sample(0)]), "small.mcap")
    messages = (sample(k) for k in range(N))
    long = written(tmp_path, recorded(messages, manifest=manifest(samples=N)), "long.mcap")

    told = subprocess.run(
        [sys.executable, "-c", _PEAK, small, long], capture_output=True, text=True, check=True
    ).stdout
    peak, arrays = (float(word) for word in told.split())

    assert arrays == pytest.approx(N * 111 / 2**20)
    assert peak <= 2 * arrays + 16


def test_a_file_may_have_more_samples_than_a_run(tmp_path: Path) -> None:
    """An hour at 1 kHz has 3.6 million samples."""
    from armrig.recordings.grid import grid

    rows = grid(np.arange(3_600_000, dtype=np.uint64), manifest(), None, ())

    assert rows.N == 3_600_000


def test_a_stream_of_a_file_that_is_cut_off_ends_at_the_cut(tmp_path: Path) -> None:
    whole = recorded([m for k in range(300) for m in (sample(k), timing(k))], flush_every=20)
    cut = written(tmp_path, whole[: len(whole) // 2])

    assert 0 < len(list(stream_messages(cut, "timing"))) < 300
