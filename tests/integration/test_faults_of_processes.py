"""Faults of the daemon's processes, in addition to `test_every_way_out.py`."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import signal
import time
from pathlib import Path

import armrig
import pytest

from tests.integration.driving import (
    STOPPED_S,
    check_every_k,
    check_volts,
    driven,
    hold,
    outcome,
    recorded,
)
from tests.integration.processes import WITHIN_S, Bench, Process, freeze, wait_for


def _ends_in_good_order(bench: Bench, daemon: Process, number: signal.Signals) -> None:
    told_ns = daemon.kill(number)
    code = daemon.popen.wait(WITHIN_S)
    assert code == 0, daemon.said
    assert "Traceback" not in daemon.said
    if bench.trace.exists():
        assert bench.went_to_0_v_after(told_ns) < STOPPED_S


def test_a_signal_during_the_wait_for_a_device_ends_the_daemon(bench: Bench) -> None:
    master, slave = pty.openpty()
    bench.port = Path(os.ttyname(slave))
    bench.configure()
    daemon = bench.start("armrig_daemon", "run", "--config", str(bench.config))
    wait_for(lambda: bench.phase() == "init")

    _ends_in_good_order(bench, daemon, signal.SIGTERM)
    os.close(master)
    os.close(slave)


def test_a_signal_during_a_manual_voltage_stops_the_motor(bench: Bench) -> None:
    bench.emulate()
    daemon = bench.serve()
    with bench.rig() as rig:
        hold(rig, bench, 4.0)

        _ends_in_good_order(bench, daemon, signal.SIGINT)
    check_volts(bench)


def test_a_signal_ends_the_daemon_in_an_exchange_run_and_in_a_fault(bench: Bench) -> None:
    emulator = bench.emulate()
    daemon = bench.serve()
    with driven(bench, pacing="exchange"):
        _ends_in_good_order(bench, daemon, signal.SIGTERM)
    assert bench.recording().stat().st_size > 0
    daemon = bench.serve()
    with driven(bench):
        emulator.end()
        wait_for(lambda: bench.phase() == "fault")
        bench.trace.unlink()

        _ends_in_good_order(bench, daemon, signal.SIGINT)


def test_a_killed_lab_ends_its_daemon(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """`kill -9`: 0 V, the run recorded up to then, the socket free for the next lab."""
    monkeypatch.setenv("XDG_STATE_HOME", str(bench.folder))
    bench.emulate()
    lab = bench.start("armrig", "lab", "--config", str(bench.config), "--port", str(bench.port))
    bench.is_served_by(lab)
    with driven(bench):
        told_ns = lab.kill(signal.SIGKILL)

        wait_for(lambda: list(bench.recordings.glob("*.mcap")))
        assert bench.went_to_0_v_after(told_ns) < STOPPED_S
    recording = armrig.load(bench.recording())
    assert outcome(recording) == "the daemon was ended"
    check_every_k(recording)
    check_volts(bench)
    assert not list(bench.recordings.glob("*.active"))
    wait_for(lambda: bench.phase() == "")
    bench.serve()


def test_repeated_signals_do_not_change_the_end_of_the_daemon(bench: Bench) -> None:
    """SIGTERM again and again, to the service and to its loop."""
    bench.emulate()
    daemon = bench.serve()
    pids = daemon.popen.pid, bench.loop_pid(daemon)
    with driven(bench):
        told_ns = time.monotonic_ns()
        while daemon.popen.poll() is None and time.monotonic_ns() < told_ns + WITHIN_S * 1e9:
            for pid in pids:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGTERM)
            time.sleep(0.0003)

        assert daemon.popen.wait(WITHIN_S) == 0, daemon.said
        assert bench.went_to_0_v_after(told_ns) < STOPPED_S
    assert bench.recording().suffix == ".mcap"


@pytest.mark.timed
def test_a_loop_that_was_frozen_in_exchange_mode_trips(bench: Bench) -> None:
    """SIGSTOP, 300 ms, SIGCONT: at its first tick, or by a report of the device."""
    bench.emulate()
    daemon = bench.serve()
    loop_pid = bench.loop_pid(daemon)
    with driven(bench, pacing="exchange"):
        freeze(loop_pid)
        time.sleep(0.3)
        thawed_ns = time.monotonic_ns()
        os.kill(loop_pid, signal.SIGCONT)

        recording = recorded(bench)
    ended = outcome(recording)
    assert "the host paused for" in ended or "WATCHDOG" in ended
    assert re.search(r" \(load \d+\.\d on \d+ processors?.*; see `armrig doctor`\)$", ended)
    check_every_k(recording)
    check_volts(bench)
    assert bench.voltage_changes()[-1][0] < thawed_ns, "driven on by the frames of before"
