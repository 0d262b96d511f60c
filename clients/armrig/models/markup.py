"""A fit as LaTeX or Typst for a report, and as HTML for a notebook."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from math import isfinite
from typing import TYPE_CHECKING

from armrig.models.equation import form, letters, whiteness_sentence

if TYPE_CHECKING:
    from armrig.models.fit import Fit


def latex(fit: Fit) -> str:
    r"""Return the equation as an `aligned` block, each coefficient with its standard deviation."""
    equation = form(fit).replace(") e(t)", r")\,e(t)").replace("1/D(q)", r"\frac{1}{D(q)}")
    for ratio in ("B(q)/F(q)", "C(q)/D(q)"):
        equation = equation.replace(ratio, rf"\frac{{{ratio[:4]}}}{{{ratio[5:]}}}")
    equation = equation.replace(") y(t)", r")\,y(t)").replace(" u(t)", r"\,u(t)")
    rows = [equation.replace(" = ", " &= ")]
    rows += [rf"{letter}(q) &= {_polynomial(fit, letter, _LATEX)}" for letter in letters(fit)]
    body = " \\\\\n".join(rows)
    return f"\\begin{{aligned}}\n{body}\n\\end{{aligned}}"


def typst(fit: Fit) -> str:
    """Return the equation as a block of Typst mathematics, with the content of `latex`."""
    rows = [typst_form(fit).replace(" = ", " &= ")]
    rows += [f"{letter}(q) &= {_polynomial(fit, letter, _TYPST)}" for letter in letters(fit)]
    return "$ " + " \\\n  ".join(rows) + " $"


def typst_form(model: Fit) -> str:
    """Return the equation in Typst mathematics, with the letters of the polynomials."""
    return form(model).replace(") ", ") thin ").replace("thin =", "=").replace("thin +", "+")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Notation:
    """Templates of a coefficient in LaTeX or Typst."""

    term: str
    """Template of value, standard deviation and power."""
    power: str
    """Template of a power of q."""
    times_ten: str
    """Template of mantissa and exponent."""


_LATEX = _Notation(
    term=r"({value} \pm {std}){power}",
    power=r"\,q^{{-{lag}}}",
    times_ten=r"{mantissa} \cdot 10^{{{exponent}}}",
)
_TYPST = _Notation(
    term="({value} plus.minus {std}){power}",
    power=" thin q^(-{lag})",
    times_ten="{mantissa} dot 10^({exponent})",
)


def _polynomial(fit: Fit, letter: str, notation: _Notation) -> str:
    part = fit.slice_of(letter.lower())
    first = fit.nk if letter == "B" else 1
    text = "" if letter == "B" else "1"
    for k, (value, std) in enumerate(zip(fit.theta[part], fit.std[part], strict=True)):
        sign = ("-" if value < 0 else "") if not text else (" - " if value < 0 else " + ")
        term = notation.term.format(
            value=_number(abs(value), 5, notation),
            std=_number(std, 2, notation),
            power=notation.power.format(lag=first + k) if first + k else "",
        )
        text += f"{sign}{term}"
    return text


def _number(x: float, digits: int, notation: _Notation) -> str:
    if not isfinite(x):
        return "?"
    mantissa, _, exponent = f"{x:.{digits}g}".partition("e")
    if not exponent:
        return mantissa
    return notation.times_ten.format(mantissa=mantissa, exponent=int(exponent))


def html(fit: Fit) -> str:
    """Return equation, coefficients and quality as HTML; MathJax renders the equation.

    A model of several signals, and a model that was not estimated, are preformatted text.
    """
    if (fit.ny, fit.nu) != (1, 1) or not fit.quality:
        return f"<pre>{escape(repr(fit))}</pre>"
    rows = "".join(
        f"<tr><td>{name}</td><td>{value:.5g}</td><td>{std:.2g}</td><td>{robust:.2g}</td></tr>"
        for name, value, std, robust in zip(
            fit.names, fit.theta, fit.std, fit.std_robust, strict=True
        )
    )
    said = "".join(f"<li>{escape(warning)}</li>" for warning in fit.warnings)
    return (
        f"<p><b>{fit.heading}</b>, Ts {fit.Ts:g} s, N {fit.N}</p>"
        f"$$\n{latex(fit)}\n$$"
        "<table><tr><th>coefficient</th><th>estimate</th><th>std</th><th>std_robust</th></tr>"
        f"{rows}</table>"
        f"<p>Fit {fit.fit_percent:.2f} % one step ahead on estimation data, loss {fit.loss:.4g}; "
        f"{escape(whiteness_sentence(fit))}.</p>" + (f"<ul>{said}</ul>" if said else "")
    )
