"""A run whose client sets each voltage: codes, deadlines, the lease, and every way to rest."""

from __future__ import annotations

from struct import pack

import numpy as np
import pytest
from armrig_core.commands.codes import OutcomeCode, RefusalCode
from armrig_core.rig.description import Description, builtin
from armrig_core.rig.volts import code_of, volts_of
from armrig_core.telemetry.telemetry import Sample
from armrig_daemon.config import Config, Limits
from armrig_daemon.decisions import trace
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.outcomes import Trip
from armrig_daemon.decisions.own_control import decide
from armrig_daemon.decisions.state import Phase
from armrig_daemon.decisions.step import step
from armrig_daemon.pipe import Answer, Arm, Control, Run, RunEnded, RunStarted, Set, Stop
from msgspec.structs import replace

from tests.daemon.emulator.test_faulty_rig import CENTRED
from tests.daemon.virtual_bench import LEASE, MS, Bench

TS_US = 20_000
TS_NS = TS_US * 1000


class OwnBench(Bench):
    """A virtual rig in a run whose voltages these tests set."""

    def __init__(
        self, N: int = 50, config: Config | None = None, description: Description | None = None
    ) -> None:
        super().__init__(config, description=description)
        self.n = 0
        assert not self.arm(TS_US).error
        reference = pack(f"<{N}d", *range(N))
        self.order(Run(order=500, lease=LEASE, n=0, run_id="r", codes=b"", reference=reference))
        while not self.of(RunStarted):
            self.run_for(1)
        self.began_ns = self.of(RunStarted)[0].t_host_ns

    def set(self, volts: float, k: int, ms: float = 5, order: int = 0) -> int:
        """Set a voltage some time after sample k; return the time."""
        self.n += 1
        at_ns = self.began_ns + k * TS_NS + round(ms * MS)
        self.order(Set(order=order, lease=LEASE, n=self.n, code=code_of(volts)), at_ns)
        return at_ns

    def run_to(self, k: int, ms: float = 1) -> None:
        """Run until some time after sample k."""
        self.run_until(self.began_ns + k * TS_NS + round(ms * MS))

    @property
    def own_samples(self) -> list[Sample]:
        first = self.of(RunStarted)[0].k_first
        count = len(self.of(Control))
        return [s for s in self.samples if first <= s.k < first + count]

    @property
    def ended(self) -> RunEnded:
        return self.of(RunEnded)[0]


def codes_of(samples: list[Sample]) -> list[int]:
    return [code_of(sample.u_cmd_v) for sample in samples]


def test_each_voltage_is_latched_with_the_sample_after_it() -> None:
    rig = OwnBench(N=20)
    wanted = [1.0 + 0.1 * i for i in range(19)]

    for k, u in enumerate(wanted):
        rig.set(u, k)
    rig.run_to(30)

    assert rig.ended.outcome_code == OutcomeCode.COMPLETE
    assert codes_of(rig.own_samples) == [0, *map(code_of, wanted)]
    assert rig.phase is Phase.SAFE
    assert rig.volts == 0.0


def test_the_decisions_contain_reference_and_voltage_of_each_sample() -> None:
    rig = OwnBench(N=5)

    for k in range(4):
        rig.set(2.0, k)
    rig.run_to(10)

    decisions = rig.of(Control)
    assert [d.r for d in decisions] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert [d.u_v for d in decisions] == [0.0, *[volts_of(code_of(2.0))] * 4]
    assert not any(d.predicted for d in decisions)


def test_a_sample_without_a_new_voltage_is_a_missed_deadline() -> None:
    """Voltages after samples 0, 3 and 4: the samples 2 and 3 got none."""
    rig = OwnBench(N=6)

    for k, u in ((0, 1.0), (3, 2.0), (4, 3.0)):
        rig.set(u, k)
    rig.run_to(10)

    assert [d.predicted for d in rig.of(Control)] == [0, 0, 1, 2, 2, 2]
    assert [round(s.u_cmd_v) for s in rig.own_samples] == [0, 1, 1, 1, 2, 3]


