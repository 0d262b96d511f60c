"""Ten controllers of one's own on real processes: limits, deadlines, and rest at each way out."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.recordings.files.control_run import OwnControlRun, own_control_run
from armrig.recordings.files.replay import replay
from armrig.recordings.files.verification import verify
from armrig.rig.control_loop import ControlLoop, LoopSample
from armrig.rig.replies import RunEndedError
from armrig_core.errors import InputError
from armrig_core.recording_file.manifest import REFERENCE

from tests.daemon.emulator.test_faulty_rig import CENTRED
from tests.integration.driving import begin, bring_to_rest, check_every_k, last_run, outcome
from tests.integration.processes import Bench, freeze, settled, wait_for

LATE_S = 0.5
"""Allowance for a busy machine, in s; docs/safety.md has the measured times."""
TS = 0.1
"""Sampling time, in s: a program has 0.5 s for its next voltage, also on a busy machine."""
RUNNER = """
import sys, time
from armrig.rig.client import Rig
from armrig.rig.replies import RunEndedError

def control(rig):
    for n, y in enumerate(rig.control_loop(Ts=0.02, seconds=20)):
        if n > 40 and sys.argv[2] == "hang":
            time.sleep(60)
        if n > 40 and sys.argv[2] == "crash":
            raise SystemError("crash")
        y.set({name}=1.0 + n % 2)

with Rig(connect=sys.argv[1]) as rig:
    for _ in range(8):  # a busy machine may end a run, because the next voltage came too late
        try:
            control(rig)
        except RunEndedError:
            pass
