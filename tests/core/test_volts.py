"""Voltage, its code, and the code that a device really latches."""

from __future__ import annotations

import math

import pytest
from armrig_core.rig.volts import code_of, codes_of, device_code, volts_of
from hypothesis import given
from hypothesis import strategies as st

codes = st.integers(0, 65535)


@given(codes)
def test_code_and_voltage_convert_both_ways(code: int) -> None:
    assert code_of(volts_of(code)) == code


def test_code_0_is_0_v_and_code_65535_is_5_v() -> None:
    assert (volts_of(0), volts_of(65535)) == (0.0, 5.0)


@pytest.mark.parametrize("volts", [-1e-9, 5.000001, math.nan, math.inf, -math.inf])
def test_a_voltage_out_of_range_is_refused_and_not_clamped(volts: float) -> None:
    with pytest.raises(ValueError, match="outside 0 … 5 V"):
        code_of(volts)


@given(codes, st.integers(8, 16))
def test_the_latched_voltage_is_within_half_a_step_of_the_requested(code: int, bits: int) -> None:
    applied = device_code(code, bits)

    assert abs(applied - code) <= 65535 / 2**bits / 2 + 0.5
    assert 0 <= applied <= 65535
    assert device_code(applied, bits) == applied


def test_the_codes_of_a_run_are_converted_from_its_voltages() -> None:
    assert codes_of([0.0, 1.0, 5.0]) == b"".join(
        code_of(u).to_bytes(2, "little") for u in (0, 1, 5)
    )
    with pytest.raises(ValueError, match=r"5\.1 V is not allowed"):
        codes_of([5.0, 5.1])
