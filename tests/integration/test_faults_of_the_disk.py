"""Faults of the recordings' directory, in addition to `test_recorder.py`."""

from __future__ import annotations

import resource
import time
from pathlib import Path

import armrig

from tests.integration.driving import (
    STOPPED_S,
    check_every_k,
    check_volts,
    driven,
    last_run,
    outcome,
    recorded,
)
from tests.integration.processes import Bench, wait_for

ROOM = 10 << 10  # B; a busy machine writes its log into it, and 16 KiB would hold the footer, too


def test_a_disk_that_fills_during_a_run_stops_it_and_keeps_its_samples(bench: Bench) -> None:
    """RLIMIT_FSIZE."""
    bench.emulate()
    daemon = bench.serve()
    with driven(bench, samples=3000):  # it would go on for longer than anybody waits here
        wait_for(lambda: list(bench.recordings.glob("*.active")))
        (active,) = bench.recordings.glob("*.active")
        _, most = resource.prlimit(daemon.popen.pid, resource.RLIMIT_FSIZE)
        full = (active.stat().st_size + ROOM, most)
        resource.prlimit(daemon.popen.pid, resource.RLIMIT_FSIZE, full)

        wait_for(lambda: bench.volts() == 0.0)
        last = last_run(bench)
    assert "File too large; the flushed samples are kept there" in last.outcome
    assert Path(last.recording) == active
    recording = armrig.load(active)
    assert recording.truncated
    assert recording.samples.size > 20
    check_every_k(recording)
    check_volts(bench)

    resource.prlimit(daemon.popen.pid, resource.RLIMIT_FSIZE, (most, most))
    with bench.rig() as rig:
        wait_for(lambda: rig.status().phase == "safe")
        rig.arm("a test")
        assert not armrig.load(rig.run([1.0, 4.0])).truncated


def test_a_directory_moved_during_a_run_keeps_its_recording(bench: Bench) -> None:
    bench.emulate()
    daemon = bench.serve()
    elsewhere = bench.folder / "elsewhere"
    with driven(bench):
        moved_ns = time.monotonic_ns()
        bench.recordings.rename(elsewhere)
        stopped_s = bench.went_to_0_v_after(moved_ns)

        recording = recorded(bench)

    assert stopped_s < STOPPED_S
    assert "was moved while it was written" in outcome(recording)
    assert [recording.path] == [*elsewhere.iterdir()]
    assert not recording.truncated
    assert recording.samples.size > 20
    check_every_k(recording)
    check_volts(bench)
    assert "Traceback" not in daemon.said
    with bench.rig() as rig:
        wait_for(lambda: rig.status().phase == "safe")
        rig.arm("a test")
        assert armrig.load(rig.run([1.0, 4.0])).samples.size == 2
