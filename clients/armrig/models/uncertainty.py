"""Draws of the parameters, and 95 % regions that are valid even if the linearisation is poor.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 9.3 (theta is asymptotically
   normal), section 9.6 (from theta to the transfer function), and chapter 16 on the use of the
   regions in validation.
.. [2] BIPM, *Evaluation of measurement data: Supplement 1 to the GUM, Propagation of distributions
   using a Monte Carlo method*, JCGM 101:2008.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armrig.models.state_space import Complex, Matrix
from armrig.numerics.confidence_regions import Band, Region, band, regions
from armrig.numerics.polynomial import stable, without_integrator

if TYPE_CHECKING:
    from armrig.models.fit import Fit
    from armrig.models.responses import FrequencyResponse, StepResponse


DRAWS = 1000
MAX_ROUNDS = 10
"""Largest number of rounds of n draws, if many draws are rejected."""
SEED = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Draws:
    """Accepted draws from N(theta, P), and the numbers of degenerate and unstable draws."""

    theta: Matrix
    """Parameters of the accepted draws, (n, d)."""
    asked: int
    """Number of draws made."""
    unstable: int
    """Number of draws rejected as unstable; 0 if the model itself is unstable."""
    degenerate: int
    """Number of draws rejected because a value is not finite or the first b is 0."""

    @property
    def left_out(self) -> str:
        """Text with the numbers of rejected draws, or ""."""
        counted = ((self.unstable, "unstable"), (self.degenerate, "degenerate"))
        return ", ".join(f"{n} of {self.asked} {reason}" for n, reason in counted if n)


def parameter_draws(model: Fit, *, n: int = DRAWS) -> Draws | None:
    """Return n draws of theta from N(theta, P), or None if nothing was estimated or P is not known.

    P is the trusted covariance of the model. With P = W W^T the draws are theta + W x, with x
    standard normal. The draws of x are pairs x and -x, scaled so that their covariance is exactly
    the unit matrix. The standard deviation of a response that is linear in theta is then exact. W
    is computed from the correlation matrix, so that the units of the parameters do not matter. If a
    polynomial has a root 1 by construction, only the coefficients of its other factor vary, so that
    the root stays 1 in each draw.

    n is even and more than twice the number of parameters. If half of the draws or more are
    rejected, up to 10 n draws are made. The generator has a fixed seed, so that a figure is
    reproducible.
    """
    P = model.trusted_covariance
    if not (np.isfinite(P).all() and P.any()):
        return None
    rng = np.random.default_rng(SEED)
    W = directions(model)
    polynomials = {"a": model.A, "f": model.F}
    if model.integrating:
        polynomials[model.integrating] = without_integrator(polynomials[model.integrating])
    model_is_stable = all(map(stable, polynomials.values()))
    kept: list[Matrix] = []
    asked = unstable = degenerate = 0
    while asked < MAX_ROUNDS * n and sum(len(x) for x in kept) < n:
        theta = model.theta + _normal(n, W.shape[1], rng) @ W.T
        finite = np.isfinite(theta).all(axis=1)
        finite &= np.abs(theta[:, model.slice_of("b").start]) > 0
        inside = finite & _stable(model, theta, finite) if model_is_stable else finite
        kept.append(theta[inside])
        asked += n
        unstable += int(np.count_nonzero(finite & ~inside))
        degenerate += int(np.count_nonzero(~finite))
        if len(kept[0]) > n / 2:
            break
    return Draws(theta=np.concatenate(kept), asked=asked, unstable=unstable, degenerate=degenerate)


def directions(model: Fit) -> Matrix:
    """Return W (d, r) with W W^T = P, the trusted covariance.

    Each column is a step of one standard deviation. W is computed from the correlation matrix of
    the free parameters, so that a root that is 1 by construction stays 1 along each column.
    """
    inward, outward = _integrator_maps(model)
    P = inward @ model.trusted_covariance @ inward.T
    std = np.sqrt(np.maximum(np.diag(P), 0.0))
    by = np.where(std > 0, std, 1.0)
    value, vector = np.linalg.eigh(P / np.outer(by, by))  # rounding can make a value negative
    return np.asarray(outward @ (std[:, None] * vector * np.sqrt(np.maximum(value, 0.0))))


def _stable(model: Fit, theta: Matrix, finite: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the draws with all poles, except one fixed at 1, inside the unit circle."""
    inside = np.ones(theta.shape[0], dtype=bool)
    for letter in "af":
        z = roots_of(model, theta, letter, finite)
        inside &= (np.abs(z[:, int(letter == model.integrating) :]) < 1).all(axis=1)
    return inside


