"""L2: each k is one sample or one gap, in any order of events; found by the fault simulator."""

from __future__ import annotations

from itertools import pairwise

import pytest
from armrig_core.commands.codes import GapCode
from armrig_core.telemetry.telemetry import Sample, decode_sample
from armrig_daemon.config import Config, TimingTable
from armrig_daemon.decisions import step
from armrig_daemon.decisions.state import (
    DecisionState,
    LinkDown,
    LinkUp,
    Phase,
    Publish,
    Received,
    Send,
    Tick,
)
from armrig_daemon.pipe import Gap, Reset, RunEnded
from armrig_protocol.decoder import feed
from armrig_protocol.frame import encode
from armrig_protocol.messages import Exchange, Flag
from armrig_protocol.messages import Sample as DeviceSample
from armrig_protocol.messages import State as DeviceState

from tests.daemon.decision_states import changed, device_sample
from tests.daemon.virtual_bench import MS, Bench

RUN = [2.0] * 400


def playing(for_ms: float) -> Bench:
    """Return a rig that has played a scheduled run for some time."""
    bench = Bench()
    bench.play(RUN, 5_000)
    bench.run_for(for_ms)
    return bench


def assert_each_k_is_told_once(bench: Bench) -> None:
    """No k twice and none left out, from the first to the last."""
    told = []
    for record in bench.records:
        sample = decode_sample(record) if isinstance(record, bytes) else None
        if isinstance(sample, Sample):
            told.append((sample.k, sample.k + 1))
        elif isinstance(record, Gap):
            told.append((record.k_first, record.k_first + record.count))
    assert all(end == first for (_, end), (first, _) in pairwise(told))


def test_a_reset_in_a_scheduled_run_ends_it() -> None:
    bench = playing(600)
    assert bench.volts > 0

    bench.ports.device.reset(bench.ports.now)
    bench.run_for(600)
    bench.ask(Reset)
    bench.run_for(300)

    assert bench.phase is Phase.SAFE
    assert [r.outcome for r in bench.of(RunEnded)] == ["the device was reset"]
    assert_each_k_is_told_once(bench)


def test_an_unplugged_line_while_the_stop_is_awaited_ends_the_run() -> None:
    bench = playing(600)
    bench.ports.from_device = lambda data: b""
    bench.run_for(110)
    assert bench.phase is Phase.FAULT
    assert bench.of(RunEnded) == []

    bench.ports.send(bench.ports.now, LinkDown("unplugged"))
    bench.run_for(20)
    assert len(bench.of(RunEnded)) == 1

    bench.ports.from_device = lambda data: data
    bench.ports.send(bench.ports.now, LinkUp())
    bench.run_for(300)
    bench.ask(Reset)
    bench.run_for(300)
    assert_each_k_is_told_once(bench)


@pytest.mark.parametrize(("scheduled", "period"), [(False, 5 * MS), (True, 20 * MS)])
def test_a_gap_without_an_answer_begins_when_its_first_sample_was_due(
    scheduled: bool, period: int
) -> None:
    """L2: a line is silent for 0.7 s.

    A scheduled run is over then, and the host's ticks go on.
    """
    bench = Bench(Config(timing=TimingTable(Ts=0.02)))
    bench.play(RUN, 5_000, scheduled=scheduled)
    bench.run_for(600)

    bench.ports.from_device = lambda data: b""
    bench.run_for(700)
    bench.ports.from_device = lambda data: data
    bench.run_for(300)

    (gap,) = (g for g in bench.of(Gap) if g.code == GapCode.NO_ANSWER)
    due_ns = {s.k: s.t_sched_ns for s in bench.samples}
    assert gap.count > 20
    assert abs(due_ns[gap.k_first + gap.count] - gap.count * period - gap.t_from_ns) < period
    first = min(g.t_from_ns for g in bench.of(Gap))
    assert 0 < first - max(t for t in due_ns.values() if t < first) < 10 * MS
    assert_each_k_is_told_once(bench)


def _take(state: DecisionState, now_ns: int, message: DeviceSample) -> list[Publish]:
    _, actions = step.step(state, now_ns, [Received(b"\0" + encode(message))])
    return [a for a in actions if isinstance(a, Publish)]


def test_a_sample_of_an_old_run_does_not_begin_a_new_one() -> None:
    bench = playing(600)
    state = bench.loop.state
    old = device_sample(state, k=state.run.due, flags=int(Flag.RUN))

    assert len(_take(state, bench.ports.now, old)) == 1
    waiting = changed(state, run=changed(state.run, k_first=-1))
    assert _take(waiting, bench.ports.now, old) == []


@pytest.mark.parametrize("ended", [False, True])
def test_a_run_that_has_stopped_but_not_ended_is_not_sampled_by_the_host(ended: bool) -> None:
    bench = playing(600)
    stopped = changed(bench.loop.state, device_state=int(DeviceState.READY), phase=Phase.FAULT)
    state = changed(stopped, run=None) if ended else stopped
    now = bench.ports.now + 10 * MS

    _, actions = step.step(state, now, [Tick(state.k + 1, now)])

    frames = [m for a in actions if isinstance(a, Send) for m in feed(b"", a.data)[1]]
    assert any(isinstance(m, Exchange) for m in frames) == ended
