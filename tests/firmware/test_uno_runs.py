"""Scheduled and exchange runs on the Uno's binary, by the daemon's own loop and core."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from itertools import pairwise

import pytest
from armrig_core.rig.description import builtin
from armrig_core.rig.volts import code_of, device_code, duty, volts_of
from armrig_core.telemetry.telemetry import Sample
from armrig_daemon.config import Config, DeviceTable
from armrig_daemon.decisions.state import Phase
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.uno import Uno
from armrig_daemon.pipe import RunEnded, RunStarted
from armrig_daemon.virtual import VirtualRig
from armrig_protocol.messages import Flag

from tests.daemon.test_scheduled_in_virtual_time import telegraph
from tests.daemon.virtual_bench import MS, Bench
from tests.firmware.harness_orders import figures
from tests.firmware.uno_host import PERIOD_NS, switch_on
from tests.sampling import sampled
from tests.tools import needs

pytestmark = needs("cc", "make", "simavr")
LATCH_NS = 10_000
"""Longest delay of an interrupt by another; its duty acts in the next period."""


class UnoBench(Bench):
    """A loop in virtual time, with the firmware's binary at the other end of its line."""

    def __init__(
        self, config: Config | None = None, seed: int = 1, rig: str = "arm", image: str = "uno"
    ) -> None:
        self.lateness_ns = 0
        self._number = 0
        rules = (config or Config()).rules(builtin(rig))
        settings = EmulatorSettings(seed=seed, baud=rules.baud)
        lateness: Callable[[], int] = lambda: self.lateness_ns  # noqa: E731
        on = partial(switch_on, name=image)
        VirtualRig.__init__(self, rules, settings, lateness, 0, on)
        self.holds: list[int] = []
        self.uno.stuck = self._note_hold
        self.run_for(500)

    @property
    def uno(self) -> Uno:
        device = self.ports.device
        assert isinstance(device, Uno)
        return device

    def _note_hold(self, t_ns: int, channel: int) -> None:
        if channel == 0:
            self.holds.append(t_ns)

    def run(self, volts: list[float], ts_us: int, *, scheduled: bool = True) -> None:
        """Play a run to its end."""
        self.play(volts, ts_us, scheduled=scheduled)
        self.run_for(len(volts) * ts_us / 1000 + 500)


@pytest.mark.parametrize(
    ("rig", "image", "is_fit"),
    [
        ("tclab", "tclab", True),
        ("tclab", "uno", False),
        ("rc", "uno", True),
        ("rc", "tclab", False),
    ],
)
def test_a_board_is_driven_only_with_the_image_of_its_rig(
    rig: str, image: str, is_fit: bool
) -> None:
    bench = UnoBench(rig=rig, image=image)

    with closing(bench.uno):
        state = bench.loop.state
        assert state.phase is (Phase.SAFE if is_fit else Phase.FAULT)
        needed = "" if is_fit else f"which `armrig flash --image {builtin(rig).rig.image}` writes"
        assert needed in (state.fault.cause if state.fault else "")
        assert not any(duty.high for duty in bench.uno.duties)


@pytest.fixture
def switched_on() -> Iterator[Callable[..., UnoBench]]:
    """Return what switches benches on; they are switched off at the end."""
    benches: list[UnoBench] = []

    def switch_on_bench(config: Config | None = None, seed: int = 1) -> UnoBench:
        benches.append(UnoBench(config, seed))
        return benches[-1]

    yield switch_on_bench
    for bench in benches:
        bench.uno.close()


@pytest.fixture
def bench(switched_on: Callable[..., UnoBench]) -> UnoBench:
    """Return a bench whose watchdog outlasts a stall of the host."""
    return switched_on(Config(device=DeviceTable(watchdog_ms=250)))


def assert_complete(bench: UnoBench, volts: list[float]) -> None:
    """Every sample has its own u, none is and the motor is off afterwards."""
    (started,) = bench.of(RunStarted)
    samples = [s for s in bench.samples if 0 <= s.k - started.k_first < len(volts)]
    assert [r.outcome for r in bench.of(RunEnded)] == ["complete"]
    assert len(samples) == len(volts)
    for s, v in zip(samples, volts, strict=True):
        assert s.u_cmd_v == volts_of(code_of(v))
        assert s.u_applied_v == volts_of(device_code(code_of(v), 10))
        assert not s.flags & (Flag.TICK_LATE | Flag.UNDERRUN | Flag.RX_OVERFLOW | Flag.TX_DROP)
    assert bench.phase is Phase.SAFE
    assert bench.volts == 0.0


def assert_on_the_pin(bench: UnoBench, volts: list[float], ts_us: int) -> None:
    """Each u drives the pin from one period of the PWM after theta_1's hold to the next one."""
    uno, duties = bench.uno, bench.uno.duties
    (started,) = bench.of(RunStarted)
    samples = [s for s in bench.samples if 0 <= s.k - started.k_first < len(volts)]
    first = index_of_hold(bench, samples[0])
    holds = bench.holds[first : first + len(volts)]
    at = 0
    for hold_ns, v in zip(holds, volts, strict=True):
        by_ns = hold_ns + PERIOD_NS + LATCH_NS
        while at + 1 < len(duties) and uno.ns(duties[at + 1].cycle) <= by_ns:
            at += 1
        assert duties[at].high == duty(code_of(v), 10)
        assert at + 1 == len(duties) or uno.ns(duties[at + 1].cycle) > hold_ns + (ts_us - 70) * 1000
    for a, b in pairwise(holds):
        assert abs(b - a - ts_us * 1000) <= 1000
    offsets = [h - s.t_device_us * 1000 for h, s in zip(holds, samples, strict=True)]
    assert max(offsets) - min(offsets) <= 1000


def index_of_hold(bench: UnoBench, sample: Sample) -> int:
    """Return which hold is that of a sample.

    The device's clock begins with its program, and both are known together where samples are rare.
    """
    alone_us = bench.samples[20].t_device_us
    (behind_ns,) = (h - alone_us * 1000 for h in bench.holds if 0 <= h - alone_us * 1000 < 9 * MS)
    due_ns = sample.t_device_us * 1000 + behind_ns
    return next(i for i, t in enumerate(bench.holds) if abs(t - due_ns) <= 1000)


@pytest.mark.parametrize(("ts_us", "seconds"), sampled([(2000, 3), (2000, 10), (1000, 10)]))
def test_every_u_is_applied_at_its_k_and_at_the_pin(
    bench: UnoBench, ts_us: int, seconds: int
) -> None:
    """At 1 kHz and at 500 Hz, with PING and STATUS: no byte is lost."""
    volts = telegraph(seconds * 1_000_000 // ts_us)

    bench.run(volts, ts_us)

    assert_complete(bench, volts)
    assert bench.uno.violations == []
    assert_on_the_pin(bench, volts, ts_us)
    counts = figures(bench.uno.harness)
    assert counts.boots == 1
    assert counts.interrupts_off_max <= 16 * 16  # 16 us


def test_every_u_of_exchange_mode_is_applied_at_the_pin(bench: UnoBench) -> None:
    """Exchange mode at 200 Hz."""
    volts = telegraph(1000)

    bench.run(volts, 5000, scheduled=False)

    assert_complete(bench, volts)
    assert bench.uno.violations == []
