"""After the death of any process the motor goes to 0 V, and the recording can be read.

The bounds here only separate a stop from no stop; docs/safety.md has the measured times.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import armrig
import numpy as np
import pytest
from armrig.rig.replies import RefusedError

from tests.integration.driving import STOPPED_S, driven, outcome
from tests.integration.processes import (
    WITHIN_S,
    Bench,
    Process,
    freeze,
    newest,
    state_of,
    wait_for,
)


class Run(NamedTuple):
    """A long run in progress on a bench whose daemon was started last."""

    bench: Bench
    emulator: Process
    daemon: Process
    loop_pid: int

    def flushed_ns(self) -> int:
        """Return a time of this run, once the samples up to it are in the file."""
        now_ns = time.monotonic_ns()
        wait_for(lambda: list(self.bench.recordings.glob("*.mcap.active")))
        (path,) = self.bench.recordings.glob("*.mcap.active")
        wait_for(lambda: newest(path, "t_host_ns") >= now_ns)
        return now_ns

    def left_behind(self) -> armrig.Recording:
        """Return the unfinished recording."""
        (path,) = self.bench.recordings.glob("*.mcap.active")
        return armrig.load(path)


@contextmanager
def _running(bench: Bench) -> Iterator[Run]:
    loop_pid = bench.loop_pid(bench.daemon)
    with driven(bench, samples=4000):
        yield Run(bench, bench.emulator, bench.daemon, loop_pid)


@pytest.fixture
def run(bench: Bench) -> Iterator[Run]:
    """Give a run that drives the motor with 1 V and 4 V in turn, every 10 ms."""
    bench.emulate()
    bench.serve()
    with _running(bench) as run:
        yield run


@pytest.fixture
def run_of_many(served: Bench) -> Iterator[Run]:
    """Give such a run on a daemon that the last tests here share; none of them ends it."""
    with _running(served) as run:
        yield run


def _reads_up_to_the_last_flush(run: Run, flushed_ns: int) -> None:
    recording = run.left_behind()
    assert recording.truncated
    k = recording.samples["k"].astype(np.int64)
    told = sum(gap.count for gap in recording.gaps if gap.k_first < k[-1])
    assert k[-1] - k[0] + 1 == k.size + told
    commanded = recording.samples["u_cmd_v"]
    np.testing.assert_allclose(commanded, np.where((k - k[0]) % 2, 4.0, 1.0), atol=1e-4)
    assert recording.samples["t_host_ns"][-1] >= flushed_ns


def test_a_killed_service_leaves_the_motor_at_0_v_and_a_recoverable_file(run: Run) -> None:
    """The loop sees its pipes end and stops the motor; the next start completes the file."""
    flushed_ns = run.flushed_ns()
    killed_ns = run.daemon.kill()

    assert run.bench.went_to_0_v_after(killed_ns) < STOPPED_S
    wait_for(lambda: not Path(f"/proc/{run.loop_pid}").exists())
    run.daemon.popen.wait(WITHIN_S)
    _reads_up_to_the_last_flush(run, flushed_ns)

    left = run.left_behind()
    daemon = run.bench.serve()
    wait_for(lambda: "recovered" in daemon.said)
    assert not list(run.bench.recordings.glob("*.mcap.active"))
    path = left.path.with_suffix("")
    recording = armrig.load(path)
    assert not recording.truncated
    np.testing.assert_array_equal(recording.samples, left.samples)
    assert f"{path}: recovered, {left.samples.size} samples" in daemon.said


def test_a_killed_loop_leaves_the_motor_at_0_v_and_a_complete_file(run: Run) -> None:
    """The device's watchdog stops the motor; the service closes the recording and exits with 1."""
    os.kill(run.loop_pid, signal.SIGKILL)
    killed_ns = time.monotonic_ns()

    assert run.bench.went_to_0_v_after(killed_ns) < STOPPED_S
    assert run.daemon.popen.wait(WITHIN_S) == 1
    assert "the loop died" in run.daemon.said
    path = run.bench.recording()
    recording = armrig.load(path)
    assert not recording.truncated
    assert outcome(recording) == "the loop ended"


def test_a_killed_daemon_leaves_the_motor_at_0_v(run: Run) -> None:
    """Only the device's watchdog is left."""
    flushed_ns = run.flushed_ns()
    freeze(run.daemon.popen.pid)  # or it may see the loop's end before its own
    os.kill(run.loop_pid, signal.SIGKILL)
    killed_ns = run.daemon.kill()

    assert run.bench.went_to_0_v_after(killed_ns) < STOPPED_S
    run.daemon.popen.wait(WITHIN_S)
    _reads_up_to_the_last_flush(run, flushed_ns)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_daemon_in_good_order(run: Run, number: signal.Signals) -> None:
    """0 V, a complete file that says why it ended, exit code 0."""
    told_ns = run.daemon.kill(number)

    assert run.daemon.popen.wait(WITHIN_S) == 0
    assert run.bench.went_to_0_v_after(told_ns) < STOPPED_S
    assert outcome(armrig.load(run.bench.recording())) == "the daemon was ended"
    assert "Traceback" not in run.daemon.said


def test_ctrl_c_reaches_both_processes(run: Run) -> None:
    """A terminal sends SIGINT to the whole group; here the loop acts on it before the service."""
    freeze(run.daemon.popen.pid)
    os.kill(run.loop_pid, signal.SIGINT)
    told_ns = run.daemon.kill(signal.SIGINT)
    wait_for(lambda: state_of(run.loop_pid) == "Z")
    os.kill(run.daemon.popen.pid, signal.SIGCONT)

    assert run.daemon.popen.wait(WITHIN_S) == 0
    assert run.bench.went_to_0_v_after(told_ns) < STOPPED_S
    assert "Traceback" not in run.daemon.said


def test_the_device_stops_the_motor_of_a_frozen_loop(run_of_many: Run) -> None:
    """After SIGCONT old frames start nothing, and the fault stays."""
    run = run_of_many
    freeze(run.loop_pid)
    frozen_ns = time.monotonic_ns()

    assert run.bench.went_to_0_v_after(frozen_ns) < STOPPED_S
    os.kill(run.loop_pid, signal.SIGCONT)
    wait_for(lambda: run.bench.phase() == "fault")
    assert run.bench.volts() == 0.0


def test_a_rig_plugged_in_again_is_in_fault_until_a_reset(run_of_many: Run) -> None:
    run = run_of_many
    run.emulator.end()
    wait_for(lambda: run.bench.phase() == "fault")
    run.bench.emulate()

    wait_for(lambda: _device_is_known(run.bench))
    assert run.bench.settled() == "fault"
    with run.bench.rig() as rig:
        with pytest.raises(RefusedError, match="in fault"):
            rig.arm("a test")
        rig.reset()
        rig.arm("a test")


def _device_is_known(bench: Bench) -> bool:
    with bench.rig() as rig:
        return bool(rig.status().device)
