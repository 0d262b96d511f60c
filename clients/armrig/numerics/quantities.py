"""Numbers with their units, and lists of names, as a reader wants them."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, isfinite, isnan, log10

_MOST_DECIMALS = 6
_MOST_BESIDE_ONE = 9

_UNITS_OF_TIME = (
    (3 * 86400.0, 86400.0, "days"),
    (3 * 3600.0, 3600.0, "h"),
    (1000.0, 60.0, "min"),
    (1.0, 1.0, "s"),
    (1e-3, 1e-3, "ms"),
    (0.0, 1e-6, "µs"),
)
"""From how many seconds on, how many seconds, and the name of each."""

NBSP = "\u00a0"  # between a number and its unit


def places(std: float) -> int:
    """Return the decimals that show two digits of `std`."""
    return 5 if not isfinite(std) or std <= 0 else max(0, 1 - floor(log10(std)))


def with_std(value: float, std: float) -> str:
    """Return a number ± its standard deviation; the number alone where that is not known."""
    if not (std > 0 and isfinite(std)):
        return f"{value:.5g}"
    decimals = places(std)
    if decimals > _MOST_DECIMALS:
        return f"{value:.6e} ± {std:.1e}"
    return f"{value:.{decimals}f} ± {std:.{decimals}f}"


def near_one(value: float, std: float) -> str:
    """Return a number that is read best beside 1, ± its standard deviation."""
    decimals = places(std)
    if decimals <= _MOST_DECIMALS:
        return with_std(value, std)
    return f"{value:.{min(decimals, _MOST_BESIDE_ONE)}f} ± {std:.1e}"


def scaled(value: float, std: float, unit: str) -> str:
    """Return a number ± its standard deviation with a power of ten: (1.6989 ± 0.0016)·10⁻³ m."""
    exponent = floor(log10(abs(value))) if value and isfinite(value) else 0
    if -3 < exponent < 4:
        return f"{minus(with_std(value, std))}{NBSP}{unit}".rstrip()
    # An exponent divisible by three has a name.
    exponent = 3 * floor(exponent / 3)
    text = with_std(value / 10.0**exponent, std / 10.0**exponent)
    return f"({minus(text)})·10{raised(exponent)}{NBSP}{unit}".rstrip()


def with_range(value: float, low: float, high: float) -> str:
    """Return a number with its range, as 1.23 (1.11 … 1.40)."""
    decimals = min(places((high - low) / 4), _MOST_DECIMALS)
    return f"{value:.{decimals}f} ({low:.{decimals}f} … {high:.{decimals}f})"


def fixed(value: float, decimals: int) -> str:
    """Return a number with so many decimals."""
    return minus(f"{value:.{min(decimals, 12)}f}")


def minus(text: str) -> str:
    """Return the text with the sign for minus in place of the hyphen."""
    return text.replace("-", "\u2212")


def number(x: float) -> str:
    """Return a number with three digits, or all before the point."""
    return minus(three_digits(x))


def three_digits(x: float) -> str:
    """Return a number with three digits, or all before the point, a hyphen for minus."""
    return f"{x:.3g}" if abs(x) < 999.5 else f"{x:.0f}"


def power(x: float) -> str:
    """Return a small number as 1.23·10⁻⁵."""
    if not 0 < abs(x) < 1e-3:
        return number(x)
    exponent = floor(log10(abs(x)))
    return f"{minus(f'{x / 10.0**exponent:.2f}')}·10{raised(exponent)}"


def raised(exponent: int) -> str:
    """Return an exponent in raised digits."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def microseconds(x: float) -> str:
    """Return a time given in µs."""
    return f"{number(x)}{NBSP}µs"


def milliseconds(seconds: float) -> str:
    """Return a time given in s."""
    return f"{seconds * 1e3:g}{NBSP}ms"


def percent(x: float) -> str:
    """Return a percentage; one near 100 with the decimals that tell good from better."""
    if 90 < x <= 100:
        return f"{x:.2f}{NBSP}%"
    return f"{number(x)}{NBSP}%"


def error(x: float, unit: str) -> str:
    """Return an error in its unit; small angles in mrad."""
    if unit == "rad" and abs(x) < 0.1:
        return f"{number(1e3 * x)}{NBSP}mrad"
    return f"{number(x)}{NBSP}{unit}"


def p_relation(p: float) -> str:
    """Return a p value with its sign of relation, to stand after a p."""
    return "< 0.001" if p < 0.001 else f"= {p:.3f}"


def p_value(p: float) -> str:
    """Return a p value, to stand in a table."""
    return "–" if isnan(p) else "< 0.001" if p < 0.001 else f"{p:.3f}"


def times(*seconds: float) -> str:
    """Return times in one unit that suits the longest: 20.6 ms, 32.5 … 46.4 ms, 2.78 h."""
    longest = max(map(abs, seconds))
    scale, unit = next((s, name) for least, s, name in _UNITS_OF_TIME if longest >= least)
    return f"{' … '.join(three_digits(x / scale) for x in seconds)} {unit}"


def plural(n: int, noun: str) -> str:
    """Return a number with its noun: 1 sample, 2 samples."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def listed(names: Sequence[str]) -> str:
    """Return a list as a sentence has it: a, b and c."""
    *most, last = names
    return f"{', '.join(most)} and {last}" if most else last
