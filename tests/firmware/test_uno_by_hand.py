"""The Uno's binary, talked to frame by frame; every voltage is the one measured at its pin."""

from __future__ import annotations

import zlib
from itertools import pairwise

import pytest
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol import messages as wire
from armrig_protocol.frame import encode
from armrig_protocol.messages import Cause, Flag, State

from tests.firmware.harness_orders import (
    eeprom_byte,
    figures,
    optiboot,
    read_eeprom,
    stand,
    supply,
    write_eeprom,
)
from tests.firmware.uno_host import (
    BOOT_NS,
    MS,
    Host,
    assert_low_outside_run,
    high_from,
    powered,
    switch_on,
)
from tests.tools import needs

pytestmark = needs("cc", "make", "simavr")
HALF = 32768


@pytest.mark.parametrize("watchdog_ms", [20, 100, 250])
def test_a_silent_host_stops_the_motor_within_the_watchdog_and_1_ms(watchdog_ms: int) -> None:
    """S3: nothing more comes, as after a kill -9 of the daemon."""
    with powered() as host:
        host.start(watchdog_ms=watchdog_ms)
        fed_ns = host.drive(HALF, 5)

        host.wait(watchdog_ms + 50)

        low_ns = host.uno.ns(figures(host.uno.harness).last_high)
        assert (watchdog_ms - 0.1) * MS <= low_ns - fed_ns <= (watchdog_ms + 1) * MS
        assert host.last(wire.Event).cause == Cause.WATCHDOG
        assert_low_outside_run(host)


@pytest.mark.parametrize("kind", [wire.Stop, wire.Estop])
def test_a_stop_acts_within_a_millisecond_of_its_last_byte(kind: type) -> None:
    """S6: and the pin stays low."""
    with powered() as host:
        host.start()
        host.drive(65535, 5)

        arrived_ns = host.say(kind)
        host.wait(100)

        assert host.uno.ns(figures(host.uno.harness).last_high) <= arrived_ns + MS
        assert_low_outside_run(host)


@pytest.mark.parametrize("boot_loader", [False, True])
def test_a_reset_in_run_stops_the_motor_at_once(boot_loader: bool) -> None:
    """S1: as the port is opened; a boot loader is deaf for a second, and hides the cause."""
    with powered(boot_loader=boot_loader) as host:
        host.start()
        before = host.hello()
        host.drive(HALF, 5)

        host.uno.reset(host.now)
        reset_ns = host.now
        assert (host.uno.state, host.uno.cause) == (State.BOOT, Cause.POWER_ON)
        host.put(encode(wire.Hello(0, 77, 2, 0)))  # nobody hears it
        if boot_loader:
            host.wait(1000)
            assert host.uno.state is State.BOOT
        host.wait(BOOT_NS / MS)
        after = host.hello()

        assert host.uno.ns(figures(host.uno.harness).last_high) <= reset_ns
        assert after.state == State.IDLE
        assert after.reset == (0 if boot_loader else 2)
        assert after.boot_id != before.boot_id
        assert after.uid == before.uid
        assert host.uno.violations == []


@pytest.mark.parametrize(
    ("version", "told"), [(0x0803, 10), (0x0406, 10), (0x0404, 0), (0xFFFF, 0)], ids=hex
)
def test_the_cause_of_a_reset_is_read_from_optiboot(version: int, told: int) -> None:
    """In r2, from 4.6 on; r2 of an older loader is undefined."""
    with powered(boot_loader=True) as host:
        optiboot(host.uno.harness, version, 10)

        host.uno.reset(host.now)
        host.wait(BOOT_NS / MS + 1000)

        assert host.hello().reset == told


@pytest.mark.parametrize("between", ["STOP", "0 V"])
def test_the_first_period_after_0_v_has_the_new_duty(between: str) -> None:
    """S5: neither the duty before, nor the rest of a period that began then."""
    with powered() as host:
        host.start()
        host.drive(65535, 5)
        if between == "STOP":
            host.say(wire.Stop)
            host.wait(5)
            host.start()
        else:
            host.drive(0, 5, k=6)
        before = len(host.uno.duties)

        host.drive(1000, 5, k=20)

        assert {d.high for d in host.uno.duties[before:]} == {16}
        assert_low_outside_run(host)


