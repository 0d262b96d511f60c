"""Choice of the horizon of a subspace estimate: its number of past and of future samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError
from scipy.linalg.lapack import dposv

from armrig.data.dataset import Dataset
from armrig.estimation.orders import require_samples
from armrig.estimation.subspace import (
    Parts,
    Projection,
    Windows,
    autoregressive_order,
    complete_stretches,
    projection,
    realised,
    shortened,
    windows,
)
from armrig.models.structure_table import Weights
from armrig.numerics.checks import require_integers
from armrig.numerics.polynomial import (
    Array,
    filtered,
    impulse,
    lagged,
    with_roots_inside,
    without_integrator,
)

MIN_HORIZON, MAX_HORIZON = 10, 30
"""Limits of the horizon that AIC chooses, in samples."""
_MAX_WINDOWS = 4000  # largest number of windows for the choice of the longest horizon
_MAX_COMPARED_SAMPLES = 2000  # largest number of samples for the comparison of models
_MIN_LOSS_SHARE = 1e-10  # least loss / |y|²; normal equations lose all digits of a smaller loss


def delayed_signals(data: Dataset, nk: int) -> Parts:
    """Return (u, y) of each experiment, with u delayed by nk - 1 samples."""
    later = max(nk - 1, 0)
    signals = [(lagged(part.u, [later]), part.y[:, None]) for part in data.experiments()]
    return [(u[later:], y[later:]) for u, y in signals]


def usable_windows(
    data: Dataset, signals: Parts, order: int | None, horizon: int | None
) -> Windows:
    """Return the windows for `horizon`, or for the longest useful horizon if `horizon` is None."""
    measured = data.N - data.missing
    i = longest_horizon(signals, measured, order) if horizon is None else int(horizon)
    require_integers(horizon=(i, 3 if order is None else int(order) + 2))
    w = windows(signals, past=i, future=i)
    asked = f"horizon={i}, with windows of {2 * i} samples without a gap,"
    got = w.N + 2 * i - 1 if w.N else min(measured, 2 * i - 1)
    require_samples(asked, needed=4 * i + 2 + 2 * i, got=got)
    if not w.R[:, w.columns("yf")].any():
        raise InputError(
            f"{data.output} is constant and shows no state; record data in which it changes"
        )
    return w


def longest_horizon(signals: Parts, samples: int, order: int | None) -> int:
    """Return the largest useful horizon: the maximum of 10, 2 (order + 1) and an ARX model's order.

    AIC chooses the order of the ARX model, at most 30. For short data the horizon is at most a
    twelfth of the number of samples, but at least order + 2.
    """
    least = 2 if order is None else order + 2
    most = max(samples // 12, least)
    w = windows(signals, past=min(MAX_HORIZON, most), future=1, most=_MAX_WINDOWS)
    enough = 2 * len(w.R) < w.N
    wanted = autoregressive_order(w) if enough else MIN_HORIZON
    return min(max(wanted, MIN_HORIZON, 2 * least - 2), most)


def least_loss(signals: Parts, models: Sequence[tuple[Array, Array]], *, direct: bool) -> int:
    """Return the index of the model (A, C) with the least one-step loss.

    B of each model is chosen so that the loss is least. The loss of A y = B u + C e is computed
    over the longest stretches without missing y, at most 2000 samples in all. A level and the
    predictor's initial state are fitted for each stretch. If the data have no noise, the losses are
    only rounding errors and the index is 0.
    """
    parts = _longest_stretches(signals)
    scale = sum(float(y @ y) for _, y in parts)
    losses = [sum(_loss(u, y, A, C, direct=direct) for u, y in parts) for A, C in models]
    if not losses[0] > _MIN_LOSS_SHARE * scale:
        return 0
    return int(np.argmin(np.where(np.isnan(losses), np.inf, losses)))


def _longest_stretches(signals: Parts) -> list[tuple[Array, Array]]:
    whole = [(u[:, 0], y[:, 0]) for u, y in complete_stretches(signals, 1)]
    left, parts = _MAX_COMPARED_SAMPLES, []
    for u, y in sorted(whole, key=lambda part: -part[1].size):
        if left > 0:
            parts.append((u[:left], y[:left]))
            left -= y.size
    return parts


def _loss(u: Array, y: Array, A: Array, C: Array, *, direct: bool) -> float:
    """Return the least sum of squares of (A y - B u - free response) / C, by normal equations.

    Normal equations square the condition number. A comparison of models tolerates the loss of
    digits, but an estimate does not.
    """
    n = A.size - 1
    if y.size < 4 * n + 4:
        return 0.0
    pulse = impulse(C, y.size)
    first = int(not direct)
    M = np.empty((y.size, 2 * n + 3 - first), order="F")
    M[:, : n + 1 - first] = lagged(filtered([1.0], C, u), range(first, n + 1))
    M[:, n + 1 - first : -2] = lagged(pulse, range(n))
    M[:, -2], M[:, -1] = np.cumsum(pulse), filtered(A, C, y)
    G = M.T @ M
    scale = np.sqrt(np.diag(G))
    scale[scale == 0] = 1.0
    G /= np.outer(scale, scale)
    # A small multiple of the identity keeps G positive definite if u does not determine all of B.
    _, b, failed = dposv(G[:-1, :-1] + 1e-12 * np.eye(len(G) - 1), G[:-1, -1])
    if failed:
        return float("nan")
    return float(scale[-1] ** 2 * (G[-1, -1] - 2 * b @ G[:-1, -1] + b @ G[:-1, :-1] @ b))


@dataclass(frozen=True, slots=True, kw_only=True)
class Poles:
    """Polynomials A and C of a model, estimated without B."""

    A: Array
    """Polynomial of the poles; with an integrator one pole is exactly 1."""
    C: Array
    """Polynomial of the predictor's poles; no pole is outside the unit circle."""
    horizon: int
    """Number of past and of future samples of the projection."""
    singular_values: Array
    """Singular values of the projection."""
    steady: bool
    """True if there is a steady Kalman filter. Otherwise C is A with all roots moved inside the
    unit circle."""


