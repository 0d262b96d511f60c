"""A fit warns of a loss that is no parabola, and of other doubts about its coefficients."""

from __future__ import annotations

import armrig
import numpy as np
import pytest
from armrig.estimation.fit_warnings import parameter_warnings, search_warnings
from armrig.estimation.problem import PolynomialProblem
from armrig.models.estimate import Start
from armrig.models.innovations import prepare
from armrig.models.structure import Structure
from armrig.numerics.curvature import MAX_TRUSTED, curvature, doubts
from armrig.numerics.levenberg_marquardt import Optimum
from armrig.numerics.polynomial import Array, apply_filter

from tests.sampling import sampled


def plant(zero: float, *, N: int = 1000, std: float = 0.05, seed: int = 1) -> armrig.Dataset:
    """Return data of poles 0.6 and 0.9 and a zero, with white noise."""
    rng = np.random.default_rng([seed, 28])
    u = armrig.telegraph(N, 0.1, 1.0, 4.0, seed=rng)
    y = apply_filter([0.0, 1.0, -zero], np.poly([0.6, 0.9]), u)
    return armrig.Dataset(u=u, y=y + std * rng.standard_normal(N), Ts=1.0)


def test_separate_poles_and_zeros_are_trusted() -> None:
    fit = armrig.oe(plant(-0.5), nb=2, nf=2)

    assert fit.search.curvature < 0.1
    assert fit.trusts_coefficients
    assert str(fit).count(": trust std\n") == 1
    assert not fit.warnings


@pytest.mark.parametrize("estimator", sampled(["oe", "bj"]))
def test_a_zero_on_a_pole_makes_coefficients_that_are_not_trusted(estimator: str) -> None:
    data = plant(0.605, std=0.5)
    noise = {"nc": 1, "nd": 1} if estimator == "bj" else {}
    fit = getattr(armrig, estimator)(data, nb=2, nf=2, **noise)

    assert not fit.trusts_coefficients
    assert "trust neither std nor std_robust" in str(fit)
    assert any(
        w.startswith("do not trust the standard deviations: the loss is far from parabolic")
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
    ("C", "rank", "told"),
    [
        ([1.0], 4, []),
        ([1.0, -0.999], 4, []),
        ([1.0, 0.5, -0.5], 4, ["root_on_circle"]),
        ([1.0], 3, ["undetermined"]),
        ([1.0, 1.0], 2, ["root_on_circle", "undetermined"]),
    ],
)
def test_undetermined_parameters_are_reported(C: list[float], rank: int, told: list[str]) -> None:
    warnings = list(parameter_warnings(np.zeros((4, rank)), np.array(C)))

    assert [x.about for x in warnings] == told
    for x in warnings:
        if x.about == "undetermined":
            assert x.text == f"the data determine only {rank} of 4 parameters: lower the orders"


def test_each_output_of_a_model_is_judged() -> None:
    """The second output has a zero on a pole."""
    good, bad = plant(-0.5), plant(0.605, std=0.5)
    signals = armrig.Signals(u=good.u[:, None], y=np.column_stack([good.y, bad.y]), Ts=1.0)

    fit = armrig.oe(signals, nb=2, nf=2)

    assert fit.search.curvature == armrig.oe(bad, nb=2, nf=2).search.curvature > 0.3
    assert any("far from parabolic" in text for text in fit.warnings)


def test_coloured_residuals_hide_no_curvature() -> None:
    data = plant(0.605, std=0.0)
    v = apply_filter([1.0, 0.7, 0.3], [1.0], np.random.default_rng(5).standard_normal(data.N))
    fit = armrig.oe(armrig.Dataset(u=data.u, y=data.y + 0.4 * v, Ts=1.0), nb=2, nf=2)

    assert fit.trusts_robust
    assert not fit.trusts_coefficients
    assert "trust neither std nor std_robust" in str(fit)


def test_a_linear_regression_is_a_parabola() -> None:
    """ARX is linear, and n4sid has no covariance of such coefficients."""
    assert armrig.arx(plant(0.605, std=0.5), na=2, nb=2).search.curvature == 0.0


@pytest.mark.parametrize("exponent", [0.0, 0.5])
def test_the_curvature_is_the_spread_of_the_likelihood_ratio(exponent: float) -> None:
    """V = 3 (f² + exponent f⁴) for f in deviations: ln r is -exponent f⁴/2."""
    std, draws = 0.02, np.random.default_rng(0).standard_normal((40, 1))[:, 0]

    def cost(theta: Array) -> float:
        f = float(theta[0] - 0.7) / std
        return 3 * (f**2 + exponent * f**4)

    found = curvature(cost, np.array([0.7]), np.array([[std**2]]), 3.0)

    logs = np.append(exponent * draws**4 / 2, 0.0)
    assert found == pytest.approx(np.std(logs), abs=1e-12)
    assert curvature(cost, np.array([0.7]), np.array([[0.0]]), 3.0) == 0.0


