"""Whatever dies, the motor goes to 0 V, and what was recorded can be read.

The bounds here only tell a stop from no stop; docs/safety.md has the measured times.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import armrig
import numpy as np
import pytest
from armrig.rig import RefusedError
from processes import WITHIN_S, Bench, wait_for

STOPPED_S = 1.0
RUNNER = """
import sys
from armrig.rig import Rig
with Rig(connect=sys.argv[1]) as rig:
    rig.arm("a test", Ts=0.002)
    rig.run([1.0, 4.0] * 2000)
"""


class Run:
    """A long run in progress on real processes."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.emulator = bench.emulate()
        self.daemon = bench.serve()
        self.loop_pid = bench.loop_pid(self.daemon)
        endpoint = f"unixsock-stream/{bench.folder}/armrig/1.sock"
        self.client = subprocess.Popen(
            [sys.executable, "-c", RUNNER, endpoint],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        wait_for(lambda: len(bench.voltage_changes()) > 300)

    def left_behind(self) -> armrig.Recording:
        """Return the unfinished recording."""
        (path,) = self.bench.recordings.glob("*.mcap.active")
        return armrig.load(path)


@pytest.fixture
def run(bench: Bench) -> Iterator[Run]:
    """Give a run that drives the motor with 1 V and 4 V in turn, every 2 ms."""
    run = Run(bench)
    yield run
    run.client.kill()
    run.client.wait()


def _reads_up_to_the_last_flush(run: Run, killed_ns: int) -> None:
    recording = run.left_behind()
    assert recording.truncated
    k = recording.samples["k"].astype(np.int64)
    assert np.array_equal(np.diff(k)[np.diff(k) != 1], []) or recording.gaps
    commanded = recording.samples["u_cmd_v"]
    np.testing.assert_allclose(commanded, np.where((k - k[0]) % 2, 4.0, 1.0), atol=1e-4)
    lost_s = (killed_ns - int(recording.samples["t_host_ns"][-1])) / 1e9
    assert lost_s < 1.0  # flushed ten times a second


def test_kill_9_of_the_service(run: Run) -> None:
    """The loop sees its pipes end and stops the motor; the file loads."""
    killed_ns = run.daemon.kill()

    assert run.bench.went_to_0_v_after(killed_ns) < STOPPED_S
    wait_for(lambda: not _alive(run.loop_pid))
    _reads_up_to_the_last_flush(run, killed_ns)


def test_kill_9_of_the_loop(run: Run) -> None:
    """The device's watchdog stops the motor; the service closes the recording and exits with 1."""
    os.kill(run.loop_pid, signal.SIGKILL)
    killed_ns = time.monotonic_ns()

    assert run.bench.went_to_0_v_after(killed_ns) < STOPPED_S
    assert run.daemon.popen.wait(WITHIN_S) == 1
    assert "the loop died" in run.daemon.said
    (path,) = run.bench.recordings.glob("*.mcap")
    recording = armrig.load(path)
    assert not recording.truncated
    assert recording.outcome is not None
    assert recording.outcome.outcome == "the loop ended"


def test_kill_9_of_both(run: Run) -> None:
    """Nobody is left but the device: its watchdog."""
    os.kill(run.loop_pid, signal.SIGKILL)
    killed_ns = run.daemon.kill()

    assert run.bench.went_to_0_v_after(killed_ns) < STOPPED_S
    _reads_up_to_the_last_flush(run, killed_ns)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_it_in_good_order(run: Run, number: signal.Signals) -> None:
    """0 V, a complete file that says why it ended, exit code 0."""
    told_ns = run.daemon.kill(number)

    assert run.daemon.popen.wait(WITHIN_S) == 0
    assert run.bench.went_to_0_v_after(told_ns) < STOPPED_S
    (path,) = run.bench.recordings.glob("*.mcap")
    outcome = armrig.load(path).outcome
    assert outcome is not None
    assert outcome.outcome == "the daemon was ended"
    assert "Traceback" not in run.daemon.said


def test_ctrl_c_reaches_both_processes(run: Run) -> None:
    """A terminal sends SIGINT to the whole group: still one orderly end."""
    os.kill(run.loop_pid, signal.SIGINT)
    told_ns = run.daemon.kill(signal.SIGINT)

    assert run.daemon.popen.wait(WITHIN_S) == 0
    assert run.bench.went_to_0_v_after(told_ns) < STOPPED_S
    assert "Traceback" not in run.daemon.said


def test_the_rig_is_unplugged_and_plugged_in_again(run: Run) -> None:
    """Latched at 0 V; sampling is back by itself; reset and arm lead out."""
    run.emulator.end()
    wait_for(lambda: run.bench.phase() == "fault")
    run.bench.emulate()

    wait_for(lambda: _device_is_known(run.bench))
    assert run.bench.phase() == "fault"
    with run.bench.rig() as rig:
        with pytest.raises(RefusedError, match="in fault"):
            rig.arm("a test")
        rig.reset()
        rig.arm("a test")


def test_a_loop_that_is_frozen_is_stopped_by_the_device(run: Run) -> None:
    """SIGSTOP: the watchdog; after SIGCONT old frames start nothing, the fault stays."""
    os.kill(run.loop_pid, signal.SIGSTOP)
    frozen_ns = time.monotonic_ns()

    assert run.bench.went_to_0_v_after(frozen_ns) < STOPPED_S
    os.kill(run.loop_pid, signal.SIGCONT)
    wait_for(lambda: run.bench.phase() == "fault")
    assert run.bench.volts() == 0.0


def test_a_client_that_dies_does_not_cost_the_recording(run: Run) -> None:
    """An experiment is one command: it is played to its end without its client."""
    run.client.kill()

    with run.bench.rig() as rig:
        wait_for(lambda: rig.status().phase == "safe", within_s=60)
        last = rig.status().last_run
    assert last is not None
    assert last.outcome == "complete"


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def _device_is_known(bench: Bench) -> bool:
    with bench.rig() as rig:
        return bool(rig.status().device)
