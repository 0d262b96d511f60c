"""Numbers as a reader wants them."""

from __future__ import annotations

from math import inf, nan

import pytest
from armrig.numerics.quantities import (
    NBSP,
    error,
    fixed,
    listed,
    microseconds,
    milliseconds,
    near_one,
    number,
    p_relation,
    p_value,
    percent,
    places,
    plural,
    power,
    scaled,
    times,
    with_range,
    with_std,
)


def test_a_noun_is_singular_after_1_and_plural_after_other_numbers() -> None:
    assert [plural(n, "sample") for n in (0, 1, 2)] == ["0 samples", "1 sample", "2 samples"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        ((2e-5,), "20 µs"),
        ((0.0206,), "20.6 ms"),
        ((0.8, 1.2), "0.8 … 1.2 s"),
        ((-2.5, 0.0, 0.3), "-2.5 … 0 … 0.3 s"),
        ((0.99996,), "1000 ms"),
        ((7200.0,), "120 min"),
        ((36000.0,), "10 h"),
        ((7.2e5,), "8.33 days"),
        ((0.0,), "0 µs"),
    ],
)
def test_times_have_the_unit_of_the_longest(seconds: tuple[float, ...], text: str) -> None:
    """Nobody reads 7.2e+06 ms."""
    assert times(*seconds) == text


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


def test_a_number_with_its_range_has_the_digits_of_the_range() -> None:
    """Two digits of a quarter of the range, about one σ; at most six."""
    assert with_range(1.23456, 1.11, 1.404) == "1.235 (1.110 … 1.404)"
    assert with_range(1.0, 1.0 - 1e-9, 1.0 + 1e-9) == "1.000000 (1.000000 … 1.000000)"


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
        (number(999.4), "999"),
        (number(999.6), "1000"),
        (number(1234.5), "1234"),
        (number(-0.01234), "−0.0123"),
        (power(1.234e-5), "1.23·10⁻⁵"),
        (power(-1.7e-4), "−1.70·10⁻⁴"),
        (power(1e-3), "0.001"),
        (power(0.0), "0"),
        (fixed(-1.25, 1), "−1.2"),
        (percent(99.987), "99.99 %"),
        (percent(90.0), "90 %"),
        (percent(100.0), "100.00 %"),
        (percent(101.4), "101 %"),
        (error(0.0123, "rad"), "12.3 mrad"),
        (error(0.1, "rad"), "0.1 rad"),
        (error(-0.0123, "rad"), "−12.3 mrad"),
        (error(-0.123, "rad"), "−0.123 rad"),
        (error(0.0123, "V"), "0.0123 V"),
        (near_one(0.99, 0.02), "0.990 ± 0.020"),
        (near_one(0.99, 1.2e-5), "0.990000 ± 0.000012"),
        (near_one(0.99, 1.2e-6), "0.9900000 ± 1.2e-06"),
        (near_one(0.99, 1.2e-12), "0.990000000 ± 1.2e-12"),
        (microseconds(0.25), "0.25 µs"),
        (milliseconds(0.0125), "12.5 ms"),
        (p_relation(0.00099), "< 0.001"),
        (p_relation(0.001), "= 0.001"),
        (p_value(0.00099), "< 0.001"),
        (p_value(0.001), "0.001"),
        (p_value(nan), "–"),
    ],
)
def test_a_number_is_formatted_according_to_its_kind(written: str, text: str) -> None:
    assert written.replace(NBSP, " ") == text


def test_two_digits_of_a_standard_deviation_are_shown() -> None:
    """Five decimals if the deviation is unknown."""
    assert [places(std) for std in (0.012, 1.2, 12.0, 120.0, 0.0, inf)] == [3, 1, 0, 0, 5, 5]


@pytest.mark.parametrize(("names", "text"), [("a", "a"), ("ab", "a and b"), ("abc", "a, b and c")])
def test_a_list_of_names_has_commas_and_an_and(names: str, text: str) -> None:
    assert listed([*names]) == text
