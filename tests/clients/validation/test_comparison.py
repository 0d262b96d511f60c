"""Judging a model on other data."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import armrig
import numpy as np
import pytest
from armrig import Signals
from armrig.data.dataset import Dataset
from armrig.data.treatment import difference
from armrig.estimation.arx import arx
from armrig.estimation.polynomial_structures import armax, bj, oe
from armrig.excitation import telegraph
from armrig.models.predictor import parameters_of
from armrig.numerics.polynomial import apply_filter
from armrig.validation.comparison import compare
from armrig.validation.residuals import residuals
from scipy.stats import chi2

from tests.clients.models.made_fits import changed

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant

B, F = [0, 1, 0.5], [1, -1.2, 0.6]


def data(seed: int, N: int = 600, noise: float = 0.3) -> Dataset:
    """Return y = B/F u + e."""
    rng = np.random.default_rng(seed)
    u = telegraph(N, 0.3, seed=rng)
    return Dataset(u=u, y=apply_filter(B, F, u) + noise * rng.standard_normal(N), Ts=1, unit="V")


def test_the_fit_percent_equals_the_formula_of_the_textbook() -> None:
    """100 (1 - |y - ŷ| / |y - mean y|), with the initial state of the new data estimated."""
    fit, fresh = oe(data(1), nb=2, nf=2, starts="few"), data(2)[100:]

    row = compare(fresh, fit)[0]

    y, spread = fit.predict(fresh, horizon=None), np.linalg.norm(fresh.y - np.mean(fresh.y))
    assert row.fit_percent == pytest.approx(100 * (1 - np.linalg.norm(fresh.y - y) / spread))
    assert row.rms_error == pytest.approx(0.3, rel=0.1)
    assert not row.on_estimation_data


def test_the_velocity_fit_shows_errors_that_the_angle_fit_hides(plant: HandoutPlant) -> None:
    """A first-order chassis without the arm: nearly 100 % on the angle, visibly bad on its rate."""
    poor = oe(plant.dataset(1), nb=2, nf=2, integrator=True, starts="few")
    good = oe(plant.dataset(1), nb=4, nf=4, integrator=True, starts="few")

    table = compare(plant.dataset(2), poor, good)

    assert table[0].fit_percent > 98
    assert table[0].velocity_fit_percent is not None
    assert table[1].velocity_fit_percent is not None
    assert table[0].velocity_fit_percent < table[1].velocity_fit_percent - 20
    assert table[1].rms_error == pytest.approx(5e-3, rel=0.1)
    assert "input offset" in repr(table)


def test_an_unbounded_simulation_has_a_fit_of_minus_infinity(plant: HandoutPlant) -> None:
    """The textbook's first choice on an integrating angle may be unstable."""
    unstable = arx(plant.dataset(1)[:400], na=6, nb=4)
    unstable_A = np.convolve(unstable.A, [1, -3.0])
    fit = changed(
        unstable, A=unstable_A, covariance=np.zeros((11, 11)), covariance_robust=np.zeros((11, 11))
    )

    row = compare(plant.dataset(2), fit)[0]

    assert row.fit_percent == -np.inf
    assert row.rms_error == np.inf


def test_the_band_is_wider_if_residuals_and_input_are_both_coloured() -> None:
    """P/(N R_e(0) R_u(0)), P = sum R_e(k) R_u(k); 1/N only if one of them is white."""
    N, a, c = 20_000, 0.1, 0.8
    rng = np.random.default_rng(4)
    u = telegraph(N, a, seed=rng)
    e = apply_filter([1], [1, -c], rng.standard_normal(N))
    coloured = Dataset(u=u, y=apply_filter(B, F, u) + e, Ts=1)
    rho = (1 - 2 * a) * c  # both correlations are geometric
    expected = 2.58 * np.sqrt((1 + rho) / (1 - rho) / N)

    tested = residuals(oe(coloured, nb=2, nf=2, starts="few"), coloured)

    assert tested.cross_band == pytest.approx(expected, rel=0.05)
    assert tested.autocorrelation_band == pytest.approx(2.58 / np.sqrt(N))
    assert tested.white.p_value < 1e-9
    assert tested.autocorrelation[1] == pytest.approx(c, abs=0.05)


