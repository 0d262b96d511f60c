"""A plant of second order in open loop and under a controller, for advice and searches."""

from __future__ import annotations

from functools import cache
from typing import Any

import armrig
import numpy as np
from armrig import Fit, Signals
from armrig.data.dataset import Dataset
from armrig.numerics.polynomial import apply_filter
from numpy.typing import NDArray

Vector = NDArray[np.float64]


def of_second_order(u: Vector, *, nk: int = 1, level: float = 0.0) -> Dataset:
    """Return 0.1 (1 + 0.5 q^-1)/(1 - 1.4 q^-1 + 0.5 q^-2) u(t - nk), a level and noise."""
    y = apply_filter(np.append(np.zeros(nk), [0.1, 0.05]), [1.0, -1.4, 0.5], u)
    e = 0.05 * np.random.default_rng(3).standard_normal(u.size)
    return Dataset(u=u, y=y + level + e, Ts=0.02)


def under_control(N: int = 1500) -> Dataset:
    """Return the same plant under u = (r - y)/2, noise of a pole at 0.9, r a step every 50."""
    rng = np.random.default_rng(5)
    r = np.repeat(rng.uniform(-1, 1, N // 50), 50)
    v = apply_filter([1.0], [1.0, -0.9], 0.1 * rng.standard_normal(N))
    x, u, y = np.zeros(N), np.zeros(N), np.zeros(N)
    for t in range(N):
        if t > 1:
            x[t] = 1.4 * x[t - 1] - 0.5 * x[t - 2] + 0.1 * u[t - 1] + 0.05 * u[t - 2]
        y[t] = x[t] + v[t]
        u[t] = 0.5 * (r[t] - y[t])
    return Dataset(u=u, y=y, Ts=0.02)


def switched(N: int = 1500) -> Vector:
    return armrig.telegraph(N, 0.1, 0.0, 5.0, seed=1) - 2.5


SAMPLES = 400
"""Samples of `two_outputs`."""


def two_outputs(seed: int, *, missing: float = 0.0, cross: float = 0.5) -> Signals:
    """Return two outputs of two inputs; u2 reaches y1 one sample later than the other channels."""
    rng = np.random.default_rng([41, seed])
    u = np.repeat(np.sign(rng.standard_normal((SAMPLES // 2, 2))), 2, axis=0)
    y = np.column_stack(
        [
            apply_filter([0, 1.0, 0.5], [1, -1.2, 0.5], u[:, 0]),
            apply_filter([0, 0.3], [1, -0.3], u[:, 0]) + apply_filter([0, 0.8], [1, -0.7], u[:, 1]),
        ]
    )
    y[:, 0] += cross * apply_filter([0, 0, 1.0], [1, -0.7], u[:, 1])
    y += rng.multivariate_normal([0, 0], [[0.04, 0.02], [0.02, 0.03]], SAMPLES)
    valid = rng.random(y.shape) >= missing
    return Signals(u=u, y=y, Ts=0.1, valid=valid, inputs=["u1", "u2"], outputs=["y1", "y2"])


@cache
def oe_of_two_outputs(seed: int, missing: float = 0.0, *, nk_12: int = 2) -> Fit:
    """Return the OE model of a plant, with the delay from u2 to y1."""
    orders: dict[str, Any] = {
        "nb": [[2, 1], [1, 1]],
        "nf": [[2, 1], [1, 1]],
        "nk": {("y1", "u2"): nk_12},
    }
    return armrig.oe(two_outputs(seed, missing=missing), **orders)  # type: ignore[return-value]