def test_a_slow_eeprom_does_not_cause_a_reset() -> None:
    """On a first boot 32 bytes are written, which takes longer than the hardware's watchdog."""
    uno = switch_on(EmulatorSettings(), 0)
    try:
        eeprom_byte(uno.harness, 10_000)
        host = Host(uno)
        host.wait(700)

        assert host.hello().state == State.IDLE
        assert figures(uno.harness).boots == 1
    finally:
        uno.close()


def test_a_duty_of_0_disconnects_the_pin_without_a_spike() -> None:
    """A duty of 0 in RUN: no edge in 100 periods."""
    with powered() as host:
        host.start()
        host.drive(HALF, 5)
        host.drive(0, 2, k=10)
        edges = figures(host.uno.harness).edges

        host.drive(0, 5, k=20)

        assert figures(host.uno.harness).edges == edges
        assert host.last(wire.Sample).u_k == 0


def test_theta_1_is_held_at_the_time_that_hello_declares() -> None:
    """`hold_us` after `t_us`, alpha `skew_us` before it, by the cycles of the board."""
    with powered() as host:
        hello = host.hello()
        holds: list[tuple[int, int]] = []
        host.uno.stuck = lambda t_ns, channel: holds.append((t_ns, channel))
        host.drive(0, 50)

        samples = host.of(wire.Sample)
        alpha, theta_1 = holds[::2], holds[1::2]
        assert {channel for _, channel in alpha} == {1}
        assert {channel for _, channel in theta_1} == {0}
        skews = [b - a for (a, _), (b, _) in zip(alpha, theta_1, strict=True)]
        assert all(abs(skew - hello.skew_us * 1000) <= 1000 for skew in skews)
        # The device's clock begins a little after ours: by the same for each sample.
        begins = [
            t - hello.hold_us * 1000 - s.t_us * 1000
            for (t, _), s in zip(theta_1, samples, strict=True)
        ]
        assert max(begins) - min(begins) <= 1000


def test_an_oversampled_reading_is_the_mean_of_conversions_one_skew_apart() -> None:
    """Sixteen of each channel, alternating."""
    with powered() as host:
        host.arm(ts_us=10_000, oversampling=16)
        holds: list[tuple[int, int]] = []

        def reading(t_ns: int, channel: int) -> int:
            holds.append((t_ns, channel))
            return 500 + len(holds) % 4 + 100 * channel

        host.uno.stuck = reading
        host.say(wire.Exchange, 1, 0)
        host.wait(10)

        assert [channel for _, channel in holds] == [1, 0] * 16
        gaps = [b - a for (a, _), (b, _) in pairwise(holds)]
        assert all(abs(gap - 128_000) <= 1000 for gap in gaps)
        sample = host.last(wire.Sample)
        codes = [500 + (i + 1) % 4 + 100 * (i % 2 == 0) for i in range(32)]
        assert sample.y1 == round(sum(codes[::2]) / 16 * 64)
        assert sample.y0 == round(sum(codes[1::2]) / 16 * 64)
        assert not sample.flags & 0x0100


@pytest.mark.parametrize("ts_us", [1000, 2000])
def test_a_supply_measurement_does_not_change_the_channel_of_a_reading(ts_us: int) -> None:
    with powered() as host:
        host.arm(mode=1, ts_us=ts_us, watchdog_ms=250)
        host.uno.stuck = lambda _, channel: 300 + 400 * channel
        host.say(wire.Start, 0, host.last(wire.ConfigReply).nonce)
        for i in range(20):
            host.wait(100)
            host.say(wire.Ping, i)
            supply(host.uno.harness, 4600)
        host.wait(10)

        taken = [s for s in host.of(wire.Sample) if s.flags & Flag.RUN]
        assert len(taken) >= 1_990_000 // ts_us
        assert {(s.y0, s.y1) for s in taken} == {(300 * 64, 700 * 64)}
        assert not any(s.flags & Flag.TICK_LATE for s in taken)
        assert host.last(wire.Status).vcc_mv == pytest.approx(4600, abs=25)


