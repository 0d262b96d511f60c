"""Samples of a long file, and the memory for reading them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from armrig.recordings.container import streamed

from tests.clients.made_recordings import manifest, recorded, sample, timing, written

_PEAK = """
import sys
from armrig.recordings.loading import load
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


def test_one_stream_is_read_without_keeping_it(tmp_path: Path) -> None:
    messages = [m for k in range(300) for m in (sample(k), timing(k))]
    whole = recorded(messages, flush_every=20)
    path = written(tmp_path, whole)
    cut = written(tmp_path, whole[: len(whole) // 2], "cut.mcap")

    assert [m.t_host_ns for m in streamed(path, "timing")] == [
        sample(k).t_host_ns for k in range(300)
    ]
    assert 0 < len(list(streamed(cut, "timing"))) < 300
