"""Correlation analysis reports whether there is a relation, and at which lag."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation.nonparametric.correlation import Correlation, correlation
from armrig.numerics.polynomial import apply_filter


def test_a_coloured_input_is_whitened(second: Any) -> None:
    data = second.dataset(np.random.default_rng(1), 20_000, u_pole=0.9)

    found = correlation(data, integrator=False)

    np.testing.assert_allclose(found.g[20:], second.g(21), atol=0.06)
    apart = np.abs(found.lags) > 0
    assert np.all(np.abs(found.autocorrelation[apart]) < 0.03)


@pytest.mark.parametrize("lags", [5, 40, 60])
def test_the_autocorrelation_equals_its_definition_at_each_lag(second: Any, lags: int) -> None:
    found = correlation(second.dataset(np.random.default_rng(1), 300), lags, integrator=False)

    assert found.lags.tolist() == [*range(-lags, lags + 1)]
    assert found.autocorrelation.shape == found.g.shape == (2 * lags + 1,)
    assert found.autocorrelation[lags] == 1.0
    np.testing.assert_allclose(found.autocorrelation, found.autocorrelation[::-1])


def test_the_band_of_independent_signals_has_its_confidence_level() -> None:
    """1 % of the lags lie outside for coloured u and y."""
    outside = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        u, y = (apply_filter([1.0], [1.0, -0.8], rng.standard_normal(800)) for _ in range(2))
        found = correlation(Dataset(u=u, y=y, Ts=1.0), 20, integrator=False)
        outside.append(np.mean(np.abs(found.g) > found.band(0.99)))

    assert 0.004 < np.mean(outside) < 0.02


def test_missing_samples_widen_the_band(second: Any) -> None:
    rng = np.random.default_rng(2)
    whole = second.dataset(rng, 10_000)
    holed = Dataset(u=whole.u, y=whole.y, Ts=1.0, valid=rng.random(10_000) > 0.3)

    a, b = (correlation(d, integrator=False) for d in (whole, holed))

    assert 1.1 < b.std / a.std < 1.35
    np.testing.assert_allclose(b.g, a.g, atol=4 * b.std)


def test_an_angle_is_correlated_by_its_rate(arm: Any) -> None:
    """A drift is correlated with everything."""
    found = correlation(arm.telegraph(std=1e-3))

    assert found.rate
    assert found.output == "velocity"
    assert np.argmax(np.abs(found.g)) == 20 + np.argmax(arm.rate(20))


@pytest.mark.parametrize(
    ("g", "first", "before"),
    [
        ([0, 0, 0, 9, -8, 0, 0], 0, 0),
        ([9, 0, -3, 0, 0, 5, -7], 2, 2),
        ([0, 4, 0, 1, 0, 0, 2.7], 3, 1),
        ([0, 0, 0, 1, 2, 0, 0], None, 0),
    ],
)
def test_correlations_outside_the_band_are_counted_before_and_after_lag_0(
    g: list[float], first: int | None, before: int
) -> None:
    found = Correlation(
        lags=np.arange(-3, 4), g=np.array(g), std=1.0, autocorrelation=np.eye(1, 7, 3)[0],
        whitener=np.array([1.0, 0.2, 0.1]), rate=False, N=80, Ts=0.5, output="y", unit="",
        input_unit="", source="",
    )  # fmt: skip
    largest = max(range(3, 7), key=lambda i: abs(g[i]))

    assert repr(found).splitlines() == [
        "correlation analysis of y, 80 samples at 0.5 s, input whitened by order 2",
        f"  largest g {float(g[largest]):.4g} at lag {largest - 3}; 99 % band of no relation ±2.58",
        f"  first lag >= 0 outside: {first}; {before} of 3 negative lags outside (feedback, if "
        "more than chance)",
    ]


def test_a_constant_input_and_too_many_lags_are_refused() -> None:
    with pytest.raises(ValueError, match="u is constant"):
        correlation(Dataset(u=np.ones(50), y=np.zeros(50), Ts=1.0), integrator=False)
    with pytest.raises(ValueError, match="lower lags"):
        correlation(
            Dataset(u=np.arange(30.0) % 7, y=np.arange(30.0) % 5, Ts=1.0), 28, integrator=False
        )
