"""The Uno's board layer: times, names, and a reset if a part of it dies.

If only a broken board could show it, a part of the program is broken, built, and run.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig_core.rig.firmware_image import IMAGES, image_crcs
from armrig_daemon.emulator.harness import Violation
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.uno import Uno
from armrig_protocol.messages import ConfigReply, Exchange, Flag, Sample, Start, State, Status, Stop

from tests.firmware.harness_orders import figures, read_eeprom, write_eeprom
from tests.firmware.uno_host import BOOT_NS, MS, Host, broken, harness, powered
from tests.tools import needs

pytestmark = needs("cc", "make", "simavr")
HALF = 32768
DIES_MS = 600
PATIENCE_MS = 50 + 256 + 5
"""Until a converter counts as dead, until the watchdog bites, and for the clock's beginning."""
builds = needs("avr-gcc")


def restart(host: Host) -> None:
    """Reset it by its pin, and wait until it has booted."""
    host.uno.reset(host.now)
    host.wait(BOOT_NS / MS)


def test_a_tick_delayed_by_the_converter_has_the_late_flag() -> None:
    ts_us = 2600
    late = 0
    with powered() as host:
        holds: list[int] = []
        host.uno.stuck = lambda t_ns, channel: holds.append(t_ns) if channel == 0 else None
        began_us: list[float] = []
        for i in range(100):
            host.arm(mode=1, ts_us=ts_us, oversampling=8, watchdog_ms=250)
            nonce = host.last(ConfigReply).nonce
            host.heard.clear()
            holds.clear()
            host.say(Exchange, 1, 0)
            host.wait(1.25 + i * 0.002)
            host.say(Start, 3, nonce)
            host.wait(14)
            host.say(Stop)
            host.wait(2)

            samples = host.of(Sample)
            assert [s.k for s in samples] == [1, 0, 1, 2]
            waited = samples[1].t_us != samples[2].t_us - ts_us
            assert bool(samples[1].flags & Flag.TICK_LATE) == waited
            late += waited
            lasts = [h for n, h in enumerate(holds) if n % 8 == 7]
            began_us += [h / 1000 - s.t_us for h, s in zip(lasts, samples, strict=True)]
    assert 0 < late < 100
    assert max(began_us) - min(began_us) <= 1


def test_a_spoilt_byte_of_the_uid_changes_nothing() -> None:
    """The uid is stored twice, each copy with its check."""
    with powered() as host:
        uid = host.hello().uid
        eeprom = read_eeprom(host.uno.harness, 0, 1024)
        places = [i for i in range(1024) if eeprom[i : i + 8] == uid.to_bytes(8, "little")]
        assert len(places) == 2

        for at in (place + byte for place in places for byte in range(12)):
            write_eeprom(host.uno.harness, at, bytes([eeprom[at] ^ 0x10]))
            restart(host)
            assert host.hello().uid == uid, at
            write_eeprom(host.uno.harness, at, eeprom[at : at + 1])


@pytest.mark.parametrize("name", IMAGES)
def test_the_crc_in_hello_names_the_image(name: str) -> None:
    with powered(name=name) as host:
        assert host.hello().firmware == image_crcs()[name]


def test_status_reports_the_longest_interrupt() -> None:
    """The longest interrupt takes 30 µs and more, less than a turn of the clock."""
    with powered() as host:
        host.start()
        host.drive(HALF, 600)

        assert 30 <= host.last(Status).isr_max_us < 128


@builds
@pytest.mark.parametrize(
    "fault",
    ["for (;;) ;", "ADCSRA = 0;", "TIMSK0 = 0;"],
    ids=["main hangs", "the converter is off", "the clock stands still"],
)
def test_the_hardware_watchdog_resets_a_hung_board(fault: str, tmp_path: Path) -> None:
    """S3: in RUN, while the host goes on."""
    loop = "        if (is_time_to_poll())\n"
    dies = f"        if (board_now_us() > {DIES_MS}000) {{ {fault} }}\n"
    image = broken(tmp_path, "boards/uno/main.c", loop, dies + loop)
    uno = Uno(harness(), image, EmulatorSettings(), 0)
    try:
        host = Host(uno)
        host.wait(BOOT_NS / MS)
        host.start(watchdog_ms=250)
        while host.now < (DIES_MS - 10) * MS:
            host.drive(HALF, 1, host.now // MS)
        assert uno.state is State.RUN
        assert uno.duties[-1].high == 512

        for _ in range(200):  # the host goes on
            host.drive(HALF, 1, host.now // MS)

        counts = figures(uno.harness)
        assert counts.boots >= 2
        assert uno.ns(counts.last_high) <= DIES_MS * MS + PATIENCE_MS * MS
        assert not uno.duties[-1].enabled
        # Bytes are lost where nobody takes them.
        assert {v.what for v in uno.violations} <= {Violation.RX_OVERRUN}
    finally:
        uno.close()


@builds
def test_boot_ids_stay_unique_with_a_worn_out_eeprom(tmp_path: Path) -> None:
    count = "    keep(&counts[place], &next, sizeof next);\n"
    image = broken(tmp_path, "boards/uno/identity.c", count, "")
    uno = Uno(harness(), image, EmulatorSettings(), 0)
    try:
        host = Host(uno)
        host.wait(BOOT_NS / MS)
        told = set()
        for _ in range(5):
            told.add(host.hello().boot_id & 0xFFFF)
            restart(host)
    finally:
        uno.close()
    assert len(told) == 5
