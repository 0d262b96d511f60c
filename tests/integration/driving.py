"""A client that drives the motor during a failure, and the remains of its run."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import armrig
import numpy as np
from armrig.rig.client import Rig, RigError
from armrig.rig.replies import RefusedError
from armrig_core.commands.commands import LastRun
from armrig_protocol.messages import Cause

from tests.integration.fork_server import Forked
from tests.integration.processes import WITHIN_S, Bench, wait_for

VOLTS = (1.0, 4.0)
STOPPED_S = 1.0
"""Threshold between a stop and no stop on a busy machine; `tests/benchmarks/stops.py` measures."""
_OF_A_BUSY_MACHINE = ("pause", "stale", "missed", "applied")  # faults, by their ids
_STEP_V = 5 / 1024  # of the emulated duty
_RUNNER = """
import sys
from armrig.rig.client import Rig
with Rig(connect=sys.argv[1]) as rig:
    rig.arm("a test", Ts=float(sys.argv[4]))
    rig.run([1.0, 4.0] * (int(sys.argv[2]) // 2), pacing=sys.argv[3])
"""

_OPEN = """
import sys, time, zenoh
config = zenoh.Config.from_json5('{mode: "client", connect: {endpoints: ["%s"]}}' % sys.argv[1])
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
"""


@contextmanager
def stranger(bench: Bench, program: str, *arguments: object) -> Iterator[Popen[str]]:
    """Run a client that means no good; it has a zenoh session, and has said that it is there."""
    command = ["nice", sys.executable, "-c", _OPEN + program, bench.endpoint]
    client = Popen([*command, *map(str, arguments)], stdout=PIPE, text=True)
    try:
        assert client.stdout is not None
        assert client.stdout.readline() == "there\n"
        yield client
    finally:
        client.kill()
        client.communicate()


@contextmanager
def driven(
    bench: Bench, samples: int = 1000, pacing: str = "scheduled", Ts: float = 0.01
) -> Iterator[None]:
    """Have a client of its own process run 1 V and 4 V in turn; it is killed at the end."""
    client = begin(bench, 20, _RUNNER, str(samples), pacing, str(Ts))
    try:
        yield
    finally:
        client.kill()
        client.wait()


def begin(bench: Bench, changes: int, runner: str, *arguments: str) -> Popen[bytes] | Forked:
    """Start a client that drives the motor, and return it once the voltage has changed so often.

    A run that a busy machine ends before, as the daemon must, is begun again, at most 7 times.
    """
    for _ in range(8):
        enough = len(bench.voltage_changes()) + changes
        client = bench.client(runner, bench.endpoint, *arguments)
        if _drives(client, bench, enough):
            return client
        with bench.rig() as rig:
            status = rig.status()
        if status.fault not in _OF_A_BUSY_MACHINE and Cause.WATCHDOG.name not in status.reason:
            break
        bring_to_rest(bench)
    raise AssertionError(status.reason)


def _drives(client: Popen[bytes] | Forked, bench: Bench, enough: int) -> bool:
    try:
        wait_for(lambda: changed(bench, enough) or client.poll() is not None)
    except BaseException:
        client.kill()
        client.wait()
        raise
    return changed(bench, enough)


def changed(bench: Bench, times: int) -> bool:
    """Return whether the voltage has changed more than so many times."""
    return len(bench.voltage_changes()) > times


def hold(rig: Rig, bench: Bench, volts: float, owner: str = "a test") -> None:
    """Arm, and hold a voltage by hand until the motor has it.

    Each look renews the lease. If the lease has run out on a busy machine, the rig is armed again.
    """

    def has_it() -> bool:
        try:
            rig.set(volts)
        except RefusedError:
            rig.reset()
            rig.arm(owner)
        return bench.volts() > volts - 0.1

    rig.arm(owner)
    wait_for(has_it)


def samples(rig: Rig) -> Iterator[Any]:
    """Give the live samples; samples missed before are discarded."""
    return (one for one in rig.stream() if not isinstance(one, armrig.LiveGap))


def bring_to_rest(bench: Bench) -> None:
    """Stop a rig and reset it, once its device answers."""
    wait_for(lambda: _rests(bench), 2 * WITHIN_S)


def _rests(bench: Bench) -> bool:
    with suppress(RigError), bench.rig() as rig:
        rig.stop()
        wait_for(lambda: rig.status().phase in ("safe", "fault"))
        rig.reset()
        wait_for(lambda: rig.status().phase == "safe")
        return True
    return False


def recorded(bench: Bench) -> armrig.Recording:
    """Return the recording of the last run, once it is finished."""
    return armrig.load(last_run(bench).recording)


def last_run(bench: Bench) -> LastRun:
    """Return what the status says of the last run, once it is finished."""
    with bench.rig() as rig:
        wait_for(lambda: (last := rig.status().last_run) is not None and last.finished)
        last = rig.status().last_run
    assert last is not None
    return last


def outcome(recording: armrig.Recording) -> str:
    """Return how a run ended."""
    assert recording.outcome is not None
    return recording.outcome.outcome


def check_volts(bench: Bench, *more: float) -> None:
    """S1 and S5, as the witness saw them: nothing but the run's voltages, and 0 V at the end."""
    allowed = [0.0, *VOLTS, *more]
    volts = np.array([volts for _, volts in bench.voltage_changes()])
    assert np.abs(volts[:, None] - allowed).min(axis=1).max() <= _STEP_V
    assert volts[-1] == 0.0


def check_every_k(recording: armrig.Recording) -> None:
    """L2: each k between the first and the last sample is there, or in a gap."""
    k = recording.samples["k"].astype(np.int64)
    missing = sum(gap.count for gap in recording.gaps if k[0] < gap.k_first < k[-1])
    assert k[-1] - k[0] + 1 == k.size + missing


def resident_mib(pid: int) -> float:
    """Return the memory that a process holds, in MiB."""
    fields = Path(f"/proc/{pid}/status").read_text().split("VmRSS:")[1].split()
    return int(fields[0]) / 1024
