"""Models made by hand, without an estimate, for tests of their texts and numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from armrig.models.fit import Fit


def made(
    *,
    A: Sequence[float] = (1.0,),
    B: Sequence[float] = (0.0, 1.0),
    C: Sequence[float] = (1.0,),
    D: Sequence[float] = (1.0,),
    F: Sequence[float] = (1.0,),
    nk: int = 1,
    std: Sequence[float] = (),
    **fields: Any,
) -> Fit:
    """Return a fit with these polynomials; the robust deviations are twice the ordinary ones."""
    d = len(A) + len(B) + len(C) + len(D) + len(F) - 4 - nk
    covariance = np.diag(np.square(std)) if len(std) else np.zeros((d, d))
    values: dict[str, Any] = {
        "structure": "pem",
        "covariance": covariance,
        "covariance_robust": 4 * covariance,
        "noise_variance": 0.04,
        "loss": 0.03,
        "N": 100,
        "Ts": 0.1,
        "fit_percent": 91.234,
        "whiteness": 0.5,
        "whiteness_test": "portmanteau test",
        "output": "alpha",
        "unit": "rad",
        "input_unit": "V",
    }
    polynomials = {"A": A, "B": B, "C": C, "D": D, "F": F}
    arrays = {letter: np.array(p, dtype=float) for letter, p in polynomials.items()}
    return Fit(**(values | arrays | {"nk": nk} | fields))
