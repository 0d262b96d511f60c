"""How far past and future reach in a subspace estimate: what the data say of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError
from scipy.linalg.lapack import dposv

from armrig.data.dataset import Dataset
from armrig.estimation.orders import require_samples
from armrig.estimation.subspace import (
    Projection,
    Realisation,
    Windows,
    autoregressive_order,
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
from armrig.numerics.stretches import stretches

LEAST, LONGEST = 10, 30  # samples of past and of future
_ENOUGH = 4000  # windows to choose the longest horizon from
_COMPARED = 2000  # samples to compare models on
_ROUNDING = 1e-10  # share of y's squares below which normal equations have no digit left

Signals = Sequence[tuple[Array, Array]]


def delayed_signals(data: Dataset, nk: int) -> Signals:
    """Return u, advanced by the delay that is known, and y of each experiment."""
    later = max(nk - 1, 0)
    signals = [(lagged(part.u, [later])[:, 0], part.y) for part in data.experiments()]
    return [(u[later:], y[later:]) for u, y in signals]


def usable_windows(
    data: Dataset, signals: Signals, order: int | None, horizon: int | None
) -> Windows:
    """Return past and future, as far as is asked for or the data can use."""
    measured = data.N - data.missing
    i = longest_horizon(signals, measured, order) if horizon is None else int(horizon)
    require_integers(horizon=(i, 3 if order is None else int(order) + 2))
    w = windows(signals, past=i, future=i)
    asked = f"horizon={i}, with windows of {2 * i} samples without a gap,"
    got = w.N + 2 * i - 1 if w.N else min(measured, 2 * i - 1)
    require_samples(asked, needed=4 * i + 2 + 2 * i, got=got)
    if not w.R[:, w.columns("yf")].any():
        raise InputError(
            f"{data.output} is constant and shows no state; record an experiment that moves it"
        )
    return w


def longest_horizon(signals: Signals, samples: int, order: int | None) -> int:
    """Return the order of an ARX model by AIC, between 10 and 30, or 2 (order + 1) if more.

    Fewer for short data: no more than one for 12 samples.
    """
    least = 2 if order is None else order + 2
    most = max(samples // 12, least)
    w = windows(signals, past=min(LONGEST, most), future=1, most=_ENOUGH)
    enough = 2 * len(w.R) < w.N
    wanted = autoregressive_order(w) if enough else LEAST
    return min(max(wanted, LEAST, 2 * least - 2), most)


def least_loss(signals: Signals, models: Sequence[tuple[Array, Array]], *, direct: bool) -> int:
    """Return which of the models (A, C) has the least one-step loss, B the best for each.

    The loss is that of A y = B u + C e over the longest stretches without a hole, 2000 samples at
    most, a level and the predictor's state before each fitted to it. The first model is returned
    where the data have no noise to tell them apart by.
    """
    parts = _longest_stretches(signals)
    scale = sum(float(y @ y) for _, y in parts)
    losses = [sum(_loss(u, y, A, C, direct=direct) for u, y in parts) for A, C in models]
    if not losses[0] > _ROUNDING * scale:
        return 0
    return int(np.argmin(np.where(np.isnan(losses), np.inf, losses)))


def _longest_stretches(signals: Signals) -> list[tuple[Array, Array]]:
    whole = [(u[s], y[s]) for u, y in signals for s in stretches(np.isfinite(y))]
    left, parts = _COMPARED, []
    for u, y in sorted(whole, key=lambda part: -part[1].size):
        if left > 0:
            parts.append((u[:left], y[:left]))
            left -= y.size
    return parts


def _loss(u: Array, y: Array, A: Array, C: Array, *, direct: bool) -> float:
    """Return the least sum of squares of (A y - B u - free response) / C, by normal equations.

    They square the condition number, which a comparison can bear and a model cannot.
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
    # A touch of the identity keeps the factor where u does not determine all of B.
    _, b, failed = dposv(G[:-1, :-1] + 1e-12 * np.eye(len(G) - 1), G[:-1, -1])
    if failed:
        return float("nan")
    return float(scale[-1] ** 2 * (G[-1, -1] - 2 * b @ G[:-1, -1] + b @ G[:-1, :-1] @ b))


@dataclass(frozen=True, slots=True, kw_only=True)
class Poles:
    """What of the model needs no input."""

    A: Array
    """Poles; with an integrator one is 1 exactly."""
    C: Array
    """Poles of the predictor, none outside the circle."""
    horizon: int
    """Samples of past and of future that they come from."""
    singular_values: Array
    """Of the projection at that horizon."""
    steady: bool
    """There is a steady Kalman filter; else C is A, but for roots outside the circle."""


def poles_at(w: Windows, found: Projection, order: int, *, integrator: bool) -> Poles:
    """Return A and C at one horizon."""
    space = realised(w, found, order)
    A, C = _polynomials(space, integrator=integrator)
    return Poles(
        A=A, C=C, horizon=w.future, singular_values=found.singular_values, steady=space.steady
    )


def best_poles(
    signals: Signals,
    w: Windows,
    found: Projection,
    order: int,
    weights: Weights,
    *,
    integrator: bool,
    direct: bool,
) -> Poles:
    """Return those of the given horizon or of order + 2, whichever has the lower one-step loss.

    A long past is needed where the predictor forgets slowly, as where noise is white on the
    output. Where the poles shape the noise it is for nothing, and in short data each sample of it
    costs accuracy: at N = 300 the loss of an ARMAX model of order 4 was above the least possible
    by 29 % at a horizon of 10, and by 5 % at 6; the other way round 6 % and 10 % for noise that
    is white on the output. Both have the same number of parameters, so their losses compare.
    """
    long = poles_at(w, found, order, integrator=integrator)
    if order + 2 >= w.future:
        return long
    short = shortened(w, order + 2)
    other = poles_at(short, projection(short, weights), order, integrator=integrator)
    both = long, other
    return both[least_loss(signals, [(p.A, p.C) for p in both], direct=direct)]


def _polynomials(space: Realisation, *, integrator: bool) -> tuple[Array, Array]:
    """Return A and C of the ARMAX model that the state space is."""
    A, C = np.real(np.poly(space.A)), with_roots_inside(space.predictor)
    return _integrating(A) if integrator else A, C


def _integrating(A: Array) -> Array:
    """Return A with its real root nearest 1 moved there."""
    z = np.roots(A).astype(np.complex128)
    z[np.argmin(np.abs(z - 1) + 10.0 * (np.abs(z.imag) > 1e-9))] = 1.0
    return np.convolve([1.0, -1.0], without_integrator(np.real(np.poly(z))))
