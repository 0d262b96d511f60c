"""If the loss is no parabola, a fit warns of the deviations of its coefficients."""

from __future__ import annotations

import armrig
import numpy as np
import pytest
from armrig.estimation.prediction_error import PredictionErrorProblem
from armrig.estimation.prediction_error_fit import curvature
from armrig.models.innovations import prepared
from armrig.models.structure import Structure
from armrig.numerics.polynomial import filtered

from tests.sampling import sampled


def plant(zero: float, *, N: int = 1000, std: float = 0.05, seed: int = 1) -> armrig.Dataset:
    """Return data of poles 0.6 and 0.9 and a zero, with white noise."""
    rng = np.random.default_rng([seed, 28])
    u = armrig.telegraph(N, 0.1, 1.0, 4.0, seed=rng)
    y = filtered([0.0, 1.0, -zero], np.poly([0.6, 0.9]), u)
    return armrig.Dataset(u=u, y=y + std * rng.standard_normal(N), Ts=1.0)


def test_separate_poles_and_zeros_are_trusted() -> None:
    """Two deviations away the loss rises as its second derivative predicts, to a third."""
    fit = armrig.oe(plant(-0.5), nb=2, nf=2)

    assert fit.curvature < 0.3
    assert fit.trusts_coefficients
    assert str(fit).count(": trust std\n") == 1
    assert not fit.warnings


@pytest.mark.parametrize("estimator", sampled(["oe", "bj"]))
def test_a_zero_on_a_pole_makes_coefficients_that_are_not_trusted(estimator: str) -> None:
    data = plant(0.605, std=0.5)
    noise = {"nc": 1, "nd": 1} if estimator == "bj" else {}
    fit = getattr(armrig, estimator)(data, nb=2, nf=2, **noise)

    assert not fit.trusts_coefficients
    assert "trust std of the responses, not of the coefficients" in str(fit)
    assert any(
        w.startswith("do not trust the standard deviations of the coefficients")
        for w in fit.warnings
    )


def test_a_linear_regression_is_a_parabola() -> None:
    """ARX is linear, and n4sid has no covariance of such coefficients."""
    assert armrig.arx(plant(0.605, std=0.5), na=2, nb=2).curvature == 0.0


def test_it_is_the_logarithm_of_the_ratio_of_rises() -> None:
    """Both ways along the axis of one pole, two deviations away."""
    data = plant(0.6, std=0.3)
    n = Structure(nb=1, nf=1, nk=1)
    problem = PredictionErrorProblem(experiments=(prepared(data, n),), structure=n)
    f = problem.minimise(np.array([-0.8])).theta
    std, variance = 0.02, 0.1

    rises = [(problem.cost(f + s) - problem.cost(f)) / variance / 4 for s in (2 * std, -2 * std)]

    found = curvature(problem, f, np.array([[std**2]]), variance)
    assert found == pytest.approx(max(abs(np.log(rises))))


def test_a_pole_that_may_be_unstable_is_not_trusted() -> None:
    """Two deviations away no model exists."""
    data = plant(0.6, std=0.3)
    n = Structure(nb=1, nf=1, nk=1)
    problem = PredictionErrorProblem(experiments=(prepared(data, n),), structure=n)

    assert curvature(problem, np.array([-0.9]), np.array([[0.01]]), 0.1) > 6


def test_it_is_kept_in_the_file(tmp_path: object) -> None:
    fit = armrig.oe(plant(0.605, std=0.5), nb=2, nf=2)
    path = f"{tmp_path}/model.json"
    fit.save(path)

    assert armrig.load_fit(path).curvature == fit.curvature
