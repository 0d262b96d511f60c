"""Numbers as a reader wants them; said_of_data.txt contains the other forms."""

from __future__ import annotations

import re
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest
from armrig.numerics.quantities import (
    NBSP,
    digits,
    near_one,
    p_value,
    percent,
    plural,
    with_std,
    with_unit,
)
from hypothesis import given
from hypothesis.strategies import floats


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
    assert with_unit(value, std, "m").replace(NBSP, " ") == text


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


@pytest.mark.parametrize(
    ("n", "text"),
    [(0, "0 samples"), (1, "1 sample"), (2, "2 samples"), (1.0, "1 sample"), (0.5, "0.5 samples")],
)
def test_a_number_agrees_with_its_noun(n: float, text: str) -> None:
    assert plural(n, "sample") == text


def test_a_number_agrees_with_its_verb() -> None:
    found = [plural(n, "value is", "values are") for n in (np.int64(1), np.int64(3))]

    assert found == ["1 value is", "3 values are"]


@pytest.mark.parametrize("n", [1, 2, 3])
@given(x=floats(-1e8, 1e8))
def test_a_number_in_a_sentence_has_no_power_of_ten_above_1(n: int, x: float) -> None:
    text = digits(x, n)

    assert "e+" not in text
    assert float(text) == pytest.approx(x, rel=0.51 * 10 ** (1 - n))


@pytest.mark.parametrize(
    ("x", "n", "text"),
    [
        (330.4, 2, "330"),
        (99.4, 2, "99"),
        (99.5, 2, "100"),
        (-999.6, 3, "-1000"),
        (3e-5, 2, "3e-05"),
        (nan, 2, "nan"),
        (inf, 2, "inf"),
        (1e300, 2, "1e+300"),
    ],
)
def test_a_large_number_is_rounded_to_an_integer(x: float, n: int, text: str) -> None:
    assert digits(x, n) == text


COUNT = re.compile(r"(?<! of )(?<! of its )\{([^{}:!'\"]+)\} (samples|states|lags|messages|rows)\b")
"""A count before a plural noun: the text is wrong for 1."""
FEW_DIGITS = re.compile(r"(?<!float\()f[\"'][^\"']*:>?\d*\.[123]g\}")
"""A number with up to three digits, which becomes 3.3e+02 above 330."""


def test_no_sentence_writes_a_count_without_its_singular() -> None:
    counts = {m for line in lines_of("clients", "daemon") for m in COUNT.findall(line)}

    found = {
        (name, noun) for name, noun in counts if not name.isupper() and "join_names" not in name
    }
    assert found == {("size", "samples")}  # a text


def test_no_sentence_writes_a_large_number_with_a_power_of_ten() -> None:
    assert [line for line in lines_of("clients") if FEW_DIGITS.search(line)] == []


def lines_of(*rooms: str) -> list[str]:
    """Return the lines of code of packages that contain an f-string, without examples."""
    root = Path(__file__).parents[3]
    texts = (path.read_text() for room in rooms for path in sorted((root / room).rglob("*.py")))
    lines = (line.strip() for text in texts for line in text.splitlines())
    return [x for x in lines if ('f"' in x or "f'" in x) and not x.startswith((">>>", "... "))]
