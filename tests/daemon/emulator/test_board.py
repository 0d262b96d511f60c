"""The pin, the voltage and S1."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from armrig_core.rig.description import builtin
from armrig_core.rig.volts import duty
from armrig_daemon.emulator import board as board_module
from armrig_daemon.emulator.board import Board, Change, VoltageError, pin_code, volts
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol.messages import Cause, State
from hypothesis import given
from hypothesis import strategies as st

CODES = st.integers(0, 65535)
BITS = st.integers(8, 16)


def make_board(changes: list[Change] | None = None) -> Board:
    """Return a board that reports its `changes`."""
    witness = None if changes is None else changes.append
    return Board(EmulatorSettings(), 0, np.random.default_rng(0), witness)


@given(CODES, BITS)
def test_the_duty_is_the_nearest_and_the_report_is_its_code(code: int, bits: int) -> None:
    """Steps d = round(u 2^n / 65535), reported as round(d 65535 / 2^n), a tie going up."""
    d = duty(code, bits)

    assert abs(d - Fraction(code << bits, 65535)) < Fraction(1, 2)
    assert Fraction(-1, 2) < pin_code(code, bits) - Fraction(d * 65535, 1 << bits) <= Fraction(1, 2)


@given(CODES, st.integers(0, 16).filter(lambda n: n == 0 or n >= 8))
def test_the_reported_code_and_the_duty_are_the_same_voltage(code: int, bits: int) -> None:
    assert volts(pin_code(code, bits), bits) == volts(code, bits)


@given(CODES, st.sampled_from([0, 8, 10, 16]))
def test_every_code_is_a_voltage_in_range(code: int, bits: int) -> None:
    """S1: 0 ... 65535 is 0 ... 5 V, at every resolution, exact at both ends."""
    assert 0.0 <= volts(code, bits) <= 5.0
    assert (volts(0, bits), volts(65535, bits)) == (0.0, 5.0)


@pytest.mark.parametrize("code", [-1, 65536])
def test_an_invalid_code_does_not_reach_the_pin(code: int) -> None:
    """S1."""
    board = make_board()

    with pytest.raises(VoltageError, match=f"code {code}"):
        board.latch(0, code, Cause.REQUEST)

    assert board.volts == 0.0


@pytest.mark.parametrize("wrong", [-0.001, 5.001, float("nan")])
def test_a_voltage_out_of_range_does_not_reach_the_motor(
    monkeypatch: pytest.MonkeyPatch, wrong: float
) -> None:
    """S1 holds even if the scale itself is wrong."""
    monkeypatch.setattr(board_module, "volts", lambda code, bits: wrong)
    board = make_board()

    with pytest.raises(VoltageError, match="V at the motor"):
        board.latch(0, 100, Cause.REQUEST)

    assert board.volts == 0.0


def test_the_pin_monitor_records_only_changes() -> None:
    changes: list[Change] = []
    board = make_board(changes)

    board.latch(10, 65535, Cause.REQUEST)
    board.latch(20, 65535, Cause.REQUEST)
    board.release(30, State.FAULT, Cause.WATCHDOG)

    assert changes == [
        Change(10, 5.0, State.RUN, Cause.REQUEST),
        Change(30, 0.0, State.FAULT, Cause.WATCHDOG),
    ]


def test_an_ideal_sensor_has_no_dead_band() -> None:
    """A turn is 65536 codes on both joints."""
    settings = EmulatorSettings(
        potentiometers=False, adc_bits=0, adc_noise_v=0.0, theta_1_zero_deg=90.0
    )

    board = Board(settings, 0, np.random.default_rng(0))

    assert board.reading(0, 0) == 65536 // 4
    assert board.reading(1, 0) == round(65536 * 176 / 360)


def test_a_board_reads_the_outputs_of_a_described_rig() -> None:
    """The heater at rest is as warm as the room."""
    heater, settings = builtin("heater"), EmulatorSettings(adc_bits=0, adc_noise_v=0.0)

    board = Board(settings, 0, np.random.default_rng(0), description=heater)

    assert heater.outputs["T1"].value(board.reading(0, 0)) == pytest.approx(23.0, abs=0.3)


@pytest.mark.parametrize(
    ("code", "gain", "offset_v", "terminal"),
    [(0, 0.9, 0.12, 0.0), (13107, 0.9, 0.12, 1.02), (65535, 1.2, 0.12, 5.0), (66, 0.9, -0.1, 0.0)],
)
def test_a_driver_with_a_gain_and_an_offset_stays_between_its_supplies(
    code: int, gain: float, offset_v: float, terminal: float
) -> None:
    settings = EmulatorSettings(driver_gain=gain, driver_offset_v=offset_v)
    board = Board(settings, 0, np.random.default_rng(0))

    board.latch(0, code, Cause.REQUEST)

    assert board.volts == pytest.approx(terminal, abs=0.005)
    assert board.code == pin_code(code, 10)


def test_a_late_duty_measurement_drives_the_arm_from_its_present_time() -> None:
    changes: list[Change] = []
    board = make_board(changes)
    board.drive(2_000_000, 0.5, State.RUN, Cause.REQUEST)
    board.drive(1_000_000, 0.25, State.RUN, Cause.REQUEST)

    assert [(change.t_ns, change.volts) for change in changes] == [
        (2_000_000, 2.5),
        (2_000_000, 1.25),
    ]
    assert board.volts == 1.25


def test_a_duty_above_1_does_not_reach_the_motor() -> None:
    """S1."""
    board = make_board()

    with pytest.raises(VoltageError):
        board.drive(0, 1.001, State.RUN, Cause.REQUEST)

    assert board.volts == 0.0
