"""The end of a step: an output has moved, and all outputs are steady."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.rig.settling import Settling
from armrig_core.rig.description import builtin
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag

TS, AT_S = 0.1, 2.0


def _settles_at(
    name: str, tau: float, *, noise: float = 0.05, gain: float = 10.0, dead_s: float = 0.0
) -> float:
    """Return the time in s after which a step of a first-order rig counts as settled."""
    rng, channels = np.random.default_rng(5), builtin(name).channels
    settling = Settling(channels, AT_S, TS)
    t = TS * np.arange(20_000)
    since = np.maximum(t - AT_S - dead_s, 0.0)
    y = 20 + gain * (1 - np.exp(-since / tau))
    if channels[0].turns:  # the speed settles, and the angle wraps
        y = (np.cumsum(y) * TS * 0.1) % (2 * np.pi)
    y += noise * rng.standard_normal(t.size)
    for k in range(0, t.size, 5):
        settling.add(
            [Sample(i, 0, 0, 0, y[i], y[i], 0.0, 0.0, 9, 9, int(Flag.RUN)) for i in range(k, k + 5)]
        )
        if settling.has_settled():
            return float(t[k + 4])
    return np.inf


@pytest.mark.parametrize("tau", [2.0, 10.0, 60.0])
@pytest.mark.parametrize("dead_s", [0.0, 30.0])
def test_a_step_ends_after_five_to_ten_time_constants(tau: float, dead_s: float) -> None:
    settled_s = _settles_at("heater", tau, dead_s=dead_s)

    assert max(29.0, AT_S + dead_s + 5 * tau) <= settled_s <= max(32.0, 4 * dead_s) + 12 * tau


def test_a_turning_shaft_settles_at_a_steady_speed() -> None:
    assert 20 < _settles_at("arm", 4.0, noise=0.001) < 80


def test_an_output_that_never_moves_does_not_settle() -> None:
    assert _settles_at("heater", 5.0, gain=0.0) == np.inf


def test_a_drift_does_not_settle() -> None:
    assert _settles_at("heater", 1e5, gain=1e4, noise=0.01) == np.inf
