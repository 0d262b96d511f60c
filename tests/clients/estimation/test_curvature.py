"""A fit warns of a loss that is no parabola, and of other doubts about its coefficients."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.estimation.fit_warnings import (
    curvature,
    parameter_warnings,
    search_warnings,
)
from armrig.estimation.problem import PolynomialProblem
from armrig.models.estimate import Start
from armrig.models.innovations import prepared
from armrig.models.structure import Structure
from armrig.numerics.levenberg_marquardt import Optimum
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


@pytest.mark.parametrize("converged", [False, True])
@pytest.mark.parametrize("agreed", [False, True])
def test_the_end_of_a_search_is_reported_with_its_numbers(converged: bool, agreed: bool) -> None:
    best = Optimum(theta=np.zeros(1), cost=3.0, iterations=17, converged=converged)
    starts = tuple(
        Start(name=name, loss=loss, iterations=k, converged=True)
        for k, (name, loss) in enumerate([("ARX", 0.5), ("OE", 0.75), ("FIR", 1.25)])
    )

    found = search_warnings(best, starts, agreed=agreed)
    told = [(x.text.partition(":")[0], x.remedy) for x in found]

    poorer = "the search from 'FIR' ended in a poorer minimum (loss 1.2)"
    assert told == [
        *([("the search did not converge in 17 steps", "order")] if not converged else []),
        *([(poorer, "")] if converged and not agreed else []),
    ]


@pytest.mark.parametrize(
    ("C", "rank", "curved", "coloured", "told"),
    [
        ([1.0], 4, 0.1, False, []),
        ([1.0, -0.999], 4, 0.1, True, []),
        ([1.0, 0.5, -0.5], 4, 0.1, False, ["root_on_circle"]),
        ([1.0], 3, 0.1, False, ["undetermined"]),
        ([1.0, 1.0], 2, 6.0, False, ["root_on_circle", "undetermined", "curved"]),
        ([1.0], 4, 6.0, True, []),
    ],
)
def test_undetermined_parameters_are_reported(
    C: list[float], rank: int, curved: float, coloured: bool, told: list[str]
) -> None:
    """If the residuals are coloured, the standard deviations are not trusted anyway."""
    white: Any = SimpleNamespace(coloured=coloured)

    warnings = list(parameter_warnings(np.zeros((4, rank)), white, np.array(C), curved))

    assert [x.about for x in warnings] == told
    for x in warnings:
        if x.about == "undetermined":
            assert x.text == f"the data determine only {rank} of 4 parameters: lower the orders"


def test_a_linear_regression_is_a_parabola() -> None:
    """ARX is linear, and n4sid has no covariance of such coefficients."""
    assert armrig.arx(plant(0.605, std=0.5), na=2, nb=2).curvature == 0.0


def test_the_curvature_is_the_logarithm_of_the_ratio_of_rises() -> None:
    """Both ways along the axis of one pole, two deviations away; where no model exists, it is 6."""
    data = plant(0.6, std=0.3)
    n = Structure(nb=(1,), nf=(1,), nk=(1,))
    problem = PolynomialProblem(experiments=((prepared(data.u, data.y, n),),), rows=(n,))
    f = problem.minimise(np.array([-0.8])).theta
    std, variance = 0.02, 0.1

    rises = [(problem.cost(f + s) - problem.cost(f)) / variance / 4 for s in (2 * std, -2 * std)]

    found = curvature(problem, f, np.array([[std**2]]), variance)
    assert found == pytest.approx(max(abs(np.log(rises))))
    assert curvature(problem, np.array([-0.9]), np.array([[0.01]]), 0.1) > 6
