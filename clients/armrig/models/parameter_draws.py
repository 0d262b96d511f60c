"""Random draws of the parameters of a model from their normal distribution.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 9.3 (theta is asymptotically
   normal).
.. [2] BIPM, *Evaluation of measurement data: Supplement 1 to the GUM, Propagation of distributions
   using a Monte Carlo method*, JCGM 101:2008.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.polynomial import stable, without_integrator

if TYPE_CHECKING:
    from armrig.models.fit import Fit

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Complex = NDArray[np.complex128]

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
        return ", ".join(f"{n} of {self.asked} {what}" for n, what in counted if n)


def drawn(model: Fit, *, n: int = DRAWS, rng: np.random.Generator | None = None) -> Draws | None:
    """Return n draws of theta from N(theta, P); P is the trusted covariance of the model.

    With P = W W^T the draws are theta + W x, with x standard normal. The draws of x are pairs x and
    -x, scaled so that their covariance is exactly the unit matrix. The standard deviation of a
    response that is linear in theta is then exact. W is computed from the correlation matrix, so
    that the units of the parameters do not matter. If a polynomial has a root 1 by construction,
    only the coefficients of its other factor vary, so that the root stays 1 in each draw.

    Parameters
    ----------
    n : int, default 1000
        Number of draws, even and more than twice the number of parameters. If half of the draws or
        more are rejected, up to 10 n draws are made.
    rng : Generator, optional
        Generator of random numbers. The default has a fixed seed, so that a figure is reproducible.

    Returns
    -------
    Draws or None
        None if nothing was estimated or P is not known.
    """
    P = model.trusted_covariance
    if not (np.isfinite(P).all() and P.any()):
        return None
    rng = np.random.default_rng(SEED) if rng is None else rng
    W = directions(model)
    model_is_stable = all(
        stable(_without(model, letter, getattr(model, letter.upper()))) for letter in "af"
    )
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
    return outward @ _root(inward @ model.trusted_covariance @ inward.T)


def _stable(model: Fit, theta: Matrix, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the draws with all poles inside the unit circle.

    A pole fixed at 1 is ignored.
    """
    inside = np.ones(theta.shape[0], dtype=bool)
    for letter in "af":
        z = roots_of(model, theta, letter, known)
        inside &= (np.abs(z[:, int(letter == model.integrating) :]) < 1).all(axis=1)
    return inside


def polynomial_of(model: Fit, theta: Matrix, letter: str) -> Matrix:
    """Return the coefficients of one polynomial, a row for each draw; B includes its nk zeros."""
    free = theta[:, model.slice_of(letter)]
    before = np.zeros((theta.shape[0], model.nk)) if letter == "b" else np.ones((theta.shape[0], 1))
    return np.hstack([before, free])


def roots_of(
    model: Fit, theta: Matrix, letter: str, known: NDArray[np.bool_] | None = None
) -> Complex:
    """Return the roots of one polynomial of each draw, (n, order); a fixed root at 1 is first.

    The roots are the eigenvalues of the companion matrix, or NaN if `known` is False for a draw.
    """
    p = polynomial_of(model, theta, letter)[:, model.nk if letter == "b" else 0 :]
    fixed = letter == model.integrating
    if fixed:
        p = np.cumsum(p, axis=1)[:, :-1]
    n, order = p.shape[0], p.shape[1] - 1
    z = np.full((n, order), np.nan, dtype=np.complex128)
    some = np.ones(n, dtype=bool) if known is None else known
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


def _without(model: Fit, letter: str, p: Vector) -> Vector:
    return without_integrator(p) if letter == model.integrating else p


def _root(P: Matrix) -> Matrix:
    """Return W with W W^T = P; an eigenvalue that rounding made negative counts as 0."""
    std = np.sqrt(np.maximum(np.diag(P), 0.0))
    by = np.where(std > 0, std, 1.0)
    value, vector = np.linalg.eigh(P / np.outer(by, by))
    return np.asarray(std[:, None] * vector * np.sqrt(np.maximum(value, 0.0)))
