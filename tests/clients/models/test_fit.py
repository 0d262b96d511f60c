"""Answers of a fit: poles, responses, prediction, and a repr that reads like a result."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation.arx import arx
from armrig.estimation.polynomial_structures import oe
from armrig.models.estimate import PastProjection
from armrig.models.fit import Fit
from armrig.numerics.polynomial import apply_filter
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.clients.models.made_fits import changed

B, F = np.array([0, 0, 1.0, 0.5]), np.array([1, -1.2, 0.6])


def data(seed: int, N: int = 400, noise: float = 0.2) -> Dataset:
    """Return y = B/F u + e."""
    u, e = np.random.default_rng(seed).standard_normal((2, N))
    return Dataset(u=u, y=apply_filter(B, F, u) + noise * e, Ts=0.1, output="speed", unit="rad/s")


@pytest.fixture(scope="module")
def fit() -> Fit:
    return oe(data(1), nb=2, nf=2, nk=2)


def test_a_fit_cannot_be_changed(fit: Fit) -> None:
    with pytest.raises(AttributeError):
        fit.loss = 0.0  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        fit.F[0] = 2.0


def test_a_frequency_beyond_nyquist_is_refused(fit: Fit) -> None:
    with pytest.raises(ValueError, match=r"outside 0 to 31.4159 rad/s \(pi/Ts\)"):
        fit.frequency_response([1.0, 40.0])


def test_the_response_of_an_integrator_is_accurate_near_zero_frequency() -> None:
    """G tends to b / (F̃(1) i omega Ts), so no coefficients cancel."""
    rest = np.array([1, -1.3, 0.47])
    F = np.convolve([1, -1], rest)
    fit = Fit.of_channel(B=[0, 0.3], F=F, nk=1, integrator=True, Ts=0.01)
    omega = np.array([1e-9, 1e-8])

    G = fit.frequency_response(omega).G

    np.testing.assert_allclose(G, 0.3 / (rest.sum() * 1j * omega * 0.01), rtol=1e-8)


@pytest.mark.parametrize("n", [0, -1, 2.5, "3", None, True])
def test_a_step_response_of_zero_length_is_refused(fit: Fit, n: Any) -> None:
    with pytest.raises(ValueError, match=f"n={n!r} must be an integer >= 1"):
        fit.step_response(n)


def test_the_criteria_equal_the_formulas_of_the_textbook(fit: Fit) -> None:
    assert fit.fpe == pytest.approx(fit.loss * (1 + 4 / 400) / (1 - 4 / 400))
    deviance = 400 * (np.log(2 * np.pi * fit.loss) + 1)
    assert fit.aic == pytest.approx(deviance + 8)
    assert fit.mdl == pytest.approx(deviance + 4 * np.log(400))


@settings(max_examples=25)
@given(st.integers(1, 6), st.integers(0, 1000))
def test_an_arx_model_predicts_k_samples_by_its_difference_equation(k: int, seed: int) -> None:
    """The reference iterates the difference equation by hand from the last k-th sample."""
    d = data(seed, N=60)
    fit = arx(d, na=2, nb=2, nk=1)

    y = fit.predict(d, horizon=k)

    for t in (20, 45):
        known = list(d.y[: t - k + 1])
        for s in range(t - k + 1, t + 1):
            known.append(-fit.A[1:] @ [known[s - 1], known[s - 2]] + fit.B @ d.u[s - np.arange(3)])
        assert y[t] == pytest.approx(known[t])
    assert np.isnan(y[: 2 + k - 1]).all()
    assert np.isfinite(y[2 + k - 1 :]).all()


def test_the_trusted_covariance_depends_on_the_residuals(fit: Fit) -> None:
    d = fit.theta.size
    made_up = replace(fit, covariance=np.eye(d), covariance_robust=9 * np.eye(d))
    white, coloured = (changed(made_up, whiteness=p) for p in (0.5, 0.001))

    assert white.trusted_covariance[0, 0] == 1.0
    assert coloured.trusted_covariance[0, 0] == 9.0
    assert (made_up.std[0], made_up.std_robust[0]) == (1.0, 3.0)


@pytest.mark.parametrize(
    ("part", "name"),
    [
        *(("search", x) for x in ("converged", "starts", "agreed", "curvature")),
        *(("projection", x) for x in ("weights", "horizon", "singular_values", "suggested_order")),
        ("projection", "canonical_correlations"),
    ],
)
def test_a_value_of_a_search_or_projection_warns_under_its_earlier_name(
    part: str, name: str, fit: Fit
) -> None:
    projected = replace(fit, projection=PastProjection(weights="cva", horizon=9))

    with pytest.warns(DeprecationWarning, match=rf"fit.{name} is fit.{part}.{name} now"):
        value = getattr(projected, name)
    assert value is getattr(getattr(projected, part), name)
    with pytest.warns(DeprecationWarning, match="fit.horizon is"):
        assert not fit.horizon
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = projected.nothing
