"""ARMAX, Box-Jenkins, the general structure and instruments: models whose noise has a colour."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.data.treatment import detrend
from armrig.estimation.arx import arx
from armrig.estimation.iv4 import iv4
from armrig.estimation.polynomial_structures import ararx, armax, bj, oe, pem
from armrig.excitation import telegraph
from armrig.models.fit import Fit
from armrig.numerics.polynomial import apply_filter
from armrig.numerics.whiteness import autoregression
from armrig.validation.residuals import residuals
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant

A, B = np.array([1, -1.2, 0.6]), np.array([0, 1.0, 0.5])
C, D = np.array([1, 0.5]), np.array([1, -0.7])


def data(seed: int, H: tuple[NDArray, NDArray], N: int = 600, std: float = 0.5) -> Dataset:
    """Return y = B/A u + H e from a state of long ago."""
    rng = np.random.default_rng(seed)
    u = telegraph(N + 200, 0.3, 1.5, 3.5, seed=rng) - 2.5
    y = apply_filter(B, A, u) + apply_filter(*H, std * rng.standard_normal(N + 200))
    return Dataset(u=u[200:], y=y[200:], Ts=0.1, output="speed", unit="rad/s")


def armax_data(seed: int, **kwargs: float) -> Dataset:
    """Return A y = B u + C e."""
    return data(seed, (C, A), **kwargs)  # type: ignore[arg-type]


def ararx_data(seed: int, **kwargs: float) -> Dataset:
    """Return A y = B u + e/D."""
    return data(seed, (np.ones(1), np.convolve(A, D)), **kwargs)  # type: ignore[arg-type]


def bj_data(seed: int, **kwargs: float) -> Dataset:
    """Return y = B/A u + C/D e."""
    return data(seed, (C, D), **kwargs)  # type: ignore[arg-type]


Case = tuple[Callable[..., Fit], Callable[..., Dataset], dict[str, int], list[float]]
CASES: list[Case] = [
    (armax, armax_data, {"na": 2, "nb": 2, "nc": 1}, [-1.2, 0.6, 1, 0.5, 0.5]),
    (bj, bj_data, {"nb": 2, "nc": 1, "nd": 1, "nf": 2}, [1, 0.5, 0.5, -0.7, -1.2, 0.6]),
    (pem, bj_data, {"nb": 2, "nc": 1, "nd": 1, "nf": 2}, [1, 0.5, 0.5, -0.7, -1.2, 0.6]),
    (ararx, ararx_data, {"na": 2, "nb": 2, "nd": 1}, [-1.2, 0.6, 1, 0.5, -0.7]),
]


@pytest.mark.parametrize("case", CASES)
def test_the_true_system_is_found(case: Case) -> None:
    """Every coefficient within four deviations, both forms of them alike, the residuals white."""
    estimate, made, orders, truth = case
    fit = estimate(made(1, N=4000), **orders)

    assert (np.abs(fit.theta - truth) < 4 * fit.std).all()
    assert (fit.std < 0.05).all()
    np.testing.assert_allclose(fit.std_robust, fit.std, rtol=0.15)
    assert fit.search.converged
    assert fit.search.agreed
    assert fit.whiteness > 0.01
    assert fit.noise_variance == pytest.approx(0.25, rel=0.1)


@pytest.mark.parametrize("case", CASES)
def test_gaps_and_several_experiments_do_not_bias_the_estimate(case: Case) -> None:
    """Five experiments with 3 % of the samples missing."""
    estimate, made, orders, truth = case
    whole = made(2, N=6000)
    valid = np.random.default_rng(0).random(whole.N) > 0.03
    parts = [
        Dataset(u=d.u, y=np.where(v, d.y, 1e6), Ts=0.1, valid=v)
        for d, v in zip(whole.split(5), np.split(valid, 5), strict=True)
    ]

    fit = estimate(merge(parts), **orders, starts="few")

    assert (np.abs(fit.theta - truth) < 4 * fit.std).all()
    assert (fit.std < 0.06).all()
    assert len(fit.free) == 5


def test_without_a_noise_model_box_jenkins_is_output_error() -> None:
    seen = data(3, (np.ones(1), np.ones(1)))

    same, expected = bj(seen, nb=2, nc=0, nd=0, nf=2), oe(seen, nb=2, nf=2)

    np.testing.assert_allclose(same.theta, expected.theta, rtol=1e-8)
    np.testing.assert_allclose(same.std, expected.std, rtol=1e-8)
    np.testing.assert_allclose(same.std_robust, expected.std_robust, rtol=1e-8)


@pytest.mark.parametrize(("estimate", "noise"), [(armax, "nc"), (ararx, "nd")])
def test_without_a_noise_model_an_equation_error_is_that_of_arx(
    estimate: Callable[..., Fit], noise: str
) -> None:
    seen = data(4, (np.ones(1), A))
    valid = np.random.default_rng(1).random(seen.N) > 0.05
    holed = Dataset(u=seen.u, y=seen.y, Ts=0.1, valid=valid)

    same, expected = estimate(holed, na=2, nb=2, **{noise: 0}), arx(holed, na=2, nb=2)

    assert same.N == expected.N
    np.testing.assert_allclose(same.theta, expected.theta, rtol=1e-9)
    np.testing.assert_allclose(same.covariance, expected.covariance, rtol=1e-8)
    np.testing.assert_allclose(same.covariance_robust, expected.covariance_robust, rtol=1e-8)
    assert same.loss == pytest.approx(expected.loss, rel=1e-12)


def test_the_state_before_the_first_sample_does_not_bias_the_estimate(plant: HandoutPlant) -> None:
    """With almost no noise any initial state gives back the plant."""
    whole = plant.dataset(1, std=1e-5)

    fit = bj(whole[700:], nb=4, nc=1, nd=1, nf=4, integrator=True, starts="few")

    np.testing.assert_allclose(fit.theta[:4], plant.B[1:], rtol=0, atol=1e-4)
    np.testing.assert_allclose(fit.theta[6:], plant.F[1:], rtol=0, atol=1e-2)
    assert np.count_nonzero(fit.poles().values == 1.0) == 1


def test_the_deviations_of_an_ararx_model_hold() -> None:
    """Errors divided by their deviations have a mean square of 1 in 60 runs, in both forms."""
    fits = [ararx(ararx_data(k, N=300), na=2, nb=2, nd=1, starts="few") for k in range(60)]
    error = np.array([fit.theta for fit in fits]) - [-1.2, 0.6, 1, 0.5, -0.7]

    for name in ("std", "std_robust"):
        z = error / [getattr(fit, name) for fit in fits]
        assert ((z**2).mean(axis=0) < 1.6).all(), name
        assert 0.75 < (z**2).mean() < 1.25, name


@pytest.mark.parametrize(
    "case",
    [(armax, armax_data, {"nc": 1}, [1, 0.5, 0.5]), (ararx, ararx_data, {"nd": 1}, [1, 0.5, -0.7])],
    ids=["armax", "ararx"],
)
def test_a_model_of_equation_error_may_integrate_its_noise(case: Case) -> None:
    """(1 - q^-1) Ã y = B (u - u0) + C e or + e/D: the model of the rate, with the offset found."""
    estimate, made, orders, truth = case
    rate = made(5, N=3000)
    angle = Dataset(u=rate.u + 0.3, y=np.cumsum(rate.y), Ts=0.1)

    fit = estimate(angle, na=3, nb=2, **orders, integrator=True)

    assert (np.abs(fit.theta[3:] - truth) < 4 * fit.std[3:]).all()
    np.testing.assert_allclose(fit.A, np.convolve([1, -1], A), atol=0.1)
    assert abs(fit.A.sum()) < 1e-12
    assert fit.free[0].offset == pytest.approx(0.3, abs=0.06 if "nc" in orders else 0.1)
    assert np.count_nonzero(fit.poles().values == 1.0) == 1
    assert np.isinf(np.abs(fit.frequency_response([0.0]).G[0]))
    assert np.isinf(fit.noise_spectrum([0.0]).Phi[0])
    assert fit.parameters == 5
    assert "A has the factor 1 - q^-1" in repr(fit)


@pytest.mark.parametrize("case", CASES)
def test_an_input_offset_is_estimated_with_the_model(case: Case) -> None:
    estimate, made, orders, truth = case
    seen = made(6, N=3000)
    moved = Dataset(u=seen.u + 2.5, y=seen.y, Ts=0.1)

    fit = estimate(moved, **orders, offset=True, starts="few")

    assert (np.abs(fit.theta - truth) < 4 * fit.std).all()
    assert fit.free[0].offset == pytest.approx(2.5, abs=0.1)
    assert residuals(fit, moved).white.p_value == pytest.approx(fit.whiteness, rel=1e-3)


def test_the_initial_state_is_kept_if_an_f_test_is_significant() -> None:
    rng = np.random.default_rng(7)
    u = rng.standard_normal(400)
    y = apply_filter(B, A, u) + apply_filter(C, D, 0.05 * rng.standard_normal(400))
    orders = {"nb": 2, "nc": 1, "nd": 1, "nf": 2}
    rest, moving = Dataset(u=u, y=y, Ts=1), Dataset(u=u[100:], y=y[100:], Ts=1)

    fits = {
        (name, initial): bj(part, **orders, initial=initial, starts="few")
        for name, part in (("rest", rest), ("moving", moving))
        for initial in ("auto", "zero", "estimate")
    }

    assert fits["rest", "auto"].loss == fits["rest", "zero"].loss
    assert fits["moving", "auto"].loss == fits["moving", "estimate"].loss
    assert fits["moving", "zero"].loss > 2 * fits["moving", "estimate"].loss


@pytest.mark.parametrize("initial", ["zero", "auto"])
def test_an_offset_of_a_rig_at_rest_is_refused(initial: Literal["zero", "auto"]) -> None:
    with pytest.raises(
        ValueError, match=f"offset=True needs initial=\"estimate\", got '{initial}'"
    ):
        armax(armax_data(1), na=1, nb=1, nc=1, offset=True, initial=initial)


def test_the_starts_of_a_noise_model_are_reported() -> None:
    three = bj(bj_data(8), nb=2, nc=1, nd=1, nf=2)
    two = armax(armax_data(8), na=2, nb=2, nc=1)

    assert {s.name for s in three.search.starts} >= {
        "ARX",
        "OE",
        "high-order ARX, Steiglitz-McBride",
    }
    assert {s.name for s in two.search.starts} == {"ARX", "Hannan-Rissanen"}
    assert all(s.converged for s in (*three.search.starts, *two.search.starts))


@pytest.mark.parametrize(
    "options", [{"offset": True}, {"integrator": True, "initial": "zero"}], ids=["offset", "angle"]
)
def test_a_prediction_without_c_finds_the_level_of_u(options: dict[str, Any]) -> None:
    """One sample ahead the model errs by the noise alone, though the voltmeter is 2 V off."""
    rng = np.random.default_rng(12)
    u = rng.choice([-1.0, 1.0], 400)
    y = apply_filter([0, 0.3], [1, -0.6], u) + apply_filter(
        [1], [1, -0.6], 0.05 * rng.standard_normal(400)
    )
    y = np.cumsum(y) if "integrator" in options else y
    fit = armax(Dataset(u=u, y=y, Ts=0.1), na=2, nb=2, nc=0, **options)

    error = y - fit.predict(Dataset(u=u + 2.0, y=y, Ts=0.1), horizon=1)

    assert abs(np.nanmean(error)) < 0.01
    assert np.nanstd(error) == pytest.approx(0.05, rel=0.1)


def test_residuals_of_the_estimation_are_those_of_the_test() -> None:
    for estimate, made, orders, _ in CASES:
        seen = made(12)[50:]
        fit = estimate(seen, **orders, starts="few")

        tested = residuals(fit, seen)

        assert np.nanmean(tested.e**2) == pytest.approx(fit.loss, rel=1e-9)
        assert tested.white.p_value == pytest.approx(fit.whiteness, rel=1e-6)
        assert tested.on_estimation_data


def test_the_hair_dryer_has_a_coloured_noise(
    reference: Callable[[str], NDArray[np.float64]],
) -> None:
    u, y = reference("dryer.dat")[:500].T
    seen = detrend(Dataset(u=u, y=y, Ts=0.08))

    fit = bj(seen, nb=2, nc=2, nd=2, nf=2, nk=3, starts="few")

    assert fit.whiteness > 0.05
    assert arx(seen, na=2, nb=2, nk=3).whiteness < 0.01
    assert fit.loss < 0.9 * arx(seen, na=2, nb=2, nk=3).loss


def test_instrumental_variables_are_not_biased_by_coloured_noise() -> None:
    fits = [iv4(bj_data(seed), na=2, nb=2) for seed in range(200)]
    truth = [-1.2, 0.6, 1.0, 0.5]

    error = np.array([f.theta for f in fits]) - truth
    scatter = error.std(axis=0, ddof=1)

    assert (np.abs(error.mean(axis=0)) < 4 * scatter / np.sqrt(200)).all()
    for name in ("std", "std_robust"):
        ratio = np.mean([getattr(f, name) for f in fits], axis=0) / scatter
        assert ((ratio > 0.85) & (ratio < 1.15)).all(), (name, ratio)
    noisy = [bj_data(seed, std=2.0) for seed in range(50)]
    squares = np.array([arx(seen, na=2, nb=2).theta for seen in noisy]) - truth
    assert (np.abs(squares.mean(axis=0)) > 10 * squares.std(axis=0) / np.sqrt(50)).any()


def test_the_four_stages_are_those_of_the_textbook() -> None:
    """Ljung, (15.21) to (15.24), written out."""
    seen = bj_data(3, N=300)
    n = np.arange(2, 300)
    Phi = np.column_stack([-seen.y[n - 1], -seen.y[n - 2], seen.u[n - 1], seen.u[n - 2]])

    def instruments(theta: NDArray) -> NDArray:
        x = apply_filter(np.append(0.0, theta[2:]), np.append(1.0, theta[:2]), seen.u)
        return np.column_stack([-x[n - 1], -x[n - 2], seen.u[n - 1], seen.u[n - 2]])

    first = np.linalg.lstsq(Phi, seen.y[n], rcond=None)[0]
    Z = instruments(first)
    second = np.linalg.solve(Z.T @ Phi, Z.T @ seen.y[n])
    L, _ = autoregression([seen.y[n] - Phi @ second])
    colour = L.size - 1
    Z, rows, y = (
        np.apply_along_axis(lambda x: apply_filter(L, [1.0], x), 0, M)[colour:]
        for M in (instruments(second), Phi, seen.y[n])
    )
    theta = np.linalg.solve(Z.T @ rows, Z.T @ y)
    e = y - rows @ theta
    middle = np.linalg.inv(Z.T @ rows)
    expected = e @ e / (e.size - 4) * middle @ Z.T @ Z @ middle.T

    fit = iv4(seen, na=2, nb=2)

    assert colour > 0
    np.testing.assert_allclose(fit.theta, theta, rtol=1e-9)
    np.testing.assert_allclose(fit.covariance, expected, rtol=1e-7)
    v = seen.y[n] - Phi @ theta
    assert fit.loss == pytest.approx(v @ v / n.size)
    assert fit.noise_variance == pytest.approx(v @ v / (n.size - 4))


def test_instrumental_variables_omit_missing_samples() -> None:
    whole = bj_data(1, N=3000)
    valid = np.random.default_rng(2).random(whole.N) > 0.01
    spoilt = Dataset(u=whole.u, y=np.where(valid, whole.y, 1e6), Ts=0.1, valid=valid)

    fit = iv4(merge(spoilt.split(2)), na=2, nb=2)

    assert (np.abs(fit.theta - [-1.2, 0.6, 1.0, 0.5]) < 4 * fit.std_robust).all()
    assert (fit.std < 0.05).all()
    assert "A(q) y(t) = B(q) u(t) + v(t)" in repr(fit)


def test_an_order_too_high_for_the_data_is_refused() -> None:
    seen = bj_data(1)[:12]

    with pytest.raises(ValueError, match=r"nf=2, nk=1 needs at least \d+ samples, got 12"):
        bj(seen, nb=2, nc=2, nd=2, nf=2)
    with pytest.raises(ValueError, match=r"nc=-1 must be an integer >= 0"):
        armax(seen, na=1, nb=1, nc=-1)
    with pytest.raises(ValueError, match=r"nd=-1 must be an integer >= 0"):
        ararx(seen, na=1, nb=1, nd=-1)
    with pytest.raises(ValueError, match=r"na must be at least 1 with an integrator, because"):
        ararx(seen, na=0, nb=1, nd=1, integrator=True)
    with pytest.raises(ValueError, match=r"na=2, nb=2, nd=2, nk=1 needs at least \d+ samples"):
        ararx(seen[:5], na=2, nb=2, nd=2)
    still = Dataset(u=np.zeros(50), y=bj_data(1).y[:50], Ts=1)
    said = "na=1, nb=2, nc=1, nk=1: u determines only 2 of 3 coefficients of A and B; lower the ord"
    with pytest.raises(ValueError, match=said):
        armax(still.replaced(step=None, u=(-1.0) ** np.arange(50)), na=1, nb=2, nc=1)
    with pytest.raises(ValueError, match="u is constant: gain and level cannot be distinguished"):
        bj(still, nb=1, nc=0, nd=0, nf=0)
    with pytest.raises(ValueError, match=r"nk=2 with the gaps left out needs at least 9 .*, got 8"):
        iv4(seen[:11], na=2, nb=2, nk=2)
    assert iv4(seen, na=2, nb=2, nk=2).N == 9
    with pytest.raises(ValueError, match="the data determine fewer than 3 parameters"):
        iv4(Dataset(u=np.ones(50), y=bj_data(1).y[:50], Ts=1), na=1, nb=2)
