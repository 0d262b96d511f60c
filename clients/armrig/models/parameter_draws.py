"""Draws of a model's parameters from their covariance: what sampling has in place of a derivative.

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
    from armrig.models.model import Model

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Complex = NDArray[np.complex128]

COUNT = 1000
MOST = 10
"""Times as many draws are made at most, where many are left out."""
SEED = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Draws:
    """Models drawn from N(theta, P), those left out that the estimator could not have returned."""

    theta: Matrix
    """Parameters of the draws that count, (n, d)."""
    asked: int
    """Draws made."""
    unstable: int
    """Left out: a pole outside the unit circle, where the model itself is stable."""
    degenerate: int
    """Left out: not finite, or the first b so small that a zero is not finite."""

    @property
    def left_out(self) -> str:
        """What was left out, in words, or nothing."""
        counted = ((self.unstable, "unstable"), (self.degenerate, "degenerate"))
        return ", ".join(f"{n} of {self.asked} {what}" for n, what in counted if n)


def drawn(model: Model, *, n: int = COUNT, rng: np.random.Generator | None = None) -> Draws | None:
    """Return n draws of theta from N(theta, P), P the covariance that the verdict trusts.

    With P = W W^T they are theta + W x, x standard normal: in pairs x and -x, and scaled so that
    their own covariance is the unit matrix, which leaves an answer linear in theta its exact
    deviation. W is made from the correlation matrix, so that the units of the parameters do not
    matter, and where a root is 1 by construction from that of the other factor's coefficients, so
    that it stays 1.

    Parameters
    ----------
    n : int, default 1000
        Draws, an even number of more than twice the parameters; where fewer than half of them
        count, up to ten times as many are made.
    rng : Generator, optional
        By default one of a fixed seed, so that a figure drawn twice is the same.

    Returns
    -------
    Draws or None
        None where nothing was estimated, or P is not known.
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
    while asked < MOST * n and sum(len(x) for x in kept) < n:
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


def directions(model: Model) -> Matrix:
    """Return W (d, r) with W W^T = P, the trusted covariance: a step of one deviation a column.

    Made from the correlation matrix of the parameters that were free, so that a root that is 1 by
    construction stays 1 along each.
    """
    inward, outward = _integrator_maps(model)
    return outward @ _root(inward @ model.trusted_covariance @ inward.T)


def _stable(model: Model, theta: Matrix, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell which draws have all poles inside the unit circle, a fixed one at 1 not counted."""
    inside = np.ones(theta.shape[0], dtype=bool)
    for letter in "af":
        z = roots_of(model, theta, letter, known)
        inside &= (np.abs(z[:, int(letter == model.integrating) :]) < 1).all(axis=1)
    return inside


def polynomial_of(model: Model, theta: Matrix, letter: str) -> Matrix:
    """Return one polynomial of each draw, (n, order + 1), B with its nk zeros."""
    free = theta[:, model.slice_of(letter)]
    before = np.zeros((theta.shape[0], model.nk)) if letter == "b" else np.ones((theta.shape[0], 1))
    return np.hstack([before, free])


def roots_of(
    model: Model, theta: Matrix, letter: str, known: NDArray[np.bool_] | None = None
) -> Complex:
    """Return the roots of one polynomial of each draw, (n, order); that at 1, if any, the first.

    They are the eigenvalues of its companion matrix; NaN where `known` is False.
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


def _integrator_maps(model: Model) -> tuple[Matrix, Matrix]:
    """Return the linear maps from theta to the parameters that were free, and back."""
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
    """Return n standard normal draws (n, d) with mean 0 and unit covariance exactly."""
    half = rng.standard_normal((n // 2, d))
    x = np.concatenate([half, -half])
    L = np.linalg.cholesky(x.T @ x / x.shape[0])
    return np.asarray(np.linalg.solve(L, x.T).T)


def _without(model: Model, letter: str, p: Vector) -> Vector:
    return without_integrator(p) if letter == model.integrating else p


def _root(P: Matrix) -> Matrix:
    """Return W with W W^T = P, what rounding made negative taken for 0."""
    std = np.sqrt(np.maximum(np.diag(P), 0.0))
    by = np.where(std > 0, std, 1.0)
    value, vector = np.linalg.eigh(P / np.outer(by, by))
    return np.asarray(std[:, None] * vector * np.sqrt(np.maximum(value, 0.0)))
