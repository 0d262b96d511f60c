"""The empirical transfer function estimate, exact where the input repeats itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation.nonparametric.etfe import etfe, period
from armrig.numerics.polynomial import apply_filter
from numpy.typing import NDArray

P = 200


def repeated(rng: np.random.Generator, periods: int = 5) -> NDArray[np.float64]:
    """Return whole periods of a signal with the same power at every line."""
    phase = rng.uniform(0, 2 * np.pi, P // 2 - 1)
    lines = np.concatenate([[0.0], np.exp(1j * phase), [1.0]])
    return np.tile(2.5 + 3 * np.fft.irfft(lines, P), periods)


def noisy(seed: int, std: float, periods: int = 5) -> Dataset:
    rng = np.random.default_rng(seed)
    u = repeated(np.random.default_rng(0), periods)
    y = apply_filter([0, 1, 0.5], [1, -1.2, 0.6], u) + std * rng.standard_normal(u.size)
    return Dataset(u=u, y=y, Ts=1.0)


def test_whole_periods_without_noise_give_the_exact_response(second: Any) -> None:
    """At every line but 0, to rounding; the transient is in the period left out."""
    found = etfe(noisy(1, 0.0), integrator=False)

    np.testing.assert_allclose(found.G, second.response(found.omega), rtol=1e-9)
    np.testing.assert_allclose(found.omega, 2 * np.pi * np.arange(1, P // 2 + 1) / P)
    assert "periods of 200 samples" in found.method


def test_two_periods_give_a_response_without_a_deviation(second: Any) -> None:
    data = noisy(1, 0.0, periods=2)

    for of in ({}, {"period_length": P}):
        found = etfe(data, **of, integrator=False)
        np.testing.assert_allclose(found.G, second.response(found.omega), rtol=1e-9)
        assert np.isnan(found.std_magnitude).all()


def test_the_noise_is_estimated_from_the_scatter_between_periods(second: Any) -> None:
    """The reported deviations are those of 150 runs."""
    found = [etfe(noisy(s, 0.5, 6), integrator=False) for s in range(150)]
    truth = second.response(found[0].omega)

    error = np.array([f.magnitude - np.abs(truth) for f in found])[:, :-1]
    said = np.array([f.std_magnitude for f in found])[:, :-1]
    assert np.sqrt(np.mean(error**2) / np.mean(said**2)) == pytest.approx(1.0, abs=0.05)


def test_a_sample_missing_in_one_period_is_averaged_over_the_others(second: Any) -> None:
    data = noisy(1, 0.0)
    valid = np.ones(data.N, dtype=np.bool_)
    valid[300:340] = False

    found = etfe(Dataset(u=data.u, y=data.y, Ts=1.0, valid=valid), integrator=False)

    np.testing.assert_allclose(found.G, second.response(found.omega), rtol=1e-9)
    assert np.isfinite(found.std_magnitude).all()  # from the periods that are whole
    assert found.N == data.N - 40


def test_an_etfe_of_an_input_without_a_period_reports_this(second: Any) -> None:
    data = second.dataset(np.random.default_rng(3), 4000, std=0.1)

    found = etfe(data, integrator=False)

    assert "no period" in found.method
    assert np.isnan(found.std_magnitude).all()
    assert np.median(np.abs(found.G / second.response(found.omega) - 1)) < 0.2


@pytest.mark.parametrize(
    ("u", "expected"),
    [
        (np.tile([0.0, 1.0, 3.0], 4), 3),
        (np.tile([0.0, 1.0], 5), 2),
        (np.arange(10.0), None),
        (np.ones(10), None),
        (np.append(np.tile([0.0, 1.0, 3.0], 4), 9.0), None),
    ],
)
def test_the_period_of_a_periodic_input_is_found(
    u: NDArray[np.float64], expected: int | None
) -> None:
    assert period(u) == expected


def test_a_sample_missing_in_all_periods_and_a_constant_input_are_refused() -> None:
    periodic = noisy(1, 0.0)
    never = np.arange(periodic.N) % P != 7

    with pytest.raises(ValueError, match="1 of the 200 instants"):
        etfe(Dataset(u=periodic.u, y=periodic.y, Ts=1.0, valid=never), integrator=False)
    with pytest.raises(ValueError, match="u is constant"):
        etfe(Dataset(u=np.ones(50), y=np.zeros(50), Ts=1.0), integrator=False)
