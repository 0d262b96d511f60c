"""95 % regions of poles, zeros and responses, which are valid even if the linearisation is poor.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 9.6 (from theta to the transfer
   function), and chapter 16 on the use of the regions in validation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armrig.models.parameter_draws import Draws, drawn, polynomial_of, roots_of
from armrig.numerics.confidence_regions import Band, Region, band, regions

if TYPE_CHECKING:
    from armrig.models.fit import Fit
    from armrig.models.responses import FrequencyResponse, StepResponse

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Complex = NDArray[np.complex128]


def pole_regions(model: Fit, draws: Draws | None = None) -> list[Region]:
    """Return the 95 % region of each pole, in the order of `model.poles()`.

    The regions of the roots of A and of the roots of F are computed separately.
    """
    draws = drawn(model) if draws is None else draws
    poles = model.poles()
    n = model.A.size - 1
    found = []
    for letter, part in (("a", slice(None, n)), ("f", slice(n, None))):
        samples = None if draws is None else roots_of(model, draws.theta, letter)
        found += regions(poles.values[part], poles.covariance[part], samples)
    return found


def zero_regions(model: Fit, draws: Draws | None = None) -> list[Region]:
    """Return the 95 % region of each zero, in the order of `model.zeros()`."""
    draws = drawn(model) if draws is None else draws
    zeros = model.zeros()
    samples = None if draws is None else roots_of(model, draws.theta, "b")
    if (
        samples is not None and samples.shape[1] != zeros.values.size
    ):  # the first b is 0, an additional delay
        samples = None
    return regions(zeros.values, zeros.covariance, samples)


def frequency_bands(
    model: Fit, answer: FrequencyResponse, draws: Draws | None
) -> tuple[Band, Band]:
    """Return the 95 % band of |G| and the 95 % band of the phase of G.

    The band of the phase, in rad, is relative to the phase of `answer`. Without draws the bands are
    linearised.
    """
    G = answer.G
    magnitudes = phases = None
    if draws is not None:
        of_draws = frequency_responses(model, draws.theta, answer.omega)
        with np.errstate(divide="ignore", invalid="ignore"):
            magnitudes, phases = np.abs(of_draws), np.angle(of_draws / G)
    return (
        band(np.abs(G), answer.std_magnitude, magnitudes, least=0.0),
        band(np.zeros(G.size), answer.std_phase, phases),
    )


def step_band(model: Fit, answer: StepResponse, draws: Draws | None) -> Band:
    """Return the 95 % band of a step response; without draws the band is linearised."""
    if draws is None:
        return band(answer.y, answer.std, None)
    samples = step_responses(model, draws.theta, answer.y.size + answer.rate)
    if answer.rate:
        samples = np.diff(samples, axis=1) / model.Ts
    return band(answer.y, answer.std, samples)


def frequency_responses(model: Fit, theta: Matrix, omega: ArrayLike) -> Complex:
    """Return G (m, n) of each draw in theta (m, d) at omega (n,), in rad/s."""
    x = np.exp(-1j * np.atleast_1d(np.asarray(omega, np.float64)) * model.Ts)
    G = polynomial_of(model, theta, "b") @ _powers(x, model.B.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        for letter in "af":
            p = polynomial_of(model, theta, letter)
            if letter == model.integrating:  # exact at omega = 0, as in `Fit.frequency_response`
                p = np.cumsum(p, axis=1)[:, :-1]
                G = G / (1 - x)
            G = G / (p @ _powers(x, p.shape[1]))
    return np.asarray(G)


def step_responses(model: Fit, theta: Matrix, n: int) -> Matrix:
    """Return the first n samples (m, n) of the unit step response of each draw in theta (m, d)."""
    B = polynomial_of(model, theta, "b")
    y = np.cumsum(np.pad(B, ((0, 0), (0, max(0, n - B.shape[1]))))[:, :n], axis=1)
    for letter in "af":
        p = polynomial_of(model, theta, letter)
        with np.errstate(over="ignore", invalid="ignore"):
            for t in range(n):
                for k in range(1, min(p.shape[1] - 1, t) + 1):
                    y[:, t] -= p[:, k] * y[:, t - k]
    return np.asarray(y)


def _powers(x: Complex, n: int) -> Complex:
    return np.asarray(x[None, :] ** np.arange(n)[:, None])