@pytest.mark.parametrize("beyond", [np.nan, np.inf, 1e300])
def test_a_minimum_that_no_draw_shares_is_not_trusted(beyond: float) -> None:
    """No model, or none that fits, at any of the draws: each has the same likelihood ratio."""

    def cost(theta: Array) -> float:
        return 0.0 if theta[0] == 0.7 else beyond

    assert curvature(cost, np.array([0.7]), np.eye(1), 1.0) > 1
    assert curvature(lambda _: beyond, np.array([0.7]), np.eye(1), beyond) > MAX_TRUSTED


def test_the_curvature_with_slow_noise_is_that_at_the_printed_deviations() -> None:
    """A parabola seen two deviations wide, or four: only the wider one reaches its edge."""
    wide = np.array([[4.0]])

    def cost(theta: Array) -> float:
        return float(theta[0] ** 2 + 10 * max(abs(theta[0]) - 3.0, 0) ** 2)

    assert curvature(cost, np.zeros(1), np.eye(1), 1.0) < 0.1
    assert curvature(cost, np.zeros(1), np.eye(1), 1.0, used=wide) > 0.5


def test_a_follower_moves_as_in_the_parabola() -> None:
    """V = (a - f)² + f²: a follows f, whose deviation is 1, and the loss is a parabola."""
    covariance = np.array([[2.0, 1.0], [1.0, 1.0]])
    seen = []

    def cost(theta: Array) -> float:
        a, f = theta
        seen.append((a, f))
        return float((a - f) ** 2 + f**2)

    assert curvature(cost, np.zeros(2), covariance, 1.0, followers=slice(0, 1)) < 1e-12
    assert all(a == pytest.approx(f) for a, f in seen)


def test_slow_noise_that_leaves_few_independent_samples_is_a_doubt() -> None:
    """The robust variance is nine times the classic one: 300 samples count as 33."""
    P = np.diag([1.0, 4.0, 0.0])

    assert doubts(0.1, P, 9 * P, N=300, coloured=False) == []
    assert doubts(0.1, P, 9 * P, N=3000, coloured=True) == []
    assert doubts(0.1, P, 9 * P, N=300, coloured=True, outputs=2) == []  # 600 samples
    [(name, text)] = doubts(0.1, P, 9 * P, N=300, coloured=True)
    assert name == "few_independent"
    assert "300 samples count as 33 independent ones" in text
    assert [name for name, _ in doubts(0.5, P, P, N=300, coloured=True)] == ["curved"]


def test_the_deviations_after_gaps_are_those_of_the_loss() -> None:
    """The variances of (a, c) are those of the inverse of the curvature, in the mean of 8 records.

    With the scale of the errors counted twice, the variance of c would be 0.75 of the other. The
    derivatives contain half of the information in the variances of the errors, so it is above 1.
    """
    ratios = []
    for seed in range(8):
        rng = np.random.default_rng([5, seed])
        u, e = np.cumprod(np.where(rng.random(600) < 0.1, -1.0, 1.0)), rng.standard_normal(600)
        y = apply_filter([0, 0.3, 0.2], [1, -1.4, 0.7], u)
        y += 0.1 * apply_filter([1, 0.5], [1, -1.4, 0.7], e)
        data = armrig.Dataset(u=u, y=y, Ts=0.1, valid=rng.random(600) >= 0.3)
        fit = armrig.armax(data, na=2, nb=2, nc=1, starts="few")
        n = Structure(na=2, nb=(2,), nc=1, nf=(0,), nk=(1,))
        problem = PolynomialProblem(experiments=((prepare(data.u, data.y, n),),), rows=(n,))
        own = [0, 1, 4]
        at, std, least = fit.theta[own], fit.std[own], problem.cost(fit.theta[own])
        steps = 0.2 * np.diag(std)

        rises = [
            [problem.cost(at + a + b) - problem.cost(at + a - b) for b in steps] for a in steps
        ]

        H = fit.N * np.array(rises) / least / 0.04 / 4
        covariance = fit.covariance[np.ix_(own, own)] / np.outer(std, std)
        ratios.append(np.diag(covariance) / np.diag(np.linalg.inv(H)))
    np.testing.assert_allclose(np.mean(ratios, axis=0), [1, 1, 1.1], atol=0.1)


def test_arx_and_iv4_give_the_reason_why_no_deviation_is_trusted() -> None:
    """Some of 40 records of slow noise leave few independent samples."""
    seen = set()
    for seed in range(40):
        rng = np.random.default_rng([seed, 6])
        u = np.cumprod(np.where(rng.random(120) < 0.1, -1.0, 1.0))
        v = apply_filter([1.0], [1.0, -0.9], rng.standard_normal(120))
        y = apply_filter([0.0, 0.5, 0.3], [1.0, -0.8, 0.2], u) + 0.3 * v
        data = armrig.Dataset(u=u, y=y, Ts=1.0)
        for fit in (armrig.arx(data, na=2, nb=2), armrig.iv4(data, na=2, nb=2)):
            reasons = [x for x in fit.findings if x.about in ("curved", "few_independent")]
            assert bool(reasons) != fit.trusts_coefficients
            seen.add((fit.structure, bool(reasons)))

    assert seen == {(name, doubted) for name in ("arx", "iv4") for doubted in (False, True)}
