"""Missing outputs, for methods that need whole records."""

from __future__ import annotations

import numpy as np

from armrig.data.dataset import Dataset
from armrig.estimation.nonparametric.impulse import impulse_response
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import filtered

LONGEST = 60  # lags of the response


def filled(data: Dataset, *, integrator: bool) -> Dataset:
    """Return the data with each missing y replaced by what the input explains of it.

    That is the regularised impulse response's answer plus the experiment's own level (and, with an
    integrator, ramp), not an interpolation between neighbours. Correlating with holes instead
    would turn all of y into noise, not only what u does not explain. A filled sample adds no
    information: who counts samples must count the valid ones.
    """
    if data.missing == 0:
        return data
    n = max(2, min((data.N - data.missing) // 5, LONGEST))
    response = impulse_response(data, n, "tc", integrator=integrator)
    g, _ = response.decaying
    y = np.array(data.y)
    mean = float(np.mean(data.u))
    for a, b in zip(data.starts, (*data.starts[1:], data.N), strict=True):
        u = data.u[a:b] - mean
        x = data.Ts * np.cumsum(u) if integrator else u
        there = data.valid[a:b]
        explained = filtered(g, [1.0], x)
        own = np.vander(np.linspace(-1, 1, b - a), 1 + integrator)
        basis = orthonormal(own[there])
        free = own @ basis.coefficients((data.y[a:b] - explained)[there])
        y[a:b] = np.where(there, data.y[a:b], explained + free)
    return data.replaced(y=y, valid=np.ones(data.N, dtype=np.bool_), step=None)
