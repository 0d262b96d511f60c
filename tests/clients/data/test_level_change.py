"""A load changes the level of y for good: this is no drift, and no feedback."""

from __future__ import annotations

import armrig
import numpy as np
import pytest
from armrig.data.treatment.level_change import level_change
from armrig.numerics.polynomial import apply_filter


def data(seed: int, *, load: float = 0.0, at: int = 600, through: bool = False) -> armrig.Dataset:
    """Return a plant (2, 3 s) with noise of 0.05; the load acts on y, or through the plant."""
    rng = np.random.default_rng(seed)
    u, loads = np.repeat(rng.choice([0.0, 4.0], 50), 20), np.repeat([0.0, load], [at, 1000 - at])
    pole = np.exp(-0.2 / 3)
    y = apply_filter([0.0, 2 * (1 - pole)], [1.0, -pole], u + through * loads / 2)
    y += (not through) * loads + 0.05 * rng.standard_normal(1000)
    return armrig.Dataset(u=u, y=y, Ts=0.2)


@pytest.mark.parametrize("through", [False, True])
@pytest.mark.parametrize("at", [300, 600, 900])
def test_a_load_is_a_change_of_level(at: int, through: bool) -> None:
    feedback = 0
    for seed in range(6):
        x = data(seed, load=3.0, at=at, through=through)

        (found,) = armrig.drift(x, integrator=False)
        loop = armrig.open_loop(x)

        assert found.change_s == pytest.approx(0.2 * at, abs=7.0)
        assert abs(found.z) < 4
        assert found.seconds == pytest.approx(max(found.change_s, 200 - found.change_s))
        feedback += bool(loop.feedback)
    assert feedback <= 2


def test_a_change_of_level_is_said_with_the_way_out() -> None:
    told = str(armrig.advice(data(1, load=3.0)))

    assert "! drift       the level of y changes at 120 s, as by a load" in told
    assert "a model of one part needs data[:600] or data[600:]" in told


@pytest.mark.parametrize("drift", [0.0, 3.0])
def test_noise_and_a_drift_are_no_change_of_level(drift: float) -> None:
    """White noise, a random walk of the input, and a ramp."""
    for seed in range(20):
        x = data(seed)
        y = x.y + drift * np.linspace(0, 1, x.N)
        assert level_change(x.u[:, None], y) is None
    walk = np.cumsum(np.random.default_rng(1).standard_normal(1000))
    noise = apply_filter([1.0], [1.0, -0.95], np.random.default_rng(2).standard_normal(1000))
    assert level_change(walk[:, None], noise) is None


def test_feedback_is_found_on_both_sides_of_a_load() -> None:
    rng = np.random.default_rng(3)
    u, x, y = np.zeros((3, 1000))
    r = np.repeat(rng.choice([0.0, 4.0], 50), 20)
    for t in range(1, 1000):
        x[t] = 0.9 * x[t - 1] + 0.2 * u[t - 1]
        y[t] = x[t] + 3.0 * (t >= 600) + 0.1 * rng.standard_normal()
        u[t] = 1.5 * (r[t] - y[t])

    assert armrig.open_loop(armrig.Dataset(u=u, y=y, Ts=0.2)).feedback


def test_a_quarter_with_another_gain_is_no_feedback() -> None:
    """The plant is linear in three parts of four; the input depends on nothing."""
    found = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        u = np.concatenate([np.repeat(rng.uniform(0, 2, 75), 20), rng.uniform(0, 2, 500)])
        x = apply_filter([0.0, 0.1], [1.0, -0.9], u)
        y = np.where(np.arange(2000) < 1500, x, np.tanh(6 * (x - 1)))
        y += 0.01 * rng.standard_normal(2000)
        found += bool(armrig.open_loop(armrig.Dataset(u=u, y=y, Ts=1.0)).feedback)

    assert found <= 1
