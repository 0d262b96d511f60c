"""Numbers with their units, as a reader wants them."""

from __future__ import annotations

import numpy as np

NBSP = "\u00a0"  # between a number and its unit


def places(std: float) -> int:
    """Return the decimals that show two digits of `std`."""
    return 5 if not np.isfinite(std) or std <= 0 else max(0, 1 - int(np.floor(np.log10(std))))


def fixed(value: float, decimals: int) -> str:
    """Return a number with so many decimals."""
    return minus(f"{value:.{min(decimals, 12)}f}")


def minus(text: str) -> str:
    """Return the text with the sign for minus in place of the hyphen."""
    return text.replace("-", "\u2212")


def number(x: float) -> str:
    """Return a number with three digits, or all before the point."""
    return minus(f"{x:.3g}" if abs(x) < 1000 else f"{x:.0f}")


def power(x: float) -> str:
    """Return a small number as 1.23·10⁻⁵."""
    if not 0 < abs(x) < 1e-3:
        return number(x)
    exponent = int(np.floor(np.log10(abs(x))))
    raised = str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{x / 10.0**exponent:.2f}·10{raised}"


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
    return "–" if np.isnan(p) else "< 0.001" if p < 0.001 else f"{p:.3f}"


def plural(n: int, noun: str) -> str:
    """Return a number with its noun: 1 sample, 2 samples."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"