"""


def loop_of(bench: Bench, seconds: float = 2.0, **more: Any) -> tuple[armrig.Rig, ControlLoop]:
    rig = bench.rig()
    rig.__enter__()
    settled(rig)
    return rig, rig.control_loop(Ts=TS, seconds=seconds, **more)


def drive(loop: ControlLoop, step: Callable[[LoopSample], None]) -> None:
    for y in loop:
        step(y)


def check_run(
    bench: Bench, loop: ControlLoop, low: float = 0.0, high: float = 5.0
) -> OwnControlRun:
    """Check what holds for each controller, and return the run.

    The rig is at rest without a fault. All voltages are within the limits. Each deadline was met or
    missed, as object and recording say alike, and the replay makes the same decisions.
    """
    wait_for(lambda: bench.volts() == 0.0)
    assert bench.settled() == "safe"
    assert loop.recording is not None
    recording = armrig.load(loop.recording)
    run = own_control_run(recording)
    assert run is not None
    assert ((run.u == 0) | ((run.u >= low) & (run.u <= high + 1e-4))).all()
    assert run.facts() == {"deadlines": loop.deadlines, "missed": loop.missed}
    assert (np.diff(run.missed) <= 1).all()
    # Without a new voltage the voltage before is held.
    held = np.diff(run.missed) == 1
    assert (np.diff(run.u)[held] == 0).all()
    check_every_k(recording)
    assert replay(recording.path).difference == ""
    result = verify(recording.path)
    assert [check.text for check in result.checks if check.level == "unusable"] == []
    return run


def test_a_controller_in_time_sets_each_sample(served: Bench) -> None:
    rig, loop = loop_of(served, reference=np.linspace(1, 3, 20))
    given = {0: 0.0}
    with rig:
        for y in loop:
            u = 1 + 0.05 * y.k
            y.set(u)
            given[y.k + 1] = u

    run = check_run(served, loop)
    assert loop.deadlines == 19
    assert run.k.size == 20
    np.testing.assert_allclose(run.r, np.linspace(1, 3, 20), rtol=0, atol=0)
    assert {round(u, 3) for u in run.u} <= {round(u, 3) for u in given.values()}
    assert len({*run.u}) >= 20 - loop.missed
    assert REFERENCE in armrig.load(loop.recording).manifest.attachment_hashes


def test_a_slow_controller_misses_deadlines_and_its_voltages_are_held(
    served: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, loop = loop_of(served)
    sets = 0
    with rig:
        for y in loop:
            time.sleep(1.5 * TS)
            y.set(2.0)
            sets += 1

    check_run(served, loop)
    assert loop.missed > 0
    assert loop.deadlines - loop.missed <= sets
    assert f"{loop.missed} of 19 deadlines were missed" in capsys.readouterr().err


@pytest.mark.timed
@pytest.mark.parametrize("how", ["hang", "freeze", "kill", "crash"])
def test_a_controller_that_stops_working_leaves_the_rig_at_rest(bench: Bench, how: str) -> None:
    """S2: within lease, watchdog and 2 Ts of the last voltage, without a fault."""
    bench.emulate()
    bench.serve()
    client = begin(bench, 20, RUNNER.replace("{name}", "u"), how)
    if how in ("freeze", "kill"):
        client.send_signal(signal.SIGSTOP if how == "freeze" else signal.SIGKILL)
    wait_for(lambda: bench.volts() == 0.0)
    (set_ns, _), (rest_ns, _) = bench.voltage_changes()[-2:]
    client.kill()
    client.wait()

    assert (rest_ns - set_ns) / 1e9 < 0.1 + 0.25 + 2 * 0.02 + LATE_S
    last = last_run(bench)
    assert last.code == ("stopped" if how == "crash" else "client_gone")
    assert bench.settled() == "safe"
    run = own_control_run(armrig.load(last.recording))
    assert run is not None
    assert {*np.round(run.u, 1)} <= {0.0, 1.0, 2.0}


@pytest.mark.parametrize("u", [5.5, -0.1, float("nan"), float("inf")])
def test_a_voltage_that_is_not_allowed_is_refused_and_ends_the_run_at_rest(
    served: Bench, u: float
) -> None:
    rig, loop = loop_of(served)
    with rig:
        with pytest.raises(InputError, match="outside 0 … 5 V"):
            drive(loop, lambda y: y.set(2.0 if y.k < 5 else u))
        wait_for(lambda: served.volts() == 0.0)

        run = check_run(served, loop)

    assert {*np.round(run.u, 1)} <= {0.0, 2.0}
    assert "stopped by" in outcome(armrig.load(loop.recording))


def test_a_controller_that_hides_the_refusal_does_not_go_on(served: Bench) -> None:
    def hide(y: LoopSample) -> None:
        with suppress(InputError):
            y.set(2.0 if y.k < 5 else 7.0)

    rig, loop = loop_of(served)
    with rig, pytest.raises(RunEndedError, match="stopped by"):
        drive(loop, hide)

    assert {*np.round(check_run(served, loop).u, 1)} <= {0.0, 2.0}


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (
            {"Ts": 0.01, "seconds": 1},
            "with Ts from 0.02 to 1 s; for a shorter Ts, use a control law",
        ),
        ({"Ts": 2.0, "seconds": 10}, "with Ts from 0.02 to 1 s"),
        ({"Ts": 0.02, "seconds": 0.02}, "1 samples, which must be at least 2"),
        ({"Ts": 0.02, "seconds": 1, "reference": [1.0, 2.0]}, "reference has shape (2,)"),
        ({"Ts": 0.02, "seconds": 1, "reference": float("nan")}, "a finite number"),
    ],
)
def test_a_controller_faster_than_allowed_or_without_a_whole_reference_is_refused(
    served: Bench, arguments: dict[str, Any], part: str
) -> None:
    with served.rig() as rig:
        with pytest.raises(InputError) as err:
            rig.control_loop(**arguments)

        assert part in str(err.value)
        assert settled(rig) == "safe"


def test_a_controller_that_sets_nothing_leaves_the_rig_at_rest(served: Bench) -> None:
    rig, loop = loop_of(served)
    with rig:
        for _ in loop:
            pass

    run = check_run(served, loop)
    assert loop.missed == loop.deadlines == 19
    assert not run.u.any()


def test_of_two_voltages_in_a_sample_only_the_second_is_latched_if_both_are_in_time(
    served: Bench,
) -> None:
    rig, loop = loop_of(served)
    with rig:
        for y in loop:
            y.set(4.0)
            y.set(1.0)

    u = check_run(served, loop).u
    assert {*np.round(u, 1)} <= {0.0, 1.0, 4.0}
    assert np.count_nonzero(np.round(u, 1) == 4.0) <= u.size // 4


def test_a_controller_that_breaks_out_early_ends_its_run_at_rest(served: Bench) -> None:
    rig, loop = loop_of(served, seconds=30)
    with rig:
        for y in loop:
            y.set(3.0)
            if y.k >= 10:
                break
        wait_for(lambda: served.volts() == 0.0)
        again = rig.control_loop(Ts=TS, seconds=0.5)
        for y in again:
            y.set(1.0)

    run = check_run(served, again)
    assert run.k.size == 5
    assert "stopped by" in outcome(armrig.load(loop.recording))


def test_a_stop_by_another_client_ends_the_loop_with_its_outcome(served: Bench) -> None:
    rig, loop = loop_of(served, seconds=30)
    with rig, served.rig() as teacher:

        def go_on(y: LoopSample) -> None:
            y.set(3.0)
            if y.k >= 10:
                teacher.stop(by="a teacher")

        with pytest.raises(RunEndedError, match="stopped by a teacher"):
            drive(loop, go_on)

    check_run(served, loop)


def test_a_second_client_cannot_take_the_rig_from_a_loop(served: Bench) -> None:
    rig, loop = loop_of(served)
    with rig, served.rig() as other:
        for y in loop:
            y.set(1.0)
            if y.k == 5:
                with pytest.raises(armrig.RigError, match="has the rig"):
                    next(iter(other.control_loop(Ts=0.02, seconds=1)))

    check_run(served, loop)


@pytest.mark.timed
def test_a_rig_whose_rest_is_not_0_v_is_controlled_in_its_own_unit(bench: Bench) -> None:
    """Rest is 2.5 V at the pin; after a crash its driver is off."""
    file = bench.folder / "centred.toml"
    file.write_bytes(CENTRED.text)
    bench.configure(more=f'[rig]\nfile = "{file}"')
    bench.emulate()
    bench.serve()
    with bench.rig() as rig:
        loop = rig.control_loop(Ts=TS, seconds=2, reference=20.0)
        for y in loop:
            speed = y.sample[4]
            y.set(armature=float(np.clip(0.3 * (y.r - speed), -12, 12)))
        assert loop.missed < loop.deadlines

        run = check_run(bench, loop)
        assert run.u[0] == pytest.approx(2.5, abs=1e-3)
        assert run.u.max() > 2.6

        crashing = rig.control_loop(Ts=0.02, seconds=10)
        with pytest.raises(ZeroDivisionError):
            drive(crashing, lambda y: y.set(armature=5.0 / max(10 - y.k, 0)))
        wait_for(lambda: bench.volts() == 0.0)

    client = begin(bench, 10, RUNNER.replace("{name}", "armature"), "hang")
    freeze(client.pid)
    assert bench.went_to_0_v_after(time.monotonic_ns()) < 0.1 + 0.25 + 2 * 0.02 + LATE_S
    client.kill()
    client.wait()
    assert bench.settled() == "safe"
    bring_to_rest(bench)
