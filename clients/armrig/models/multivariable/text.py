"""Text of a model with several inputs and outputs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from armrig.numerics.quantities import plural

if TYPE_CHECKING:
    from armrig.models.multivariable.fit import MultivariableFit


def described(fit: MultivariableFit) -> str:
    """Return a model as text: a line with the fit of each output, and the poles."""
    inputs = ", ".join(_with_unit(*x) for x in zip(fit.inputs, fit.input_units, strict=True))
    lines = [
        f"{fit.label}: {inputs} to {plural(len(fit.outputs), 'output')}, Ts {fit.Ts:g} s, "
        f"{fit.theta.size} parameters",
    ]
    width = max(len(_with_unit(*x)) for x in zip(fit.outputs, fit.units, strict=True))
    for name, unit, q in zip(fit.outputs, fit.units, fit.quality, strict=True):
        lines.append(
            f"  {_with_unit(name, unit):{width}}  fit {q.fit_percent:6.2f} % one step ahead, loss "
            f"{q.loss:.4g}, N {q.N}, residuals {q.white}"
        )
    if fit.ny > 1:
        lines.append(f"  correlation of the noise: {_correlations(fit)}")
    poles = fit.poles()
    parts = zip(poles.values, np.asarray(poles.std), strict=True)
    lines.append("  poles: " + ", ".join(_pole(z, std) for z, std in parts if z.imag >= 0))
    if fit.starts and not fit.converged:
        lines.append("  NOT CONVERGED")
    return "\n".join([*lines, *(f"  warning: {w}" for w in fit.warnings)])


def _correlations(fit: MultivariableFit) -> str:
    std = np.sqrt(np.diag(fit.noise_covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        r = fit.noise_covariance / np.outer(std, std)
    return ", ".join(
        f"{fit.outputs[i]} and {fit.outputs[k]} {r[i, k]:.2f}"
        for i in range(fit.ny)
        for k in range(i + 1, fit.ny)
    )


def _pole(z: complex, std: float) -> str:
    sign = f" ± {z.imag:.4f}i" if z.imag > 0 else ""
    return f"{z.real:.4f}{sign} (std {std:.2g})"


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
