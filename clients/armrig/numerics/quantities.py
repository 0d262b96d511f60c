"""Text for numbers with units, and for lists of names."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, isfinite, isnan, log10

from armrig_core.process.printable import plural as plural

_MAX_DECIMALS = 6
_MAX_WITHOUT_POWER = 1e9
_MAX_DECIMALS_NEAR_1 = 9

_UNITS_OF_TIME = (
    (3 * 86400.0, 86400.0, "days"),
    (3 * 3600.0, 3600.0, "h"),
    (1000.0, 60.0, "min"),
    (1.0, 1.0, "s"),
    (1e-3, 1e-3, "ms"),
    (0.0, 1e-6, "µs"),
)
"""Shortest duration in s for which each unit is used, the unit in s, and the name of the unit."""

NBSP = "\u00a0"  # no-break space between a number and its unit


def places(std: float) -> int:
    """Return the number of decimals that shows two digits of `std`."""
    return 5 if not isfinite(std) or std <= 0 else max(0, 1 - floor(log10(std)))


def with_std(value: float, std: float) -> str:
    """Return `value ± std` with two digits of `std`, or the value alone if `std` is not known."""
    if not (std > 0 and isfinite(std)):
        return f"{value:.5g}"
    decimals = places(std)
    if decimals > _MAX_DECIMALS:
        return f"{value:.6e} ± {std:.1e}"
    return f"{value:.{decimals}f} ± {std:.{decimals}f}"


def near_one(value: float, std: float) -> str:
    """Return `value ± std` for a value near 1, without a power of ten in the value."""
    decimals = places(std)
    if decimals <= _MAX_DECIMALS:
        return with_std(value, std)
    return f"{value:.{min(decimals, _MAX_DECIMALS_NEAR_1)}f} ± {std:.1e}"


def with_unit(value: float, std: float, unit: str) -> str:
    """Return `value ± std` with a power of ten and a unit: (1.6989 ± 0.0016)·10⁻³ m."""
    exponent = floor(log10(abs(value))) if value and isfinite(value) else 0
    if -3 < exponent < 4:
        return f"{minus(with_std(value, std))}{NBSP}{unit}".rstrip()
    # Only exponents divisible by three, because these have SI prefixes.
    exponent = 3 * floor(exponent / 3)
    text = with_std(value / 10.0**exponent, std / 10.0**exponent)
    return f"({minus(text)})·10{superscript(exponent)}{NBSP}{unit}".rstrip()


def with_range(value: float, low: float, high: float) -> str:
    """Return a number with its range: 1.23 (1.11 … 1.40)."""
    decimals = min(places((high - low) / 4), _MAX_DECIMALS)
    return f"{value:.{decimals}f} ({low:.{decimals}f} … {high:.{decimals}f})"


def with_decimals(value: float, decimals: int) -> str:
    """Return a number with a fixed number of decimals, at most 12."""
    return minus(f"{value:.{min(decimals, 12)}f}")


def minus(text: str) -> str:
    """Return the text with minus signs instead of hyphens."""
    return text.replace("-", "\u2212")


def number(x: float, n: int = 3) -> str:
    """Return a number as `digits` does, with a minus sign instead of a hyphen."""
    return minus(digits(x, n))


def digits(x: float, n: int) -> str:
    """Return a number with n significant digits: 3.3, 330; from 10⁹ on, as a power of ten."""
    return f"{x:.0f}" if 10**n - 0.5 <= abs(x) < _MAX_WITHOUT_POWER else f"{x:.{n}g}"


def power(x: float) -> str:
    """Return a number with three digits; below 0.001 with a power of ten: 1.23·10⁻⁵."""
    if not 0 < abs(x) < 1e-3:
        return number(x)
    exponent = floor(log10(abs(x)))
    return f"{minus(f'{x / 10.0**exponent:.2f}')}·10{superscript(exponent)}"


def superscript(exponent: int) -> str:
    """Return an exponent in superscript digits."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def microseconds(x: float) -> str:
    """Return the text of a time in µs, given in µs."""
    return f"{number(x)}{NBSP}µs"


def milliseconds(seconds: float) -> str:
    """Return the text of a time given in s, in ms; from 1 s on, in s."""
    return f"{seconds:g}{NBSP}s" if seconds >= 1 else f"{seconds * 1e3:g}{NBSP}ms"


def percent(x: float) -> str:
    """Return a percentage with three digits, or with two decimals between 90 and 100."""
    if 90 < x <= 100:
        return f"{x:.2f}{NBSP}%"
    return f"{number(x)}{NBSP}%"


def error(x: float, unit: str) -> str:
    """Return the text of an error and its unit; an angle below 0.1 rad is given in mrad."""
    if unit == "rad" and abs(x) < 0.1:
        return f"{number(1e3 * x)}{NBSP}mrad"
    return f"{number(x)}{NBSP * bool(unit)}{unit}"


def p_relation(p: float) -> str:
    """Return the text after the letter p: "= 0.012" or "< 0.001"."""
    return "< 0.001" if p < 0.001 else f"= {p:.3f}"


def p_value(p: float) -> str:
    """Return a p value for a table."""
    return "–" if isnan(p) else "< 0.001" if p < 0.001 else f"{p:.3f}"


def times(*seconds: float) -> str:
    """Return times in a unit that suits the longest time: 20.6 ms, 32.5 … 46.4 ms, 2.78 h."""
    longest = max(map(abs, seconds))
    scale, unit = next((s, name) for least, s, name in _UNITS_OF_TIME if longest >= least)
    return f"{' … '.join(digits(x / scale, 3) for x in seconds)} {unit}"


def join_names(names: Sequence[str]) -> str:
    """Return names as a list in a sentence: a, b and c."""
    *most, last = names
    return f"{', '.join(most)} and {last}" if most else last
