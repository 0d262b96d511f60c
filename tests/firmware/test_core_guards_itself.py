"""Checks of the core on itself, and rules of its source."""

from __future__ import annotations

import re

import pytest
from armrig_protocol import messages as wire
from armrig_protocol.messages import Cause, Flag, Mode, State

from tests.daemon.emulator.emulated_host import MS, US, Host, S, only
from tests.daemon.emulator.test_readings import reading
from tests.firmware.core_device import CoreDevice
from tests.firmware.library import FIRMWARE
from tests.tools import needs

pytestmark = needs("cc", "make")


@pytest.fixture
def host() -> Host:
    """Return a host with a device that has the C core."""
    return Host(kind=CoreDevice)


def test_a_code_corrupted_in_memory_is_not_driven(host: Host) -> None:
    """A queue that was spoilt in memory: 0 V, and FAULT(INTERNAL)."""
    host.reach(State.ARMED, mode=Mode.SCHEDULED, u_max=1000)
    host.supply(0, [500] * 24)
    host.wait(2 * MS)
    host.ask(wire.Start, k_stop=0)
    assert host.device.board.code
    host.device.use().pc_spoil_next(1001)

    heard = host.wait(40 * MS)

    (event,) = [m for m in heard if isinstance(m, wire.Event)]
    assert (event.state, event.cause) == (State.FAULT, Cause.INTERNAL)
    assert host.device.board.volts == 0.0
    assert max(change.volts for change in host.changes) < 5.0 * 1000 / 65535


@pytest.mark.parametrize(
    ("codes", "expected"),
    [([65_000, 64_900, 0, 700], 700), ([64_900, 0, 0, 0], 0), ([65_471, 64, 64, 64], 16_416)],
)
def test_readings_are_not_averaged_across_the_dead_band(
    host: Host, codes: list[int], expected: int
) -> None:
    host.reach(State.READY, ts_us=5000, oversampling=4)
    reading(host, codes, [2000] * 4)

    host.put(wire.Exchange, k=1, u=0)

    assert only(wire.Sample, host.wait(3 * MS)).y0 == expected


def test_only_one_function_drives_the_motor() -> None:
    sources = {path: path.read_text() for path in (FIRMWARE / "core").glob("*.c")}
    calls = [path.name for path, text in sources.items() if "board_motor_set(" in text]

    assert calls == ["rig_motor.c"]
    assert "".join(sources.values()).count("board_motor_set(") == 1


def test_every_transition_but_to_run_turns_the_motor_off_first() -> None:
    texts = {path.name: path.read_text() for path in (FIRMWARE / "core").glob("*.c")}
    writes = [name for name, text in texts.items() for _ in re.finditer(r"rig\.state = ", text)]
    body = texts["rig_states.c"].split("void rig_enter(")[1].split("{\n", 1)[1]
    cut = texts["rig_motor.c"].split("void rig_motor_cut(void)")[1].split("{\n", 1)[1]

    # BOOT is set at the beginning, by rig_begin, which turns the motor off before.
    assert sorted(writes) == ["rig_loop.c", "rig_states.c"]
    assert body.startswith("    if (state != RIG_STATE_RUN)\n        rig_motor_cut();\n")
    assert cut.startswith("    board_motor_off();\n")


def test_bytes_lost_by_the_board_are_counted_and_reported_once(host: Host) -> None:
    host.hello()
    host.device.use().pc_lose(3)
    host.device.use().rig_poll()

    first = only(wire.Sample, host.ask(wire.Exchange, k=1, u=0))
    second = only(wire.Sample, host.ask(wire.Exchange, k=2, u=0))
    status = [m for m in host.wait(1 * S) if isinstance(m, wire.Status)]

    assert first.flags & Flag.RX_OVERFLOW
    assert not second.flags & Flag.RX_OVERFLOW
    assert status[0].rx_lost == 3


def test_a_board_that_polls_often_reports_its_status_once_a_second(host: Host) -> None:
    """The numbers of its frames have no gap, so none is sent between those that arrive."""
    host.hello()
    heard: list[wire.Status] = []
    for _ in range(30):
        host.device.use().rig_poll()
        heard += [m for m in host.wait(100 * MS) if isinstance(m, wire.Status)]

    assert [round(m.uptime_ms / 1000) for m in heard] == [1, 2, 3]
    assert [m.seq - heard[0].seq for m in heard] == [0, 1, 2]


def test_samples_skipped_by_a_busy_main_loop_are_counted(host: Host) -> None:
    """Two samples wait; a third is a frame not sent, counted once, and a break in k."""
    host.hello()
    c = host.device.use()
    for k in (1, 2):
        host.put(wire.Exchange, k=k, u=0)
    host.wait(400 * US)  # both are taken in

    for what in (0, 0, 1):  # their ends, and one of the timer, before main looks
        c.rig_reading(0, 1 << 15)
        c.rig_reading(1, 1 << 15)
        c.rig_converted(what, 7)
    assert c.pc_tx_dropped() == 0
    c.rig_poll()
    c.rig_poll()

    assert c.pc_tx_dropped() == 1
