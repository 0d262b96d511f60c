"""A model of the chassis's rate that is estimated sample by sample, while the rig goes on."""

from __future__ import annotations

from dataclasses import replace
from math import atan2, hypot, inf, isfinite, radians, tau

import numpy as np
from numpy.typing import NDArray

from armrig.estimation.recursive import rarx_start, rarx_step

_NA, _NB = 3, 4  # of the arm, its integrator left out: sampled, its rate has a zero for each pole
_REMEMBERED_S = 20.0
_TURN = 360.0
_FRESH = rarx_start(na=_NA, nb=_NB)


class LiveModel:
    """ARX of the rate, A(q) omega(t) = B(q) u(t) + e(t), which forgets what is long ago."""

    def __init__(self, Ts: float) -> None:
        """Begin without a sample, for samples Ts apart in s."""
        self.Ts = Ts
        forgetting = max(0.5, 1.0 - Ts / _REMEMBERED_S)
        self._state = rarx_start(na=_NA, nb=_NB, forgetting=forgetting)
        self._k = -inf
        self._theta = float("nan")

    def take(self, found: NDArray[np.float64]) -> None:
        """Take samples in their order, (n, 5) as of `armrig.dashboard.bins.signals`.

        Nothing is looked back on across a sample that is missing.
        """
        for k, _, u, theta, _ in found.tolist():
            if k != self._k + 1:
                self._state = replace(self._state, u=_FRESH.u, y=_FRESH.y)
                self._theta = float("nan")
            turned = theta - self._theta
            if isfinite(turned):
                turned -= _TURN * round(turned / _TURN)
            # The voltage acts from this sample on: at the next one it is the past.
            self._state = rarx_step(self._state, u, radians(turned) / self.Ts)
            self._k, self._theta = k, theta

    def lines(self) -> list[str]:
        """Return what it says now, for a person."""
        state = self._state
        if not state.determined or not isfinite(state.noise_variance):
            return ["the samples so far determine no model: play an input that switches"]
        gain = state.B.sum() / state.A.sum()
        error = state.noise_variance**0.5
        return [
            f"rate of θ₁, ARX[{_NA} {_NB} 1], of the last {_REMEMBERED_S:g} s: "
            f"gain {gain:.3g} rad/s per V, prediction error {error:.2g} rad/s",
            *(_described(pole, self.Ts) for pole in np.roots(state.A) if pole.imag >= 0),
        ]


def _described(pole: complex, Ts: float) -> str:
    """Return where a pole is, and what it is in continuous time."""
    decay, angle = -np.log(max(abs(pole), 1e-300)) / Ts, atan2(pole.imag, pole.real) / Ts
    if abs(pole) >= 1:
        return f"pole {pole:.3f}: unstable"
    if not pole.imag:
        if pole.real <= 0:
            return f"pole {pole.real:.3f}: of noise, no sampled rig has it"
        return f"pole {pole.real:.3f}: time constant {1 / decay:.3g} s"
    omega = hypot(decay, angle)
    where = f"poles {pole.real:.3f} ± {pole.imag:.3f}i"
    return f"{where}: {omega / tau:.3g} Hz, damping {decay / omega:.2g}"
