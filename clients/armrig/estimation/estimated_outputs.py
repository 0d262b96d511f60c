"""Model of several inputs or outputs, from the estimates of its outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from armrig.data.finding import EstimateFinding
from armrig.data.signals import Signals
from armrig.estimation.data_checks import instability, origin
from armrig.estimation.multivariable.inference import OutputResiduals, inferred
from armrig.models.estimate import Start
from armrig.models.multivariable.fit import MultivariableFit
from armrig.models.multivariable.polynomials import Polynomials
from armrig.numerics.inference import Score
from armrig.numerics.polynomial import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatedOutput:
    """Polynomials and residuals of one output."""

    polynomials: dict[str, Any]
    """Fields A, B, C, D, F, nk and integrators of a row of `Polynomials`."""
    residuals: tuple[OutputResiduals, ...]
    """Residuals of each experiment."""
    parameters: float
    """Number of coefficients; a coefficient shared by k outputs counts 1/k."""
    J: Array
    """Derivatives of the coefficients of this output with respect to all estimated coefficients."""


def fit_of_outputs(
    data: Signals,
    estimates: Sequence[EstimatedOutput],
    *,
    name: str,
    orders: str,
    score: Score,
    findings: Sequence[EstimateFinding] = (),
    shared: bool = False,
    converged: bool = True,
    starts: Sequence[Start] = (),
) -> MultivariableFit:
    """Return the model with the covariance of all coefficients together."""
    form = Polynomials(
        **{
            field: tuple(one.polynomials[field] for one in estimates)
            for field in estimates[0].polynomials
        }
    )
    found = inferred(
        [*zip(*(one.residuals for one in estimates), strict=True)],
        parameters=[one.parameters for one in estimates],
        score=score,
    )
    J = np.vstack([one.J for one in estimates])
    fields = found.fields()
    for covariance in ("covariance", "covariance_robust"):
        fields[covariance] = J @ fields[covariance] @ J.T
    return MultivariableFit(
        structure=name,
        orders=orders,
        form=form,
        shared=shared,
        converged=converged,
        starts=tuple(starts),
        findings=(*findings, *instability(form)),
        **fields,
        **origin(data),
    )
