"""A run whose client goes: stopped on request of the run, on real processes."""

from __future__ import annotations

import signal
import time

import pytest

from tests.integration.driving import begin, outcome, recorded
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


@pytest.mark.parametrize(
    ("number", "pacing"), [(signal.SIGKILL, "scheduled"), (signal.SIGSTOP, "exchange")]
)
def test_a_run_ends_soon_after_its_client(
    bench: Bench, number: signal.Signals, pacing: str
) -> None:
    """Killed, or frozen: 0 V one period after its last sign, without a holder or a fault."""
    bench.emulate()
    bench.serve()
    client = begin(bench, 50, RUNNER, "1000", pacing, str(DEAD_MAN_S))

    client.send_signal(number)
    took_s = bench.went_to_0_v_after(time.monotonic_ns())
    client.kill()
    client.wait()

    assert 0.2 < took_s < DEAD_MAN_S + LATE_S
    assert outcome(recorded(bench)) == "its client went away: no sign of it for 0.6 s"
    wait_for(lambda: bench.phase() == "safe")
