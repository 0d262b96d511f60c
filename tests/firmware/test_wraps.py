"""Counters that come to their end: seq, k, t_us, and what STATUS counts."""

from __future__ import annotations

import pytest
from armrig_daemon.emulator.clock import EmulatedClock
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol import messages as wire
from armrig_protocol.messages import SCHEMA_HASH, VERSION, Mode, State

from tests.daemon.emulator.emulated_host import CONFIG
from tests.firmware.both_devices import MS, US, BothDevices, S
from tests.tools import needs

pytestmark = needs("cc", "make")

INSTANT = EmulatorSettings(boot_ms=0.0, model_baud=False, queue=64)


def in_run(*, after_ns: int = 1 * MS, **config: int) -> BothDevices:
    """Return both devices in RUN; in scheduled mode with the first setpoints."""
    both = BothDevices(INSTANT)
    both.wait(10 * MS)
    both.put(wire.Hello, version=VERSION, schema=SCHEMA_HASH)
    both.put(wire.Config, **{**CONFIG, **config})
    both.wait(5 * MS)
    both.put(wire.Arm, boot_id=both.boot_id, config_crc=both.config_crc, nonce=both.nonce)
    both.wait(1 * MS)
    if config.get("mode"):
        both.put(wire.Setpoints, k0=0, n=24, zero=0, u=(1000,) * 24)
    both.put(wire.Start, k_stop=0, nonce=both.nonce)
    both.wait(after_ns)
    assert both.devices[1].state is State.RUN
    return both


def test_the_k_of_an_exchange_wraps() -> None:
    """Half a circle ahead is not ahead."""
    both = in_run()
    half = 1 << 31

    for k in (half - 1, half, 2**32 - 2, 2**32 - 1, 0, 1, 2**32 - 1, 1 + half, 2, half):
        both.put(wire.Exchange, k=k, u=k & 0xFF)
        both.wait(1 * MS)

    taken = [m.k for m in both.heard if isinstance(m, wire.Sample)]
    assert taken == [half - 1, half, 2**32 - 2, 2**32 - 1, 0, 1, 2, half]


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("ahead_us", [20_000, 25_500, 30_208])
def test_the_device_clock_wraps(mode: Mode, ahead_us: int) -> None:
    """Watchdog, timer, STATUS and the supply's measurements continue across 2^32 µs."""
    both = BothDevices(EmulatorSettings(boot_ms=1.0, queue=64, brown_out_s=1.5))
    for device in both.devices:
        device._fw.clock = EmulatedClock(-((1 << 32) - ahead_us) * US)
    both.wait(10 * MS)
    both.put(wire.Hello, version=VERSION, schema=SCHEMA_HASH)
    both.put(wire.Config, **{**CONFIG, "mode": mode, "watchdog_ms": 20})
    both.wait(3 * MS)
    both.put(wire.Arm, boot_id=both.boot_id, config_crc=both.config_crc, nonce=both.nonce)
    both.wait(1 * MS)
    both.put(wire.Start, k_stop=0, nonce=both.nonce)
    for k in range(30):
        if mode == Mode.EXCHANGE:
            both.put(wire.Exchange, k=k, u=k)
        else:
            both.put(wire.Setpoints, k0=k, n=1, zero=0, u=(k, *(0,) * 23))
        both.wait(1 * MS)
    assert both.devices[1].state is State.RUN

    both.wait(3 * S)

    assert both.devices[1].state is State.FAULT
    times = [m.t_us for m in both.heard if isinstance(m, wire.Sample)]
    assert max(times) - min(times) > 1 << 31


def test_a_run_may_be_longer_than_32_bits_of_its_index() -> None:
    """The queue continues across 2^32; the second index 0 is not the first sample."""
    both = in_run(after_ns=300 * US, mode=Mode.SCHEDULED, slew=2000, watchdog_ms=250)
    last = 2**32 - 4  # as after 49.7 days
    for device in both.devices:
        fw = device._fw
        fw.timer.first_ns -= last * fw.timer.period_ns
        fw.timer.k = fw.queue.next = last
    both.held = last + 24

    both.wait(100 * US)
    for _ in range(6):
        # u_rest is 0: were index 0 the first again, 3000 would be too far from it.
        both.put(wire.Setpoints, k0=both.held % 2**32, n=8, zero=0, u=(*[3000] * 8, *[0] * 16))
        both.held += 8
        both.wait(8 * MS)

    assert both.devices[1].state is State.RUN
