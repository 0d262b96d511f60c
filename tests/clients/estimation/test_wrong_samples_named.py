"""Samples that look wrong: errors of an instrument are named, and motions of a rig are not."""

from __future__ import annotations

from collections.abc import Callable

import armrig
import numpy as np
import pytest
from armrig.estimation.data_faults import looking_wrong
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

Vector = NDArray[np.float64]
Record = tuple[Vector, Vector]


def _linear(rng: Generator, N: int = 800) -> Record:
    u = np.where(np.cumsum(rng.random(N) < 0.1) % 2, 4.5, 0.5)
    return u, lfilter([0, 0.2], [1, -0.9], u) + 0.05 * rng.standard_normal(N)


def _with_minus_127(rng: Generator) -> Record:
    u, y = _linear(rng)
    y[rng.choice(y.size, 4, replace=False)] = -127.0
    return u, y


def _with_a_spike(rng: Generator) -> Record:
    u, y = _linear(rng)
    y[rng.integers(30, 770)] += rng.choice([-1, 1]) * 1.5
    return u, y


def _with_spikes(rng: Generator) -> Record:
    u, y = _linear(rng)
    y[rng.choice(y.size, 12, replace=False)] += rng.choice([-1, 1], 12) * 1.5
    return u, y


def _with_backlash(rng: Generator) -> Record:
    u, w = np.repeat(rng.uniform(-1, 1, 300), 5), np.zeros(1500)
    for t in range(1, w.size):
        w[t] = np.clip(w[t - 1], u[t] - 0.4, u[t] + 0.4)
    return u, lfilter([0, 0.2], [1, -0.8], w) + 0.005 * rng.standard_normal(w.size)


def _with_a_load(rng: Generator) -> Record:
    u, y = _linear(rng, 1200)
    load = np.zeros(y.size)
    load[600:700] = 3.0
    return u, y + lfilter([0, 0.2], [1, -0.9], load)


def _with_another_input(rng: Generator) -> Record:
    """Return an output that a second input moves, too, which the data do not contain."""
    u, other = (2.0 * (np.cumsum(rng.random(1500) < p) % 2) - 1 for p in (0.2, 0.06))
    y = lfilter([0, 0.1], [1, -0.5], u) + lfilter([0, 0.3], [1, -0.8], other)
    return u, y + 0.03 * rng.standard_normal(1500)


def _with_a_stiff_spring(rng: Generator) -> Record:
    """Return a resonance whose spring is stiffer at large deflections."""
    b, a = butter(2, 0.2)
    u, y, x, v = 3 * lfilter(b, a, rng.standard_normal(1500)), np.zeros(1500), 0.0, 0.0
    for t in range(y.size):
        y[t] = x
        for _ in range(4):
            v += 0.1 * (u[t] - x - 0.5 * x**3 - 0.4 * v)
            x += 0.1 * v
    return u, y + 0.002 * np.std(y) * rng.standard_normal(y.size)


def _named(record: Callable[[Generator], Record], seed: int) -> int:
    u, y = record(np.random.default_rng([21, seed]))
    data = armrig.Dataset(u=u, y=y, Ts=1.0)
    about = {f.about for f in armrig.advice(data).findings if f.level != "good"}
    return looking_wrong(data.signals())[0] if "outliers" in about else 0


@pytest.mark.parametrize(
    ("record", "count"), [(_with_minus_127, 4), (_with_a_spike, 1), (_with_spikes, 12)]
)
def test_errors_of_an_instrument_are_named(
    record: Callable[[Generator], Record], count: int
) -> None:
    found = [_named(record, seed) for seed in range(10)]

    assert sum(named >= count for named in found) >= 9


@pytest.mark.parametrize(
    "record",
    [_linear, _with_backlash, _with_a_load, _with_another_input, _with_a_stiff_spring],
)
def test_motions_of_a_rig_are_not_named(record: Callable[[Generator], Record]) -> None:
    found = [_named(record, seed) for seed in range(10)]

    assert sum(named > 0 for named in found) <= 1


def test_wrong_samples_are_no_nonlinearity() -> None:
    """Four readings of -127 in 800 samples were called NONLINEAR in 14 of 20 records."""
    for seed in range(5):
        u, y = _with_minus_127(np.random.default_rng([22, seed]))
        said = str(armrig.advice(armrig.Dataset(u=u, y=y, Ts=1.0)))

        assert "4 samples of y look wrong" in said
        assert "NONLINEAR" not in said
