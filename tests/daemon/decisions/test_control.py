"""A control law in the core: what its code depends on, and how its run ends (S5)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import nan
from struct import pack
from typing import Any

import pytest
from armrig_core.commands.codes import OutcomeCode
from armrig_core.control.evaluation import Latch, Program, begin
from armrig_core.control.monitor import MonitorProgram
from armrig_core.rig.volts import code_of, device_code, volts_of
from armrig_core.telemetry.telemetry import Sample
from armrig_daemon import pipe
from armrig_daemon.config import Config, Limits
from armrig_daemon.decisions import control, trace
from armrig_daemon.decisions import step as core_step
from armrig_daemon.decisions.faults import Id
from armrig_daemon.decisions.outcomes import Halt
from armrig_daemon.decisions.state import DecisionState, Phase, RequestKind, RunLaw, Send, Tick
from armrig_daemon.pipe import Answer, Reset, RunEnded, Stop, Trace
from armrig_protocol import messages as wire
from armrig_protocol.decoder import feed
from msgspec.structs import replace

from tests.daemon.decision_states import LAW, Decided, awaiting, changed, control_run
from tests.daemon.virtual_bench import LEASE, MS, Bench

TS_MS = LAW.Ts_us / 1000
RAIL, MIDDLE = 65_472, 32_768
LONG = [1.0] * 400


def _begun(
    law: Program = LAW, r: Iterable[float] = LONG, alpha: int = MIDDLE, slew_v: float = 0.0
) -> Bench:
    """Return a bench whose law has begun; α reads `alpha` counts."""
    bench = Bench(Config(limits=Limits(slew_v=slew_v)))
    _read(bench, alpha)
    bench.run_for(50)
    assert not bench.arm().error
    bench.order(control_run(law, r))
    bench.run_for(TS_MS)
    assert not bench.of(Answer)[-1].error
    return bench


def _read(bench: Bench, alpha: int) -> None:
    board: Any = bench.ports.device.board
    board.reading = lambda channel, _: alpha if channel else MIDDLE


def _reference(bench: Bench, r: float) -> pipe.SetReference:
    lease = bench.loop.state.lease
    assert lease is not None
    return pipe.SetReference(order=9, lease=lease.lease, n=lease.n + 1, r=r)


def _without(*kinds: type, first: int = 1 << 30) -> Callable[[bytes], bytes]:
    """Return a line that loses the first frames of these kinds."""
    lost = 0

    def carry(data: bytes) -> bytes:
        nonlocal lost
        if lost < first and any(isinstance(m, kinds) for m in feed(b"", data)[1]):
            lost += 1
            return b""
        return data

    return carry


def _outcome(bench: Bench) -> OutcomeCode:
    (ended,) = bench.of(RunEnded)
    assert bench.volts == 0.0
    return OutcomeCode(ended.outcome_code)


# -- a run ---------------------------------------------------------------------------------------


def test_each_code_is_computed_from_the_sample_before_it_or_its_prediction() -> None:
    bench = _begun(r=[0.5] * 20 + [2.0] * 20, alpha=MIDDLE + 3000)
    bench.ports.from_device = _without(wire.Sample, first=1)
    bench.run_for(50 * TS_MS)

    records, samples = bench.of(pipe.Control), {s.k: s for s in bench.samples}
    assert [c.r for c in records] == [0.5] * 20 + [2.0] * 20
    assert [c.k for c in records] == [*range(records[0].k, records[0].k + 40)]
    x = 0.0
    for c in records:
        code = round(c.v * 13_107)
        assert c.v == 0.0 + x + 0.3 * c.r + 1.5
        assert c.u_v == volts_of(code)
        y = samples[c.k].value_1 if c.k in samples else 0.1 * x
        applied = volts_of(device_code(code, 10))
        x = 0.0 + 0.5 * x + 0.2 * c.r + 0.1 * (applied - 1.5) + -0.4 * y
        assert c.k not in samples or samples[c.k].u_cmd_v == c.u_v
    assert sum(c.k not in samples for c in records) == sum(c.predicted for c in records) == 1
    assert not any(c.is_low or c.is_high or c.is_slewed for c in records)
    assert _outcome(bench) is OutcomeCode.COMPLETE


def test_each_code_follows_the_newest_one_within_the_slew_of_the_rig() -> None:
    """The law remembers the codes of its dead time, from which the slew does not count."""
    law = replace(LAW, v_row=(0.0, 1.0), u0=0.0, input_delay=3)
    bench = _begun(law, r=[4.0] * 9, slew_v=1.0)
    bench.run_for(20 * TS_MS)

    sent = [min(13_108 * i, 52_428) for i in range(1, 10)]
    assert [c.u_v for c in bench.of(pipe.Control)] == [volts_of(code) for code in sent]
    assert _outcome(bench) is OutcomeCode.COMPLETE


def test_a_sample_after_a_lost_stop_does_not_advance_the_law() -> None:
    """The device still answers each EXCHANGE, whose code is rest and not of the law."""
    bench = _begun()
    bench.ports.to_device = _without(wire.Stop, first=3)
    bench.order(Stop(order=9))
    bench.run_for(TS_MS)
    before = bench.loop.state.run.control.state
    n = len(bench.samples)
    bench.run_for(3 * TS_MS)

    assert len(bench.samples) > n
    assert bench.loop.state.run.control.state.k <= before.k + 1
    bench.run_for(200)
    assert _outcome(bench) is OutcomeCode.STOPPED


def test_another_reference_holds_from_the_next_sample_to_the_end() -> None:
    bench = _begun(r=[0.5] * 20 + [2.0] * 20)
    bench.run_for(9 * TS_MS)
    bench.order(_reference(bench, 1.5))
    bench.run_for(TS_MS)
    assert not bench.of(Answer)[-1].error
    bench.run_for(50 * TS_MS)

    records = bench.of(pipe.Control)
    changed = [c.r for c in records].index(1.5)
    assert 9 <= changed <= 11
    assert [c.r for c in records] == [0.5] * changed + [1.5] * (40 - changed)
    assert [c.reference_n for c in records] == [0] * changed + [51] * (40 - changed)
    assert _outcome(bench) is OutcomeCode.COMPLETE


@pytest.mark.parametrize("r", [0.4, 2.1, nan])
def test_a_reference_that_was_not_rehearsed_is_refused(r: float) -> None:
    bench = _begun(r=[0.5] * 20 + [2.0] * 20)
    bench.order(_reference(bench, r))
    bench.run_for(50 * TS_MS)

    assert "was not rehearsed: this run allows 0.5 to 2" in bench.of(Answer)[-1].error
    assert [c.r for c in bench.of(pipe.Control)] == [0.5] * 20 + [2.0] * 20


def test_a_reference_without_a_law_is_refused() -> None:
    bench = Bench(Config())
    bench.run_for(50)
    bench.arm()
    bench.order(_reference(bench, 1.0))
    bench.run_for(TS_MS)

    assert "no law controls the rig" in bench.of(Answer)[-1].error


def test_the_reference_of_a_sample_on_its_way_does_not_change() -> None:
    """Each order has the sample at which it holds; samples before `state.k` have arrived."""
    r = [float(k) for k in range(40)]
    law = _control(LAW, r)
    for arrived, first, value in ((0, 2, 50.0), (1, 3, 60.0), (1, 3, 70.0), (3, 5, 80.0)):
        law = replace(law, state=replace(law.state, k=arrived)).with_reference(value, 7, first)
        r[first:] = [value] * (40 - first)
        assert [law.values[k] for k in range(arrived, 40)] == r[arrived:]
    law = replace(law, state=replace(law.state, k=9)).with_reference(90.0, 8, 10)

    assert law.changes == ((5, 80.0), (10, 90.0))


def _control(law: Program, r: Iterable[float]) -> RunLaw:
    order = control_run(law, r)
    return RunLaw(law, Latch(), order.reference, begin(law), order.r_range)


def test_a_reference_before_the_first_sample_is_decided_again_from_the_trace() -> None:
    """The trace begins with the run's first tick, and the attached reference has other values."""
    bench = Bench(Config())
    _read(bench, MIDDLE)
    assert not bench.arm().error
    bench.order(control_run(LAW, [0.5, *LONG[1:]]))
    early = pipe.SetReference(order=9, lease=LEASE, n=51, r=0.7)
    bench.order(early, at_ns=bench.ports.now + 5 * MS)
    bench.run_for(500 * TS_MS)

    assert not any(answer.error for answer in bench.of(Answer))
    assert [(c.r, c.reference_n) for c in bench.of(pipe.Control)] == [(0.7, 51)] * len(LONG)
    _check_trace(bench, [0.5, *LONG[1:]])


