"""Samples of a long file, and the memory for reading them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from armrig.recordings.container import Content, read, streamed
from armrig.recordings.loading import load
from armrig.recordings.verification import recorded_input
from armrig_core.recording_file.budget import DamageError

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


def _content(path: Path) -> Content:
    content = read(path)
    assert content is not None
    return content


def test_the_input_is_read_from_its_place(tmp_path: Path) -> None:
    u = np.random.default_rng(1).uniform(0, 5, 120_000)
    path = written(tmp_path, recorded([sample(0)], u=u.tolist()))
    content = _content(path)

    assert path.stat().st_size > 2 << 20
    assert load(path).damage == ""
    assert content.input is not None
    np.testing.assert_array_equal(recorded_input(path, content.input, u.size), u)
    with pytest.raises(DamageError, match="longer than the 1000 samples of the run"):
        recorded_input(path, content.input, 1000)


def test_a_changed_input_is_reported(tmp_path: Path) -> None:
    whole = recorded([sample(0)], u=[1.25, 2.5, 3.75])
    path = written(tmp_path, whole)
    content = _content(path)
    assert content.input is not None
    assert recorded_input(path, content.input, 3).tolist() == [1.25, 2.5, 3.75]

    for new, why in (
        (b"2.6", "checksum of the attached input"),
        (b"2.x", "not a list of voltages"),
    ):
        path.write_bytes(whole.replace(b"\n2.5\n", b"\n" + new + b"\n"))
        with pytest.raises(DamageError, match=why):
            recorded_input(path, content.input, 3)
