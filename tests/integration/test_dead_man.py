"""A run whose client goes: stopped on request of the run, on real processes."""

from __future__ import annotations

import signal
import time

import armrig
import pytest

from tests.integration.driving import begin
from tests.integration.processes import Bench, wait_for

pytestmark = pytest.mark.timed
DEAD_MAN_S = 0.6
LATE_S = 0.5
"""Allowance for a busy machine, in s; docs/safety.md has the measured times."""
RUNNER = """
import sys
from armrig.rig.client import Rig
with Rig(connect=sys.argv[1]) as rig:
    rig.arm("a test", Ts=0.01)
    rig.run([1.0, 4.0] * int(sys.argv[2]), pacing=sys.argv[3], dead_man=float(sys.argv[4]))
"""


class Client:
    """A client of its own process, with a run in progress."""

    def __init__(self, bench: Bench, program: str, periods: int, pacing: str) -> None:
        self.popen = begin(bench, 50, program, str(periods), pacing, str(DEAD_MAN_S))

    def end(self) -> None:
        """Kill it in any state."""
        self.popen.kill()
        self.popen.wait()


def _client(
    bench: Bench, program: str = RUNNER, periods: int = 1000, pacing: str = "scheduled"
) -> Client:
    bench.emulate()
    bench.serve()
    return Client(bench, program, periods, pacing)


def _ended(bench: Bench) -> armrig.Recording:
    """Return the finished recording of the run, without a holder or a fault."""
    with bench.rig() as rig:
        wait_for(lambda: (last := rig.status().last_run) is not None and last.finished)
        wait_for(lambda: rig.status().phase == "safe")
        last = rig.status().last_run
        assert last is not None
        return armrig.load(last.recording)


@pytest.mark.parametrize(
    ("number", "pacing"), [(signal.SIGKILL, "scheduled"), (signal.SIGSTOP, "exchange")]
)
def test_a_run_ends_soon_after_its_client(
    bench: Bench, number: signal.Signals, pacing: str
) -> None:
    """Killed, or frozen: 0 V one period after its last sign."""
    client = _client(bench, pacing=pacing)

    client.popen.send_signal(number)
    gone_ns = time.monotonic_ns()

    took_s = bench.went_to_0_v_after(gone_ns)
    assert 0.2 < took_s < DEAD_MAN_S + LATE_S
    client.end()
    outcome = _ended(bench).outcome
    assert outcome is not None
    assert outcome.outcome == "its client went away: no sign of it for 0.6 s"
