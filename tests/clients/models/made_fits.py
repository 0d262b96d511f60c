"""Models and frequency responses made by hand, for tests of their texts and numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from armrig.models.fit import Fit
from armrig.models.spectral_estimate import SpectralEstimate
from numpy.typing import NDArray


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


def made_estimate(omega: NDArray[np.float64], G: Any, **fields: Any) -> SpectralEstimate:
    """Return an estimate by hand, without deviations unless given."""
    unknown = np.full(omega.size, np.nan)
    values: dict[str, Any] = {
        "std_magnitude": unknown,
        "std_phase": unknown,
        "method": "by hand, Hann",
        "integrator": False,
        "N": 60,
        "Ts": 0.1,
        "output": "theta_1",
        "unit": "rad",
        "input_unit": "V",
        "source": "",
    }
    return SpectralEstimate(omega=omega, G=np.asarray(G, complex), **(values | fields))