def test_of_two_voltages_before_a_sample_the_last_one_acts() -> None:
    rig = OwnBench(N=3)

    rig.set(4.0, 0, ms=3)
    rig.set(1.0, 0, ms=6)
    rig.run_to(2)

    assert round(rig.own_samples[1].u_cmd_v) == 1
    assert rig.of(Control)[1].predicted == 0


@pytest.mark.parametrize("description", [None, builtin("rc"), CENTRED])
def test_a_silent_client_ends_the_run_at_rest_within_the_time_of_s2(
    description: Description | None,
) -> None:
    """S2: lease and 2 Ts after the last voltage; the run ends without a fault."""
    rig = OwnBench(N=500, description=description)
    for k in range(5):
        set_ns = rig.set(3.0, k)

    rig.run_until(set_ns + 100 * MS + 2 * TS_NS)

    assert rig.volts == 0.0
    assert rig.ports.device.state.name != "RUN"
    rig.run_for(100)
    assert rig.ended.outcome_code == OutcomeCode.CLIENT_GONE
    assert rig.phase is Phase.SAFE
    rest = rig.loop.state.rules.rest_code
    late = [s for s in rig.samples if s.t_host_ns > set_ns + 100 * MS + 2 * TS_NS]
    assert {code_of(s.u_cmd_v) for s in late} == {rest}


def test_a_client_that_sets_nothing_keeps_the_rig_at_rest() -> None:
    rig = OwnBench(N=30)

    rig.run_to(40)

    assert rig.ended.outcome_code == OutcomeCode.COMPLETE
    assert rig.of(Control)[-1].predicted == 29
    assert not any(codes_of(rig.own_samples))


def test_a_client_that_sets_nothing_for_long_loses_the_rig() -> None:
    rig = OwnBench(N=5000)

    rig.run_for(10_200)

    assert rig.ended.outcome_code == OutcomeCode.CLIENT_GONE
    assert not any(codes_of(rig.own_samples))


@pytest.mark.parametrize(("low", "high", "u"), [(0.0, 4.0, 4.5), (1.0, 5.0, 0.5)])
def test_a_voltage_outside_the_limits_is_refused_and_the_voltage_before_is_held(
    low: float, high: float, u: float
) -> None:
    rig = OwnBench(config=Config(limits=Limits(u_min_v=low, u_max_v=high)))
    rig.set(2.0, 0)
    rig.set(u, 1, order=9)
    rig.run_to(3)

    (answer,) = (a for a in rig.of(Answer) if a.order == 9)
    assert "is outside" in answer.error
    assert round(rig.own_samples[-1].u_cmd_v) == 2


def test_the_slew_limit_counts_from_the_last_sample_not_from_the_last_set() -> None:
    """Two small steps within a sample would otherwise be a large one."""
    rig = OwnBench(config=Config(limits=Limits(slew_v=1.0)))
    rig.set(1.0, 0, order=8)
    rig.set(2.0, 0, order=9)
    rig.run_to(3)

    errors = {a.order: a.error for a in rig.of(Answer)}
    assert not errors[8]
    assert "steps by 2 V" in errors[9]
    assert max(codes_of(rig.own_samples)) <= code_of(1.0)
    assert rig.phase is Phase.ACTIVE


def test_a_code_outside_the_limits_would_be_found_before_it_is_sent() -> None:
    """The order is refused earlier; this check of S1 does not rely on it."""
    rig = OwnBench(config=Config(limits=Limits(u_max_v=4.0)))
    rig.set(2.0, 0)
    rig.run_to(1)
    state = replace(rig.loop.state, code=code_of(4.5))
    assert state.run is not None
    assert state.run.own
    assert state.lease is not None

    _, code, follow = decide(state, rig.ports.now, state.lease.n, state.run, state.run.own, 2)

    assert code == state.rules.rest_code
    assert follow == [Trip(Fault(Id.LIMITS, "u[2] is not within the limits"))]