def poles_at(w: Windows, found: Projection, order: int, *, integrator: bool) -> Poles:
    """Return A and C for the horizon of the windows."""
    space = realised(w, found, order)
    A, inside = np.real(np.poly(space.A)), space.predictor_poles()
    return Poles(
        A=_integrating(A) if integrator else A,
        C=with_roots_inside(np.linalg.eigvals(space.A) if inside is None else inside),
        horizon=w.future,
        singular_values=found.singular_values,
        steady=inside is not None,
    )


def best_poles(
    signals: Parts,
    w: Windows,
    found: Projection,
    order: int,
    weights: Weights,
    *,
    integrator: bool,
    direct: bool,
) -> Poles:
    """Return the poles for the horizon of `w` or order + 2, whichever has the lower one-step loss.

    For white noise on the output, the memory of the predictor is long, and the horizon must be
    long. If the noise has the poles of A, a long horizon is not necessary, and in short data it
    reduces the accuracy. An example is an ARMAX system of order 4 at N = 300. The loss of its model
    exceeded the least possible loss by 29 % with a horizon of 10, and by 5 % with a horizon of 6.
    For white noise on the output, the loss was 6 % above the least possible loss with a horizon of
    10, and 10 % above with a horizon of 6. The losses can be compared because both models have the
    same number of parameters.
    """
    long = poles_at(w, found, order, integrator=integrator)
    if order + 2 >= w.future:
        return long
    short = shortened(w, order + 2)
    other = poles_at(short, projection(short, weights), order, integrator=integrator)
    both = long, other
    return both[least_loss(signals, [(p.A, p.C) for p in both], direct=direct)]


def _integrating(A: Array) -> Array:
    """Return A with its real root nearest 1 moved to 1."""
    z = np.roots(A).astype(np.complex128)
    z[np.argmin(np.abs(z - 1) + 10.0 * (np.abs(z.imag) > 1e-9))] = 1.0
    return np.convolve([1.0, -1.0], without_integrator(np.real(np.poly(z))))
