"""Texts about a model: equation, and for an estimated model also quality and warnings."""

from __future__ import annotations

from math import isnan

from armrig.models.estimate import Estimate
from armrig.models.model import Model, Vector


def described(fit: Estimate) -> str:
    """Return an estimated model as a few lines of text."""
    lines = [
        heading(fit),
        *equations(fit, fit.std),
        f"  fit {fit.fit_percent:.2f} % one step ahead on estimation data, "
        f"loss {fit.loss:.4g}, FPE {fit.fpe:.4g}, AIC {fit.aic:.5g}",
        f"  {whiteness_sentence(fit)}",
    ]
    if fit.starts:
        how = "agree" if fit.agreed else "DISAGREE, the best was taken"
        ends = ", ".join(f"{s.name} {s.loss:.6g}" for s in fit.starts)
        lines.append(f"  starts {how}: {ends}" + ("" if fit.converged else " (NOT CONVERGED)"))
    return "\n".join([*lines, *(f"  warning: {w}" for w in fit.warnings)])


def heading(model: Model) -> str:
    """Return a line with structure, orders, signals, Ts and, for an estimate, number of samples."""
    return f"{model.heading}: {signals(model)}"


def signals(model: Model) -> str:
    """Return a line with signals, sampling time and, for an estimate, number of samples."""
    used = f", N {model.N}" if isinstance(model, Estimate) else ""
    return f"{input_and_output(model)}{used}"


def input_and_output(model: Model) -> str:
    """Return a line with the signals and the sampling time."""
    u, y = _with_unit("u", model.input_unit), _with_unit(model.output, model.unit)
    return f"{u} to {y}, Ts {model.Ts:g} s"


def equations(model: Model, std: Vector | None = None) -> list[str]:
    """Return lines with the equation and the polynomials, with standard deviations if given."""
    lines = [f"  {form(model)}"]
    lines += [f"  {letter}(q) = {_polynomial(model, letter, std)}" for letter in letters(model)]
    if model.integrator:
        lines.append(f"  {model.integrating.upper()} has the factor 1 - q^-1 by construction")
    return lines


def form(model: Model) -> str:
    """Return the model's equation with the letters of its polynomials."""
    known = letters(model)
    left = "A(q) y(t)" if "A" in known else "y(t)"
    driven = "B(q)/F(q)" if "F" in known else "B(q)"
    noise = {
        (False, False): "e(t)",
        (True, False): "C(q) e(t)",
        (False, True): "1/D(q) e(t)",
        (True, True): "C(q)/D(q) e(t)",
    }["C" in known, "D" in known]
    if isinstance(model, Estimate) and model.structure in ("iv4", "channel"):
        noise = "v(t)"
    return f"{left} = {driven} u(t) + {noise}"


def letters(model: Model) -> list[str]:
    """Return the letters of B and of the polynomials that are not 1, "A" … "F"."""
    return [name for name in "ABCDF" if name == "B" or model.polynomial(name.lower()).size > 1]


def _polynomial(model: Model, letter: str, std: Vector | None) -> str:
    part = model.slice_of(letter.lower())
    first = model.nk if letter == "B" else 1
    text = "" if letter == "B" else "1"
    for k, value in enumerate(model.theta[part]):
        sign = ("-" if value < 0 else "") if not text else (" - " if value < 0 else " + ")
        deviation = "" if std is None else f" (±{std[part][k]:.2g})"
        power = f" q^-{first + k}" if first + k else ""
        text += f"{sign}{abs(value):.5g}{deviation}{power}"
    return text


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def whiteness_sentence(fit: Estimate, std: str = "std", robust: str = "std_robust") -> str:
    """Return a text with the result of the whiteness test and the standard deviation to trust."""
    of = "IV4's prewhitened residuals" if fit.structure == "iv4" else "residuals"
    if isnan(fit.whiteness):
        return f"{of} {fit.white}"
    if fit.trusts_robust:
        return f"{of} {fit.white}: trust {robust}, not {std}"
    of_what = "" if fit.trusts_coefficients else " of the responses, not of the coefficients"
    return f"{of} {fit.white}: trust {std}{of_what}"