def polynomial_of(model: Fit, theta: Matrix, letter: str) -> Matrix:
    """Return the coefficients of one polynomial, a row for each draw; B includes its nk zeros."""
    free = theta[:, model.slice_of(letter)]
    before = np.zeros((theta.shape[0], model.nk)) if letter == "b" else np.ones((theta.shape[0], 1))
    return np.hstack([before, free])


def roots_of(
    model: Fit, theta: Matrix, letter: str, finite: NDArray[np.bool_] | None = None
) -> Complex:
    """Return the roots of one polynomial of each draw, (n, order); a fixed root at 1 is first.

    The roots are the eigenvalues of the companion matrix, or NaN if `finite` is False for a draw.
    """
    p = polynomial_of(model, theta, letter)[:, model.nk if letter == "b" else 0 :]
    fixed = letter == model.integrating
    if fixed:
        p = np.cumsum(p, axis=1)[:, :-1]
    n, order = p.shape[0], p.shape[1] - 1
    z = np.full((n, order), np.nan, dtype=np.complex128)
    some = np.ones(n, dtype=bool) if finite is None else finite
    if order:
        companion = np.zeros((int(np.count_nonzero(some)), order, order))
        companion[:, 0, :] = -p[some, 1:] / p[some, :1]
        companion[:, np.arange(1, order), np.arange(order - 1)] = 1.0
        z[some] = np.linalg.eigvals(companion)
    return np.hstack([np.ones((n, 1)), z]) if fixed else z


def _integrator_maps(model: Fit) -> tuple[Matrix, Matrix]:
    """Return the matrix that maps theta to the free parameters, and the matrix that maps back."""
    d = model.theta.size
    if not model.integrating:
        return np.eye(d), np.eye(d)
    part = model.slice_of(model.integrating)
    k = part.stop - part.start
    inward = np.eye(d)
    inward[part, part] = np.tri(k)
    outward = np.eye(d)
    outward[part, part] = np.eye(k) - np.eye(k, k=-1)
    kept = np.delete(np.arange(d), part.stop - 1)
    return inward[kept], outward[:, kept]


def _normal(n: int, d: int, rng: np.random.Generator) -> Matrix:
    """Return n standard normal draws (n, d) with exactly zero mean and unit covariance matrix."""
    half = rng.standard_normal((n // 2, d))
    x = np.concatenate([half, -half])
    L = np.linalg.cholesky(x.T @ x / x.shape[0])
    return np.asarray(np.linalg.solve(L, x.T).T)


def pole_regions(model: Fit, draws: Draws | None = None) -> list[Region]:
    """Return the 95 % region of each pole, in the order of `model.poles()`.

    The regions of the roots of A and of the roots of F are computed separately.
    """
    draws = parameter_draws(model) if draws is None else draws
    poles = model.poles()
    n = model.A.size - 1
    all_regions = []
    for letter, part in (("a", slice(None, n)), ("f", slice(n, None))):
        samples = None if draws is None else roots_of(model, draws.theta, letter)
        all_regions += regions(poles.values[part], poles.covariance[part], samples)
    return all_regions


def zero_regions(model: Fit, draws: Draws | None = None) -> list[Region]:
    """Return the 95 % region of each zero, in the order of `model.zeros()`."""
    draws = parameter_draws(model) if draws is None else draws
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
