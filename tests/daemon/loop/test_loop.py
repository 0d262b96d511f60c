"""The loop between its ports and the core: what comes first."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
from armrig_core.rig.volts import code_of
from armrig_daemon.config import Config
from armrig_daemon.decisions.state import Event, Ordered, Phase, Received, RequestKind
from armrig_daemon.pipe import Answer, Run, Set, Stop, Timing

from tests.daemon.virtual_bench import LEASE, MS, Bench, codes


def _answer(bench: Bench, order: int) -> Answer:
    (answer,) = [a for a in bench.of(Answer) if a.order == order]
    return answer


def test_orders_from_before_a_pause_are_read_after_the_tick_that_trips() -> None:
    """S6: after a freeze the same wait returns orders and the missed deadline."""
    bench = Bench()
    bench.arm()
    bench.drive(1.0, n=1)
    wait = bench.ports.wait

    def frozen(until_ns: int) -> list[Event]:
        bench.ports.wait = wait
        bench.ports._advance(until_ns + 300 * MS)
        return [Ordered(Set(order=50, lease=LEASE, n=2, code=code_of(4.0)))]

    bench.ports.wait = frozen
    bench.run_for(100)

    assert _answer(bench, 50).error
    assert bench.phase is Phase.FAULT
    assert bench.volts == 0.0


def test_busy_line_does_not_delay_orders() -> None:
    bench = Bench(msgspec.convert({"timing": {"Ts": 0.5}}, Config))
    bench.run_for(2000)  # a sample of this link has come
    bench.arm()
    bench.drive(1.0, n=1)
    assert bench.phase is Phase.ACTIVE
    wait: Callable[[int], list[Event]] = bench.ports.wait
    stopping_ns: list[int] = []

    def noisy(_: int) -> list[Event]:
        bench.ports._advance(bench.ports.now + MS // 20)
        asked = bench.loop.state.asked
        if asked is not None and asked.want is RequestKind.STOP:
            stopping_ns.append(bench.ports.now)
        return [*wait(bench.ports.now), Received(b"\xff")]

    bench.ports.wait = noisy
    bench.run_for(600)
    ordered_ns = bench.ports.now
    bench.order(Stop(order=60))
    bench.run_for(1)

    assert 0 < stopping_ns[0] - ordered_ns < MS


def test_a_change_of_the_period_is_not_counted_as_an_error_of_the_device() -> None:
    bench = Bench()
    bench.run_for(700)

    bench.arm(ts_us=20_000)
    bench.run_for(2000)

    errors = [timing.device_tick_error_us for timing in bench.of(Timing)]
    assert [error.n > 40 for error in errors] == [True] * 3
    assert [error.max for error in errors] == [0.0] * 3


def test_tick_error_between_runs_uses_the_request_period() -> None:
    """Before the run the device is asked every 10 ms, for any Ts of the run."""
    bench = Bench(msgspec.convert({"limits": {"slew_v": 1.0}}, Config))
    bench.arm(ts_us=16_000)
    bench.ask(Run, lease=LEASE, n=1, run_id="r", codes=codes(3.0), scheduled=True)
    assert bench.phase is Phase.FAULT

    bench.run_for(2000)

    errors = [timing.device_tick_error_us for timing in bench.of(Timing)]
    assert errors[-1].n > 90
    assert errors[-1].max < 10.0
