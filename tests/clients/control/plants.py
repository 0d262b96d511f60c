"""Plants, laws and simulations that share no code with `armrig.control`."""

from __future__ import annotations

from typing import Any

import armrig
import numpy as np
from armrig_core.control.control_law import ControlLaw


def model(B: list[float], F: list[float], Ts: float = 0.05, **more: Any) -> armrig.Fit:
    """Return a model B/F in V, of which nothing was estimated."""
    nk = int(np.flatnonzero(B)[0])
    return armrig.Fit.of_channel(B=B, F=F, nk=nk, Ts=Ts, input_unit="V", **more)


def simulate(law: ControlLaw, model: armrig.Fit, r: Any) -> tuple[Any, Any]:
    """Return y (N, ny) and u (N,) of law and plant from their equations, term by term.

    u, y and the law begin at 0. An integrator adds differences, for a root at 1 is no exact root of
    rounded coefficients.
    """
    channels = [(fit.B, fit.denominator, fit.integrator) for _, _, fit in model.channels()]
    N = len(r)
    y, w, u, x = *np.zeros((2, N, len(channels))), np.zeros(N), np.zeros(law.order)
    A, B, C = np.array(law.A), np.array(law.B), np.array(law.C)
    for k in range(N):
        u[k] = C @ x + law.D * r[k]
        for i, (b, full, integrates) in enumerate(channels):
            f = np.cumsum(full)[:-1] if integrates else full
            w[k, i] = sum(b[j] * u[k - j] for j in range(1, len(b)) if k >= j)
            w[k, i] -= sum(f[j] * w[k - j, i] for j in range(1, len(f)) if k >= j)
            y[k, i] = w[k, i] + (y[k - 1, i] if integrates and k else 0.0)
        delayed = u[k - law.input_delay] if k >= law.input_delay else 0.0
        x = A @ x + B @ np.concatenate([[r[k], delayed], y[k]])
    return y, u
