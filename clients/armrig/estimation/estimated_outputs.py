"""Model from the estimates of its outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from armrig.data.dataset import Dataset, Signals
from armrig.models.fit import Fit
from armrig.models.polynomials import Polynomials
from armrig.numerics.inference import OutputResiduals, Score, infer
from armrig.numerics.polynomial import Array


def origin(data: Dataset | Signals) -> dict[str, Any]:
    """Return names, units, sampling time and history of the data, as fields of a fit."""
    names = ("inputs", "outputs", "input_units", "units", "source", "history", "digest")
    signals = data.signals()
    return {"Ts": signals.Ts} | {name: getattr(signals, name) for name in names}


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
    data: Dataset | Signals,
    estimates: Sequence[EstimatedOutput],
    W: Array,
    *,
    structure: str,
    score: Score,
    rounding: float = 0.0,
    **fields: Any,
) -> Fit:
    """Return the model with its covariance, loss and tests of whiteness, and other `fields`.

    W (d, r) transforms the influences of the residuals to the d estimated coefficients.
    """
    names = estimates[0].polynomials
    inference = infer(
        [*zip(*(estimate.residuals for estimate in estimates), strict=True)],
        W,
        parameters=[estimate.parameters for estimate in estimates],
        score=score,
        rounding=rounding,
    )
    return Fit(
        structure=structure,
        form=Polynomials(
            **{x: tuple(estimate.polynomials[x] for estimate in estimates) for x in names}
        ),
        **inference.transformed(np.vstack([estimate.J for estimate in estimates])).fields(),
        **origin(data),
        **fields,
    )
