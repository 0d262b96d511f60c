"""A frequency response estimated without a structure."""

from __future__ import annotations

import numpy as np
from armrig.models.spectral_estimate import SpectralEstimate


def test_an_unknown_frequency_does_not_cost_the_phase_after_it() -> None:
    """A delay of three samples turns the phase by more than a circle; one frequency is NaN."""
    omega = np.linspace(0.1, 3.0, 30)
    delay = -3 * np.where(np.arange(30) == 10, np.nan, omega)
    unknown = np.full(30, np.nan)

    estimate = SpectralEstimate(
        omega=omega,
        G=np.exp(1j * delay),
        std_magnitude=unknown,
        std_phase=unknown,
        method="by hand",
        integrator=False,
        N=60,
        Ts=1.0,
        output="y",
        unit="",
        input_unit="V",
        source="",
    )

    np.testing.assert_allclose(estimate.phase, delay)
