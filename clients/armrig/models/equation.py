"""A fit in words: its equation with standard deviations, its figures and its verdict."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING

from armrig.numerics.whiteness import WHITE_LEVEL

if TYPE_CHECKING:
    from armrig.models.fit import Fit


def described(fit: Fit) -> str:
    """Return the fit as a few lines of text."""
    orders = ", ".join(f"{name}={n}" for name, n in fit.orders.items())
    y = f"{fit.output} [{fit.unit}]" if fit.unit else fit.output
    u = f"u [{fit.input_unit}]" if fit.input_unit else "u"
    lines = [f"{fit.structure.upper()}({orders}): {u} to {y}, Ts {fit.Ts:g} s, N {fit.N}"]
    lines += [f"  {form(fit)}"]
    lines += [
        f"  {letter}(q) = {_polynomial(fit, letter)}" for letter in "ABCDF" if _has(fit, letter)
    ]
    if fit.integrator:
        lines.append(f"  {fit.integrating.upper()} has the factor 1 - q^-1 by construction")
    lines.append(
        f"  fit {fit.fit_percent:.2f} % one step ahead on estimation data, "
        f"loss {fit.loss:.4g}, FPE {fit.fpe:.4g}, AIC {fit.aic:.5g}"
    )
    lines.append(f"  {verdict(fit)}")
    if fit.starts:
        how = "agree" if fit.agreed else "DISAGREE, the best was taken"
        ends = ", ".join(f"{s.name} {s.loss:.6g}" for s in fit.starts)
        lines.append(f"  starts {how}: {ends}" + ("" if fit.converged else " (NOT CONVERGED)"))
    lines += [f"  warning: {w}" for w in fit.warnings]
    return "\n".join(lines)


def form(fit: Fit) -> str:
    """Return the model's equation, polynomials by their letters."""
    left = "A(q) y(t)" if _has(fit, "A") else "y(t)"
    driven = "B(q)/F(q)" if _has(fit, "F") else "B(q)"
    noise = {
        (False, False): "e(t)",
        (True, False): "C(q) e(t)",
        (False, True): "1/D(q) e(t)",
        (True, True): "C(q)/D(q) e(t)",
    }[_has(fit, "C"), _has(fit, "D")]
    if fit.structure == "iv4":
        noise = "v(t)"
    return f"{left} = {driven} u(t) + {noise}"


def _has(fit: Fit, letter: str) -> bool:
    return letter == "B" or getattr(fit, letter).size > 1


def _polynomial(fit: Fit, letter: str) -> str:
    part = fit.slice_of(letter.lower())
    first = fit.nk if letter == "B" else 1
    text = "" if letter == "B" else "1"
    for k, (value, std) in enumerate(zip(fit.theta[part], fit.std[part], strict=True)):
        sign = ("-" if value < 0 else "") if not text else (" - " if value < 0 else " + ")
        power = f" q^-{first + k}" if first + k else ""
        text += f"{sign}{abs(value):.5g} (±{std:.2g}){power}"
    return text


def verdict(fit: Fit) -> str:
    """Return whether the residuals are white, and which deviation to trust then."""
    if isnan(fit.whiteness):  # too few samples, or no residual at all
        return "residuals: too few, or all zero, to test"
    if fit.whiteness >= WHITE_LEVEL:
        return f"residuals white (p = {fit.whiteness:.2g}): trust std"
    return f"residuals NOT white (p = {fit.whiteness:.2g}): trust std_robust, not std"
