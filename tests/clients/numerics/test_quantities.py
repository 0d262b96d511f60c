"""Numbers as a reader wants them; said_of_data.txt contains the other forms."""

from __future__ import annotations

from math import inf, nan

import pytest
from armrig.numerics.quantities import (
    NBSP,
    near_one,
    p_value,
    percent,
    scaled,
    with_std,
)


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (1.23456, 0.012, "1.235 ± 0.012"),
        (1234.56, 78.0, "1235 ± 78"),
        (0.00534, 2e-5, "0.005340 ± 0.000020"),
        (5.34e-5, 2.1e-8, "5.340000e-05 ± 2.1e-08"),
        (1.234567, 0.0, "1.2346"),
        (1.234567, nan, "1.2346"),
        (1.234567, inf, "1.2346"),
    ],
)
def test_the_digits_of_a_number_follow_from_its_standard_deviation(
    value: float, std: float, text: str
) -> None:
    """Two digits of σ; a power of ten replaces many zeros."""
    assert with_std(value, std) == text


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (1.6989e-3, 1.6e-6, "(1.6989 ± 0.0016)·10⁻³ m"),
        (1.6989e-4, 1.6e-7, "(169.89 ± 0.16)·10⁻⁶ m"),
        (-5.34e-5, 2.1e-7, "(−53.40 ± 0.21)·10⁻⁶ m"),
        (45_678.0, 12.0, "(45.678 ± 0.012)·10³ m"),
        (1234.5, 12.0, "1234 ± 12 m"),
        (0.0123, 1e-3, "0.0123 ± 0.0010 m"),
        (0.0, 0.012, "0.000 ± 0.012 m"),
    ],
)
def test_a_quantity_is_written_with_a_unit_prefix(value: float, std: float, text: str) -> None:
    """The power is divisible by three; between 0.01 and 9999 there is none."""
    assert scaled(value, std, "m").replace(NBSP, " ") == text


@pytest.mark.parametrize(
    ("written", "text"),
    [
        (percent(99.987), "99.99 %"),
        (percent(90.0), "90 %"),
        (percent(100.0), "100.00 %"),
        (percent(101.4), "101 %"),
        (near_one(0.99, 0.02), "0.990 ± 0.020"),
        (near_one(0.99, 1.2e-5), "0.990000 ± 0.000012"),
        (near_one(0.99, 1.2e-6), "0.9900000 ± 1.2e-06"),
        (near_one(0.99, 1.2e-12), "0.990000000 ± 1.2e-12"),
        (p_value(nan), "–"),
    ],
)
def test_a_number_is_formatted_according_to_its_kind(written: str, text: str) -> None:
    assert written.replace(NBSP, " ") == text