def test_a_low_supply_causes_a_fault() -> None:
    """By the bandgap: 3.9 V."""
    with powered() as host:
        host.start()
        host.drive(HALF, 20)
        supply(host.uno.harness, 3900)

        for k in range(100, 400):
            host.drive(HALF, 1, k)

        assert host.last(wire.Event).cause == Cause.VCC_LOW
        assert_low_outside_run(host)


def test_boots_are_counted_in_a_ring_and_have_unique_numbers() -> None:
    """Places 0 to 59 of 64 hold the counts 1 to 60: ten boots go on at place 60, and then at 0."""
    with powered() as host:
        boots = [n.to_bytes(4, "little") for n in range(1, 61)]
        places = [boot + _check(boot) for boot in boots]
        begin = read_eeprom(host.uno.harness, 0, 1024).index(places[0])
        write_eeprom(host.uno.harness, begin, b"".join(places))
        replies = [host.hello()]
        for _ in range(10):
            host.uno.reset(host.now)
            host.wait(BOOT_NS / MS)
            replies.append(host.hello())

        assert len({r.boot_id & 0xFFFF for r in replies}) == 11
        assert len({r.boot_id >> 16 for r in replies}) == 11
        assert len({r.uid for r in replies}) == 1
        eeprom = read_eeprom(host.uno.harness, begin, 64 * 8)
        counts = [int.from_bytes(eeprom[i : i + 4], "little") for i in range(0, 64 * 8, 8)]
        assert counts == [*range(65, 71), *range(7, 65)]


def test_a_count_torn_by_a_power_failure_is_not_reused() -> None:
    with powered() as host:
        for _ in range(3):
            host.uno.reset(host.now)
            host.wait(BOOT_NS / MS)
        eeprom = read_eeprom(host.uno.harness, 0, 1024)
        newest = eeprom.index((4).to_bytes(4, "little"))
        told = {host.hello().boot_id & 0xFFFF}
        for torn in range(8):
            write_eeprom(host.uno.harness, newest, eeprom[newest : newest + 8])
            write_eeprom(host.uno.harness, newest + 8, b"\xff" * 8)
            # As left by a boot that counts 5 and is cut off after `torn` bytes.
            whole = (5).to_bytes(4, "little") + _check((5).to_bytes(4, "little"))
            write_eeprom(host.uno.harness, newest + 8, whole[:torn])
            host.uno.reset(host.now)
            host.wait(BOOT_NS / MS)
            told_now = host.hello().boot_id & 0xFFFF

            assert told_now not in told
            assert read_eeprom(host.uno.harness, newest + 8, 8) == whole


def _check(data: bytes) -> bytes:
    return (zlib.crc32(data) ^ 0xFFFFFFFF).to_bytes(4, "little")


def test_the_hardware_watchdog_stops_the_motor_if_the_converter_stops() -> None:
    """S1: while the host feeds the device's own watchdog."""
    with powered() as host:
        host.start(mode=1, watchdog_ms=250, underrun=1, hold=255)
        boot_id = host.hello().boot_id
        host.say(wire.Setpoints, host.last(wire.Sample).k + 3, 24, 0, (HALF,) * 24)
        host.wait(60)
        stand(host.uno.harness)
        stood_ns = host.now
        driven = bool(high_from(host.uno, stood_ns - 1, stood_ns))

        for _ in range(50):
            host.say(wire.Keepalive)
            host.wait(10)
        hello = host.hello()

        assert driven
        assert host.uno.ns(figures(host.uno.harness).last_high) <= stood_ns + 320 * MS
        assert figures(host.uno.harness).boots == 2
        assert hello.boot_id != boot_id
        assert hello.reset == 8  # WDRF
        assert hello.state == State.IDLE
        assert host.uno.violations == []
