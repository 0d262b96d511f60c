"""A run in control on real processes: its stops, and its recording."""

from __future__ import annotations

import signal
import time

import armrig
import numpy as np
import pytest
from armrig.recordings.files.control_run import control_run
from armrig.recordings.files.replay import replay
from armrig.recordings.files.verification import verify
from armrig.rig.replies import RefusedError
from armrig_core.control.control_law import ControlLaw, LawOutput, Reference

from tests.integration.driving import STOPPED_S, begin, outcome, recorded
from tests.integration.processes import Bench, settled, wait_for

LATE_S = 0.5
"""Allowance for a busy machine, in s; docs/safety.md has the measured times."""
RUNNER = """
import sys
from armrig.rig.client import Rig
from armrig_core.control.control_law import ControlLaw, LawOutput, Reference
law = ControlLaw(
    Ts_us=10_000, outputs=(LawOutput(name="alpha", unit="rad"),),
    reference=Reference(name="u", unit="V", low=0, high=5),
    A=(), B=(), C=(), D=1.0, x0=(), F=((),),
)
with Rig(connect=sys.argv[1]) as rig:
    rig.arm("a test", Ts=0.01)
    rig.control(law, [1.0, 4.0] * int(sys.argv[2]), dead_man=float(sys.argv[3]), unmonitored=True)
"""


@pytest.mark.timed
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_control_run_ends_soon_after_its_client(bench: Bench, number: signal.Signals) -> None:
    """Killed, or frozen: 0 V one period after its last sign, without a fault."""
    bench.emulate()
    bench.serve()
    client = begin(bench, 50, RUNNER, "1000", "0.6")

    client.send_signal(number)
    took_s = bench.went_to_0_v_after(time.monotonic_ns())
    client.kill()
    client.wait()

    assert 0.2 < took_s < 0.6 + LATE_S
    assert outcome(recorded(bench)) == "its client went away: no sign of it for 0.6 s"
    wait_for(lambda: bench.phase() == "safe")


def test_a_stop_ends_a_control_run_whose_recording_is_replayed(bench: Bench) -> None:
    bench.emulate()
    bench.serve()
    client = begin(bench, 50, RUNNER, "2000", "60")

    with bench.rig() as rig:
        told_ns = time.monotonic_ns()
        rig.stop(by="a teacher")
        assert bench.went_to_0_v_after(told_ns) < STOPPED_S
    client.wait()

    recording = recorded(bench)
    assert outcome(recording) == "stopped by a teacher"
    run = control_run(recording)
    assert run is not None
    assert run.k.size >= 50
    assert verify(recording.path).passed
    assert replay(recording.path).difference == ""


def test_references_set_during_a_run_are_recorded_with_their_numbers_and_replayed(
    bench: Bench,
) -> None:
    """The first is set when the run is accepted, which is before its first sample."""
    law = ControlLaw(
        Ts_us=100_000, outputs=(LawOutput(name="alpha", unit="rad"),),
        reference=Reference(name="u", unit="V", low=0, high=5),
        A=(), B=(), C=(), D=1.0, x0=(), F=((),),
    )  # fmt: skip
    begun, later = [2.5], [3.5]
    bench.emulate()
    bench.serve()

    def progress(done: int, total: int) -> None:
        if begun:
            with pytest.raises(RefusedError, match=r"r = 4.5 was not rehearsed: .* allows 1 to 4"):
                rig.set_reference(4.5)
            rig.set_reference(begun.pop())
        elif later and 10 < done < total:
            rig.set_reference(later.pop())

    with bench.rig() as rig:
        settled(rig)
        rig.arm("a test", Ts=0.1)
        path = rig.control(law, [1.0] + [4.0] * 39, progress=progress, unmonitored=True)

    recording = armrig.load(path)
    run = control_run(recording)
    assert run is not None
    first, second = (int(n) for n in np.unique(run.reference_n[run.reference_n > 0]))
    assert 0 < first < second
    assert set(run.r[run.reference_n == first]) == {2.5}
    assert set(run.r[run.reference_n == second]) == {3.5}
    assert ", set by 2 commands" in run.summary
    np.testing.assert_allclose(run.u, run.r, atol=1e-4)
    assert recording.r is not None
    np.testing.assert_array_equal(recording.r[run.k - recording.manifest.k_first], run.r)
    assert verify(path).passed
    assert replay(path).difference == ""