def test_a_run_in_control_is_decided_again_from_its_trace() -> None:
    reference = [0.5, *LONG[1:]]
    bench = _begun(replace(LAW, turning=(True,), channels=(0,)), r=reference)
    bench.run_for(9 * TS_MS)
    bench.order(_reference(bench, 0.7))
    bench.ports.from_device = _without(wire.Sample, first=2)
    bench.run_for(500 * TS_MS)
    assert bench.of(pipe.Control)[-1].r == 0.7

    _check_trace(bench, reference)


def _check_trace(bench: Bench, reference: list[float]) -> None:
    """Check that the trace and the attached reference give the same frames again."""
    chunks = bench.of(Trace)
    state = trace.decode_state(chunks[0].state, pack(f"<{len(reference)}d", *reference))
    for step in (s for c in chunks for s in trace.steps_of(c.steps)):
        state, actions = core_step.step(state, step.now_ns, step.events)
        assert tuple(a.data for a in actions if isinstance(a, Send)) == step.sent
    assert state.run is None


# -- the ends of a run ---------------------------------------------------------------------------

TRACKED = {"tracked": (0.0, 1.0, 0.0), "most_error": 0.5, "most_astray": 4}


@pytest.mark.parametrize(
    ("law", "alpha", "end"),
    [
        (replace(LAW, most_blind=4), RAIL, OutcomeCode.BLIND),
        (replace(LAW, **TRACKED), MIDDLE, OutcomeCode.TRACKING),
        (replace(LAW, u0=6.0, most_limited=5), MIDDLE, OutcomeCode.AT_LIMIT),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_bound_of_the_law_ends_its_run_without_a_fault(
    law: Program, alpha: int, end: OutcomeCode
) -> None:
    bench = _begun(law, alpha=alpha)
    bench.run_for(40 * TS_MS)

    assert _outcome(bench) is end
    assert bench.phase is Phase.SAFE
    assert len(bench.of(pipe.Control)) == 4  # the fifth code at a limit is not sent


def test_a_law_that_is_late_by_more_than_its_most_blind_samples_ends() -> None:
    bench = _begun(replace(LAW, most_blind=2))
    bench.lateness_ns = 25 * MS
    bench.run_for(3 * TS_MS)
    predicted = [c.predicted for c in bench.of(pipe.Control)]
    bench.lateness_ns = 35 * MS
    bench.run_for(20 * TS_MS)

    assert _outcome(bench) is OutcomeCode.BLIND
    assert [c.predicted for c in bench.of(pipe.Control)] == predicted
    assert max(predicted) == 2


@pytest.mark.parametrize(
    ("law", "cause"),
    [
        (replace(LAW, v_row=(1.0, 1e308), u0=1e308), "the law computed u[0] = inf"),
        (
            replace(LAW, rows=((1e200, 1e200, 0.0, 0.0),), v_row=(0.0, 0.0)),
            "not finite at sample 2",
        ),
    ],
)
def test_numbers_that_are_not_finite_trip(law: Program, cause: str) -> None:
    bench = _begun(law)
    bench.run_for(20 * TS_MS)

    assert bench.phase is Phase.FAULT
    assert bench.loop.state.fault.id is Id.CONTROL
    assert cause in bench.loop.state.reason
    assert _outcome(bench) is OutcomeCode.FAULT


WATCHING = MonitorProgram(
    outputs=("alpha",),
    rows=((0.0, 0.0, 0.0),),
    predictions=((1.0,),),
    x0=(0.0,),
    u0=0.0,
    deviations=(0.01,),
    settling=(True,),
    input_delay=0,
    prelude=0,
    forward=(0.25, 0.5),
    most_blind=20,
    most_turned=(None,),
)
"""Monitor of α, which is to stay where it is."""
FOLLOWING = replace(WATCHING, rows=((1.0, 0.0, 1.0),))
"""Monitor that expects the newest α."""


def _noting_codes(bench: Bench) -> list[int]:
    """Return the codes of all EXCHANGE frames that the bench sends from now on."""
    codes: list[int] = []

    def carry(data: bytes) -> bytes:
        codes.extend(m.u for m in feed(b"", data)[1] if isinstance(m, wire.Exchange))
        return data

    bench.ports.to_device = carry
    return codes


@pytest.mark.parametrize(
    ("monitor", "fault", "compared"),
    [(WATCHING, Id.INNOVATION, "prediction"), (FOLLOWING, Id.SIMULATION, "simulation")],
    ids=["innovation", "simulation"],
)
def test_a_gate_of_the_monitor_trips_and_stays_latched(
    monitor: MonitorProgram, fault: Id, compared: str
) -> None:
    """The angle α jumps; the trip is in the step of the fifth sample, and rest follows."""
    bench = _begun(replace(LAW, monitor=monitor))
    bench.run_for(10 * TS_MS)
    n, seen = len(bench.of(pipe.Control)), len(bench.samples)
    _read(bench, MIDDLE + 4_000)
    while bench.phase is Phase.ACTIVE:
        bench.run_for(TS_MS / 10)
    jumped = [s for s in bench.samples[seen:] if abs(s.value_1) > 0.01]
    codes = _noting_codes(bench)
    bench.run_for(300)

    state = bench.loop.state
    assert bench.phase is Phase.FAULT
    assert (state.fault.id, state.fault.output) == (fault, "alpha")
    assert state.fault.value == pytest.approx(jumped[-1].value_1)
    text = f"alpha differs from the {compared} of the law's monitor in 5 samples in a row"
    assert state.fault.cause == text
    assert len(jumped) == 5
    assert len(bench.of(pipe.Control)) <= n + 6
    assert {*codes} <= {0}
    assert _outcome(bench) is OutcomeCode.FAULT
    assert bench.arm().error
    assert not bench.ask(Reset).error
    bench.run_for(300)
    assert bench.phase is Phase.SAFE
    assert bench.volts == 0.0


def test_four_samples_beyond_a_gate_stop_nothing() -> None:
    bench = _begun(replace(LAW, monitor=WATCHING))
    bench.run_for(10 * TS_MS)
    seen = len(bench.samples)
    _read(bench, MIDDLE + 4_000)
    while sum(abs(s.value_1) > 0.01 for s in bench.samples[seen:]) < 4:
        bench.run_for(TS_MS / 10)
    assert bench.loop.state.run.control.state.monitor.unlike == (4,)
    _read(bench, MIDDLE)
    bench.run_for(50 * TS_MS)

    assert bench.phase is Phase.ACTIVE
    assert bench.loop.state.run.control.state.monitor.unlike == (0,)


def test_a_run_ends_if_one_of_its_outputs_is_lost() -> None:
    """The reading of α is at an end of its range, and that of θ1 is valid."""
    monitor = replace(WATCHING, most_blind=6)
    bench = _begun(replace(LAW, most_blind=100, monitor=monitor))
    bench.run_for(10 * TS_MS)
    _read(bench, RAIL)
    bench.run_for(20 * TS_MS)

    assert _outcome(bench) is OutcomeCode.BLIND
    assert bench.phase is Phase.SAFE
    assert bench.volts == 0.0


@pytest.mark.parametrize(("stuck", "name"), [(0, "theta_1"), (1, "alpha")])
def test_the_fault_names_the_output_that_differs(stuck: int, name: str) -> None:
    """The law has its outputs in the other order than the rig."""
    two = replace(
        WATCHING,
        outputs=("alpha", "theta_1"),
        rows=((0.0,) * 4,),
        predictions=((1.0,), (1.0,)),
        deviations=(0.01, 0.01),
        settling=(False, False),
        most_turned=(None, None),
    )
    rows = ((0.5, 0.2, 0.1, -0.4, 0.0),)
    channels, turning = (1, 0), (False, True)
    law = replace(LAW, rows=rows, channels=channels, turning=turning, y0=(0.0, 0.0))
    bench = _begun(replace(law, predictions=None, monitor=two))
    bench.run_for(5 * TS_MS)
    board: Any = bench.ports.device.board
    board.reading = lambda channel, _: MIDDLE + 4_000 * (channel == stuck)
    bench.run_for(20 * TS_MS)

    fault = bench.loop.state.fault
    assert (fault.id, fault.output) == (Id.INNOVATION, name)
    assert fault.cause.startswith(f"{name} differs from the prediction")
    assert _outcome(bench) is OutcomeCode.FAULT


def test_the_prelude_is_sent_before_the_codes_of_the_law() -> None:
    """Its voltages have the slew of the rig, and its codes are recorded like those of the law."""
    law = replace(LAW, monitor=replace(WATCHING, prelude=5, forward=(0.5, 1.0)))
    bench = _begun(law, r=[2.0] * 12, slew_v=1.5)
    bench.run_for(30 * TS_MS)

    records = bench.of(pipe.Control)
    sent = {s.k: s.u_cmd_v for s in bench.samples}
    x = 0.0
    for i, c in enumerate(records):
        assert c.v == (2.0 if i < 5 else x + 0.3 * 2.0 + 1.5)
        assert sent[c.k] == c.u_v
        x = 0.5 * x + 0.2 * 2.0 + 0.1 * (volts_of(device_code(code_of(c.u_v), 10)) - 1.5)
    assert [c.is_slewed for c in records[:3]] == [True, False, False]
    assert len(records) == 12
    assert _outcome(bench) is OutcomeCode.COMPLETE


def test_a_monitored_run_is_decided_again_from_its_trace() -> None:
    bench = _begun(replace(LAW, monitor=replace(FOLLOWING, prelude=20)))
    bench.ports.from_device = _without(wire.Sample, first=1)
    bench.run_for(50 * TS_MS)
    _read(bench, MIDDLE + 4_000)
    bench.run_for(200 * TS_MS)

    chunks = bench.of(Trace)
    state = trace.decode_state(chunks[0].state, pack(f"<{len(LONG)}d", *LONG))
    for step in (s for c in chunks for s in trace.steps_of(c.steps)):
        state, actions = core_step.step(state, step.now_ns, step.events)
        assert tuple(a.data for a in actions if isinstance(a, Send)) == step.sent
    assert state.fault.id is Id.SIMULATION


def test_a_code_outside_the_limits_trips_and_is_not_sent() -> None:
    """No accepted law gives this code: the core checks it, whatever has computed it (S1)."""
    bench = _begun(replace(LAW, u0=4.0))
    state = bench.loop.state
    state = changed(state, rules=replace(state.rules, code_max=code_of(3.0)))
    decided = Decided(state, bench.ports.now, Tick(state.k + 1, bench.ports.now))

    assert decided.state.fault.id is Id.LIMITS
    assert [m.u for m in decided.sent if isinstance(m, wire.Exchange)] == [0]


def _newest(bench: Bench, **fields: float) -> tuple[DecisionState, Sample]:
    """Return a state before a sample of its run, and the sample."""
    state = bench.loop.state
    return state, bench.samples[-1]._replace(k=state.run.k_first + state.run.due - 1, **fields)


def test_a_sample_advances_only_a_run_in_control_that_has_begun() -> None:
    state, sample = _newest(_begun())
    run = state.run
    unused = (
        changed(state, run=None),
        changed(state, run=replace(run, control=None)),
        changed(state, run=replace(run, k_first=-1)),
        changed(state, run=replace(run, due=run.due - 1)),
        changed(state, run=replace(run, k_first=sample.k + 1)),
    )

    assert all(control.observe(other, sample) == (other, []) for other in unused)


def test_a_law_that_is_being_stopped_does_not_end_again() -> None:
    state, sample = _newest(_begun(replace(LAW, most_blind=1)), value_1=nan)
    k = state.run.control.state.k
    stopping = awaiting(state, RequestKind.STOP)
    latched = changed(state, phase=Phase.SAFE)

    after, (halt,) = control.observe(state, sample)
    assert isinstance(halt, Halt)
    assert after.run.control.state.k == sample.k - state.run.k_first + 1 > k
    for other in (stopping, latched):
        observed, outcomes = control.observe(other, sample)
        assert (observed.run.control.state, outcomes) == (after.run.control.state, [])