def test_a_slow_run_of_a_silent_client_ends_without_a_fault() -> None:
    """Between the ticks, KEEPALIVE feeds the device's watchdog of 100 ms."""
    Ts_us = 500_000
    rig = Bench(description=builtin("rc"))
    rig.arm(Ts_us)
    order = Run(order=1, lease=LEASE, n=0, run_id="r", codes=b"", reference=bytes(80))
    rig.order(order)
    rig.run_for(600)
    rig.drive(3.0, n=1)
    set_ns = rig.ports.now

    rig.run_until(set_ns + 7 * Ts_us * 1000 + 100 * MS)

    assert rig.volts == 0.0
    assert rig.of(RunEnded)[0].outcome_code == OutcomeCode.CLIENT_GONE
    assert rig.phase is Phase.SAFE


def test_another_client_cannot_set_a_voltage_of_the_run() -> None:
    """S5: only the holder of the lease."""
    rig = OwnBench()
    rig.order(Set(order=9, lease="b" * 32, n=99, code=code_of(5.0)))
    rig.order(Arm(order=10, owner="another", lease="b" * 32, ts_us=0))

    rig.run_for(40)

    codes = {a.order: a.code for a in rig.of(Answer)}
    assert (codes[9], codes[10]) == (RefusalCode.NOT_HELD, RefusalCode.HELD)
    assert not any(codes_of(rig.own_samples))


def test_a_stop_ends_the_run_and_a_later_voltage_is_refused() -> None:
    rig = OwnBench()
    for k in range(3):
        rig.set(3.0, k)
    rig.run_to(3)

    rig.order(Stop(order=7))
    rig.set(3.0, 6, order=9)
    rig.run_to(10)

    assert rig.ended.outcome_code == OutcomeCode.STOPPED
    assert next(a for a in rig.of(Answer) if a.order == 9).code == RefusalCode.NOT_HELD
    assert rig.volts == 0.0


def test_a_run_of_voltages_known_before_still_takes_no_set() -> None:
    rig = Bench()
    rig.play([1.0] * 200, scheduled=False)
    rig.run_for(300)

    answer = rig.drive(3.0, n=9)

    assert answer.code == RefusalCode.RUNNING


@pytest.mark.parametrize(
    ("fields", "part"),
    [({"scheduled": True}, "exchange mode"), ({"reference": b"123"}, "8 for each sample")],
)
def test_a_run_without_a_law_or_a_whole_reference_is_refused(
    fields: dict[str, object], part: str
) -> None:
    rig = Bench()
    rig.arm(TS_US)
    order = {"lease": LEASE, "n": 0, "run_id": "r", "codes": b"", "reference": bytes(80)}

    answer = rig.ask(Run, **(order | fields))

    assert part in answer.error


@pytest.mark.parametrize("seed", range(20))
def test_every_code_is_that_of_a_set_of_the_holder_no_older_than_its_lease(seed: int) -> None:
    """S5 and S2, for programs that set at any time, twice, late or not at all."""
    rng = np.random.default_rng(seed)
    rig = OwnBench(N=60, description=CENTRED if seed % 2 else None)
    rest, at_ms = rig.loop.state.rules.rest_code, 5.5  # never at a tick
    given = [(rig.began_ns, rest)]
    while at_ms < 1200:
        for u in rng.uniform(0, 5, rng.integers(0, 3)):
            given.append((rig.set(u, 0, ms=at_ms), code_of(u)))
        at_ms += float(rng.choice([3, 19, 23, 47, 95]))
    rig.run_to(80)

    assert rig.of(RunEnded)
    before, missed = rig.own_samples[0], 0
    for sample, decision in zip(rig.own_samples[1:], rig.of(Control)[1:], strict=True):
        newest_ns = max(t for t, _ in given if t <= sample.t_host_ns)
        code = code_of(sample.u_cmd_v)
        assert code in {c for t, c in given if t == newest_ns} | {rest}
        assert code == rest or sample.t_host_ns - newest_ns <= 100 * MS
        missed += newest_ns <= before.t_host_ns
        assert decision.predicted == missed
        before = sample
    assert rig.volts == 0.0


def test_a_run_is_restored_from_its_trace_without_the_lease() -> None:
    rig = OwnBench(N=10)
    state = rig.loop.state
    assert state.run is not None
    assert state.run.own

    again = trace.decode_state(trace.encode_state(state), state.run.own.reference)

    assert again.run == state.run
    assert LEASE.encode() not in trace.encode_state(state)
    assert step(again, rig.ports.now, [])[1] == []
