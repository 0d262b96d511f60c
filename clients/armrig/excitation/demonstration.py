"""Experiments of the demonstration: a step and two telegraph signals, for any described rig."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from armrig_core.rig.description import Description, Model, require_model
from armrig_core.rig.saved_model import System
from numpy.typing import NDArray

from armrig.excitation.binary import telegraph
from armrig.excitation.levels import step

_LOW_V, _HIGH_V = 0.5, 4.5
_MAX_TS, _MIN_TS = 1.0, 0.001  # s
_FASTEST, _SLOWEST = 10, 10  # samples in the fastest time constant, slowest ones in an experiment
_SHARE = 0.9  # of the highest voltage, and of the way of an output to its limit


class Pace(NamedTuple):
    """Sampling time and levels of the demonstration, and the lengths of its experiments, in s."""

    Ts: float = 0.01
    seconds: float = 30.0
    """Length of a telegraph signal."""
    switch: float = 0.05
    """Probability that the telegraph signal switches at a sample."""
    step_s: float = 3.0
    high: float = _HIGH_V
    """Highest voltage of the inputs; the lowest is a ninth of it."""


def pace_of(described: Description, seconds: float | None) -> Pace:
    """Return the pace of a rig, by the time constants and the limits of its model.

    Raises InputError if the description has no model.
    """
    if described.arm:
        return Pace() if seconds is None else Pace(seconds=seconds)
    model, system = require_model(described)
    if system.process is not None:
        system.process.close()
    poles = np.linalg.eigvals(np.array(system.A)).astype(complex)
    rates = np.abs(poles.real if system.Ts is None else np.log(np.abs(poles)) / system.Ts)
    rates = rates[rates > 1e-9] if np.any(rates > 1e-9) else np.ones(1)
    fast, slow = 1 / rates.max(), 1 / rates.min()
    Ts = system.Ts or min(_MAX_TS, max(_MIN_TS, float(f"{fast / _FASTEST:.0e}")))
    return Pace(
        Ts=Ts,
        seconds=seconds or max(30.0, float(np.ceil(_SLOWEST * slow + model.delay_s))),
        switch=float(np.clip(2 * Ts / slow, 0.01, 0.5)),
        step_s=max(3.0, float(np.ceil(5 * slow + 2 * model.delay_s))),
        high=_highest_level(described, model, system),
    )


def _highest_level(described: Description, model: Model, system: System) -> float:
    """Return the highest voltage, at most 4.5 V, at which each output stays within its limits."""
    A, B = np.array(system.A), np.array(system.B)
    still = np.linalg.pinv((np.eye(len(A)) if system.Ts else 0.0) - A) @ B
    highest = min(_HIGH_V, _SHARE * described.input.u_max_v)
    rest = model.offset or [0.0] * len(described.outputs)
    gains = (np.array(system.C) @ still)[:, 0]
    for output, gain, y in zip(described.outputs.values(), gains, rest, strict=True):
        room = (output.high if gain > 0 else output.low) - y
        if gain and np.isfinite(room):
            highest = min(highest, _SHARE * room / gain)
    return float(f"{highest:.2g}")


class Experiment(NamedTuple):
    """One run of the demonstration."""

    name: str
    u: NDArray[np.float64]
    """Motor voltage at each sample, in V."""
    request: dict[str, Any]
    """Other fields of the request to the daemon: kind and details."""
    Ts: float = Pace().Ts
    """Sampling time, in s."""

    @property
    def seconds(self) -> float:
        """Length, in s."""
        return self.Ts * self.u.size


def experiments(pace: Pace, seed: int) -> list[Experiment]:
    """Return a step, a telegraph signal, and a telegraph signal for validation."""
    Ts, N = pace.Ts, round(pace.seconds / pace.Ts)
    levels = {"low": pace.high * _LOW_V / _HIGH_V, "high": pace.high}
    up = step(round(pace.step_s / Ts), **levels, at=round(pace.step_s / 6 / Ts))
    asked = {"experiment": "step", "details": {"input": "step", **levels}}
    plan = [Experiment("step", up, asked, Ts)]
    for name, number in (("telegraph", seed), ("validation", seed + 1)):
        details = {"input": "telegraph", **levels, "a": pace.switch, "seed": number}
        u = telegraph(N, pace.switch, **levels, seed=number)
        plan.append(Experiment(name, u, {"experiment": "blackbox", "details": details}, Ts))
    return plan
