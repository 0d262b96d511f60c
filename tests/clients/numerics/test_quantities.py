"""Numbers as a reader wants them."""

from __future__ import annotations

from math import inf, nan

import pytest
from armrig.numerics.quantities import listed, plural, times, with_range, with_std


def test_one_is_singular_and_all_other_numbers_plural() -> None:
    """None is many, too."""
    assert [plural(n, "sample") for n in (0, 1, 2)] == ["0 samples", "1 sample", "2 samples"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        ((2e-5,), "20 µs"),
        ((0.0206,), "20.6 ms"),
        ((0.8, 1.2), "0.8 … 1.2 s"),
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
def test_a_number_has_the_digits_that_its_standard_deviation_leaves_it(
    value: float, std: float, text: str
) -> None:
    """Two digits of σ; a power of ten where that would take many zeros."""
    assert with_std(value, std) == text


def test_a_number_with_its_range_has_the_digits_of_the_range() -> None:
    """Two digits of a quarter of it, about one σ; no more than six."""
    assert with_range(1.23456, 1.11, 1.404) == "1.235 (1.110 … 1.404)"
    assert with_range(1.0, 1.0 - 1e-9, 1.0 + 1e-9) == "1.000000 (1.000000 … 1.000000)"


@pytest.mark.parametrize(("names", "text"), [("a", "a"), ("ab", "a and b"), ("abc", "a, b and c")])
def test_names_are_listed_as_in_a_sentence(names: str, text: str) -> None:
    """The last one follows an and."""
    assert listed([*names]) == text
