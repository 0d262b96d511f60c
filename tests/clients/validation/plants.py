"""A plant of second order in open loop and under a controller, for advice and searches."""

from __future__ import annotations

import armrig
import numpy as np
from armrig.data.dataset import Dataset
from armrig.numerics.polynomial import filtered
from numpy.typing import NDArray

Vector = NDArray[np.float64]


def of_second_order(u: Vector, *, nk: int = 1, level: float = 0.0) -> Dataset:
    """Return 0.1 (1 + 0.5 q^-1)/(1 - 1.4 q^-1 + 0.5 q^-2) u(t - nk), a level and noise."""
    y = filtered(np.append(np.zeros(nk), [0.1, 0.05]), [1.0, -1.4, 0.5], u)
    e = 0.05 * np.random.default_rng(3).standard_normal(u.size)
    return Dataset(u=u, y=y + level + e, Ts=0.02)


def under_control(N: int = 1500) -> Dataset:
    """Return the same plant under u = (r - y)/2, noise of a pole at 0.9, r a step every 50."""
    rng = np.random.default_rng(5)
    r = np.repeat(rng.uniform(-1, 1, N // 50), 50)
    v = filtered([1.0], [1.0, -0.9], 0.1 * rng.standard_normal(N))
    x, u, y = np.zeros(N), np.zeros(N), np.zeros(N)
    for t in range(N):
        if t > 1:
            x[t] = 1.4 * x[t - 1] - 0.5 * x[t - 2] + 0.1 * u[t - 1] + 0.05 * u[t - 2]
        y[t] = x[t] + v[t]
        u[t] = 0.5 * (r[t] - y[t])
    return Dataset(u=u, y=y, Ts=0.02)


def switched(N: int = 1500) -> Vector:
    return armrig.telegraph(N, 0.1, 0.0, 5.0, seed=1) - 2.5