def test_a_model_of_another_output_is_refused() -> None:
    angle = Dataset(u=data(1).u, y=np.cumsum(data(1).y), Ts=1, output="theta_1", unit="rad")
    fit = arx(difference(angle), na=1, nb=1)
    said = r"is velocity \[rad/s\] and the data contain theta_1 \[rad\]; .*output='velocity'"

    for judged in (compare, lambda d, f: residuals(f, d), lambda d, f: f.predict(d)):
        with pytest.raises(ValueError, match=said):
            judged(angle, fit)


def test_every_noise_parameter_reduces_the_degrees_of_freedom_on_estimation_data() -> None:
    """Q against chi-squared: L minus na, nc and nd; L on other data."""
    L = 12
    rng = np.random.default_rng(8)
    u, e = rng.standard_normal((2, 800))
    seen = Dataset(u=u, y=apply_filter(B, F, u) + apply_filter([1, 0.5], [1, -0.7], e), Ts=1)
    own = Dataset(u=u, y=apply_filter([1], [1, -0.8, 0.2], e), Ts=1)
    other = own.replaced(y=apply_filter([1], [1, -0.8, 0.2], rng.standard_normal(800)), step=None)
    for fit, judged, noise in (
        (arx(own, na=2, nb=1), own, 2),
        (arx(own, na=2, nb=1), other, 0),
        (bj(seen, nb=2, nc=1, nd=2, nf=2, starts="few"), seen, 3),
        (armax(seen, na=3, nb=3, nc=3, starts="few"), seen, 6),
        (armax(seen, na=2, nb=3, nc=3, integrator=True, starts="few"), seen, 4),
    ):
        tested = residuals(fit, judged, lags=L)

        r, n = tested.autocorrelation[1:], int(np.isfinite(tested.e).sum())
        Q = (n + 2) / n * np.sum((n - np.arange(1, L + 1)) * r**2)
        assert tested.ljung_box == pytest.approx(chi2.sf(Q, L - noise), rel=1e-2)


def test_the_covariance_of_the_free_parameters_determines_that_of_all_coefficients(
    plant: HandoutPlant,
) -> None:
    """With an integrator: through F = (1 - q^-1) F̃ it is the covariance of (b, f) again."""
    fit = oe(plant.dataset(1), nb=3, nf=4, integrator=True, starts="few")
    by_free = np.zeros((7, 6))
    by_free[:3, :3] = np.eye(3)
    for k in range(3):
        by_free[3 + k : 5 + k, 3 + k] = [1.0, -1.0]

    J = parameters_of(fit)
    free = J @ fit.covariance_robust @ J.T

    scale = np.sqrt(np.outer(np.diag(fit.covariance_robust), np.diag(fit.covariance_robust)))
    back = by_free @ free @ by_free.T
    np.testing.assert_allclose(back / scale, fit.covariance_robust / scale, atol=1e-6)
    assert np.linalg.matrix_rank(free / np.sqrt(np.outer(np.diag(free), np.diag(free)))) == 6


@pytest.mark.parametrize("own", [True, False])
def test_the_lagged_inputs_are_stored_once(own: bool) -> None:
    """25 lags more to each side are 50 arrays more; held twice, they would be 100."""
    long = data(1, 100_000)
    fit = oe(long[:2000], nb=2, nf=2, starts="few")
    fit = replace(fit, digest=long.digest) if own else fit

    few, many = (_peak(partial(residuals, fit, long, lags=lags)) for lags in (25, 50))

    assert many - few < 75 * long.y.nbytes


def _peak(compute: Callable[[], object]) -> int:
    """Return the largest memory that a computation had at once, in bytes."""
    tracemalloc.start()
    compute()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


def test_the_prediction_error_of_a_long_angle_is_its_noise() -> None:
    """Its initial state and ramp are a million times its noise, so that each digit counts."""
    rng = np.random.default_rng(3)
    n = 2000
    u = np.repeat(rng.choice([0.0, 5.0], n // 10), 10)
    B, F = [0, 0.004, 0.003], np.poly([0.91 + 0.16j, 0.91 - 0.16j, 0.69]).real
    rate = apply_filter(B, F, u)
    y = np.column_stack([np.cumsum(rate), rate])
    y += 1e-4 * rng.standard_normal(y.shape)
    data = Signals(u=u[:, None], y=y, Ts=0.01, inputs=["u"], outputs=["angle", "rate"])
    fit: Any = armrig.oe(data, nb=2, nf=3, integrator="angle", shared="denominator")  # type: ignore[call-arg, arg-type]

    later = data[137:]  # in the middle of a movement
    e = later.y - fit.predict(later, None)

    np.testing.assert_allclose(np.std(e, axis=0), 1e-4, rtol=0.1)
