"""A fit as LaTeX, for a report, and as HTML, for a notebook."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from armrig.equation import form, verdict

if TYPE_CHECKING:
    from armrig.fit import Fit


def latex(fit: Fit) -> str:
    r"""Return the model as an `aligned` block, each coefficient with its standard deviation."""
    equation = form(fit).replace(") e(t)", r")\,e(t)").replace("1/D(q)", r"\frac{1}{D(q)}")
    for ratio in ("B(q)/F(q)", "C(q)/D(q)"):
        equation = equation.replace(ratio, rf"\frac{{{ratio[:4]}}}{{{ratio[5:]}}}")
    equation = equation.replace(") y(t)", r")\,y(t)").replace(" u(t)", r"\,u(t)")
    rows = [equation.replace(" = ", " &= ")]
    rows += [
        rf"{letter}(q) &= {_polynomial(fit, letter)}"
        for letter in "ABCDF"
        if letter == "B" or getattr(fit, letter).size > 1
    ]
    body = " \\\\\n".join(rows)
    return f"\\begin{{aligned}}\n{body}\n\\end{{aligned}}"


def _polynomial(fit: Fit, letter: str) -> str:
    part = fit.slice_of(letter.lower())
    first = fit.nk if letter == "B" else 1
    text = "" if letter == "B" else "1"
    for k, (value, std) in enumerate(zip(fit.theta[part], fit.std[part], strict=True)):
        sign = ("-" if value < 0 else "") if not text else (" - " if value < 0 else " + ")
        power = rf"\,q^{{-{first + k}}}" if first + k else ""
        text += rf"{sign}({_number(abs(value), 5)} \pm {_number(std, 2)}){power}"
    return text


def _number(x: float, digits: int) -> str:
    mantissa, _, exponent = f"{x:.{digits}g}".partition("e")
    return rf"{mantissa} \cdot 10^{{{int(exponent)}}}" if exponent else mantissa


def html(fit: Fit) -> str:
    """Return equation, coefficients and verdict as HTML; the equation is for MathJax."""
    rows = "".join(
        f"<tr><td>{name}</td><td>{value:.5g}</td><td>{std:.2g}</td><td>{robust:.2g}</td></tr>"
        for name, value, std, robust in zip(
            fit.names, fit.theta, fit.std, fit.std_robust, strict=True
        )
    )
    orders = ", ".join(f"{name}={n}" for name, n in fit.orders.items())
    said = "".join(f"<li>{escape(warning)}</li>" for warning in fit.warnings)
    return (
        f"<p><b>{fit.structure.upper()}({orders})</b>, Ts {fit.Ts:g} s, N {fit.N}</p>"
        f"$$\n{latex(fit)}\n$$"
        "<table><tr><th>coefficient</th><th>estimate</th><th>std</th><th>std_robust</th></tr>"
        f"{rows}</table>"
        f"<p>Fit {fit.fit_percent:.2f} % one step ahead on estimation data, loss {fit.loss:.4g}; "
        f"{escape(verdict(fit))}.</p>" + (f"<ul>{said}</ul>" if said else "")
    )
