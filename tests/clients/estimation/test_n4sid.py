"""Subspace identification."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from armrig.data.dataset import Dataset, Signals
from armrig.data.merging import merge
from armrig.estimation.n4sid import _pole_std, n4sid
from armrig.estimation.polynomial_structures import oe
from armrig.estimation.start_values import noise_start
from armrig.estimation.subspace import Realisation
from armrig.estimation.subspace_estimate import _without_past
from armrig.excitation import telegraph
from armrig.models.fit import Fit
from armrig.models.structure_table import Focus, Weights
from armrig.numerics.polynomial import apply_filter, impulse
from armrig.validation.comparison import compare
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant

Vector = NDArray[np.float64]

OMEGA = np.geomspace(0.5, 100.0, 200)
B, F, C = [0.0, 1.0, 0.5], [1.0, -1.2, 0.6], [1.0, -0.5, 0.2]


def _data(seed: int, N: int = 2000, std: float = 0.5) -> Dataset:
    rng = np.random.default_rng(seed)
    u = telegraph(N, 0.3, 1.5, 3.5, seed=rng) - 2.5
    y = apply_filter(B, F, u) + apply_filter(C, F, std * rng.standard_normal(N))
    return Dataset(u=u, y=y, Ts=1.0)


@pytest.mark.parametrize("weights", ["cva", "moesp", "n4sid"])
@pytest.mark.parametrize("nk", [0, 1, 3])
def test_noise_free_data_give_back_the_true_system(weights: Weights, nk: int) -> None:
    u = np.random.default_rng(1).standard_normal(600)
    numerator = np.append(np.zeros(nk), [1.0, 0.5, 0.3][: 2 + (nk == 0)])
    y = apply_filter(numerator, F, u)

    fit = n4sid(Dataset(u=u[50:], y=y[50:], Ts=1.0), 2, weights, nk=nk)

    np.testing.assert_allclose(fit.A, F, atol=1e-7)
    np.testing.assert_allclose(fit.B, numerator, atol=1e-7)


def test_an_input_of_one_frequency_is_refused() -> None:
    u = np.sin(0.5 * np.arange(300))
    y = apply_filter(B, F, u) + 0.1 * np.random.default_rng(1).standard_normal(300)

    with pytest.raises(ValueError, match="u determines only 2 of 3 numerator coefficients"):
        n4sid(Dataset(u=u, y=y, Ts=1.0), 3, nk=1)


@pytest.mark.parametrize("focus", ["prediction", "simulation"])
def test_a_model_without_a_steady_kalman_gain_is_reported(
    focus: Focus, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found() -> set[str]:
        return {f.about for f in n4sid(_data(1), 2, focus=focus).findings}

    assert "no_gain" not in found()
    monkeypatch.setattr(Realisation, "predictor_poles", lambda _: None)
    assert "no_gain" in found()


def test_the_arm_is_found_as_well_as_by_output_error(plant: HandoutPlant) -> None:
    fits = [n4sid(plant.dataset(seed), integrator=True) for seed in range(4)]

    errors = [plant.relative_error(OMEGA, f.frequency_response(OMEGA).G) for f in fits]
    assert [f.order for f in fits] == [4] * 4
    assert np.median(errors) < 0.01
    assert all(abs(np.sum(f.A)) < 1e-12 for f in fits)  # A(1) = 0


@pytest.mark.parametrize("seed", range(2))
def test_the_dead_band_of_a_potentiometer_hardly_increases_the_error(
    plant: HandoutPlant, seed: int
) -> None:
    """Quantised to 10 bits, 5 % missing in gaps of all lengths."""
    data = plant.through_potentiometer(plant.dataset(seed), seed)

    fit = n4sid(data, 4, integrator=True)

    assert plant.relative_error(OMEGA, fit.frequency_response(OMEGA).G) < 0.02


def test_an_integrating_angle_without_an_integrator_causes_a_warning(plant: HandoutPlant) -> None:
    """A pole whose distance from 1 is within its accuracy is an integrator, not unstable."""
    sides = set()
    for seed in (1, 2):
        fit = n4sid(plant.dataset(seed), 4)
        sides.add(bool(np.abs(np.roots(fit.A)).max() > 1 + 1e-9))

        said = [w for w in fit.warnings if "a pole is 1 within its accuracy" in w]
        assert len(said) == 1
        assert "theta_1 integrates, so set the option integrator" in said[0]
        assert not any("unstable" in w for w in fit.warnings)
    assert sides == {True, False}
    assert not any("integrator" in w for w in n4sid(plant.dataset(1), 4, integrator=True).warnings)


def test_an_integrator_shown_only_by_the_data_causes_a_warning() -> None:
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], 60), 10)
    v = apply_filter([1.0], [1.0, -0.9], rng.standard_normal(600))
    integrates, slow = (
        Dataset(u=u, y=apply_filter([0.0, 0.05], np.convolve([1, -p], [1, -0.8]), u) + v, Ts=1.0)
        for p in (1.0, 0.95)
    )

    of_one, of_other = (
        [w for w in n4sid(x, 2).warnings if "option integrator" in w] for x in (integrates, slow)
    )

    assert len(of_one) == 1
    assert of_one[0].startswith("y behaves as an integrating output")
    assert not of_other


def test_coloured_residuals_are_separated_from_a_wrong_order() -> None:
    """n4sid does not minimise the one-step errors, so the advice names armax."""
    rng = np.random.default_rng(1)
    u, e = rng.choice([-1.0, 1.0], 1000), 0.5 * rng.standard_normal(1000)
    data = Dataset(
        u=u, y=apply_filter(B, F, u) + apply_filter([1.0], [1.0, 0, 0, 0, -0.9], e), Ts=1.0
    )

    low, enough = (n4sid(data, order) for order in (2, 6))

    assert [any("armax" in w for w in fit.warnings) for fit in (low, enough)] == [True, False]
    assert [fit.white.coloured for fit in (low, enough)] == [True, False]


def test_a_pole_significantly_outside_the_circle_is_reported_unstable() -> None:
    rng = np.random.default_rng(1)
    u = rng.standard_normal(400)
    y = apply_filter([0.0, 1.0], [1.0, -1.01], u) + 0.1 * rng.standard_normal(400)

    warnings = n4sid(Dataset(u=u, y=y, Ts=1.0), 1).warnings

    assert any(w.startswith("a pole is unstable, |z| = 1.0100: ") for w in warnings)
    assert not any("integrator" in w for w in warnings)


def test_the_deviation_of_a_pole_is_that_of_its_coefficients() -> None:
    """First order: the pole is -a1. Second order: a1 and a2 are sum and product of the poles."""
    roots = np.roots([1.0, -1.7, 0.72])  # 0.9 and 0.8
    covariance = np.diag([1e-6, 4e-6])

    by_step = [
        (np.roots([1.0, -1.7 + da, 0.72 + db])[0] - roots[0]) / 1e-7
        for da, db in ((1e-7, 0.0), (0.0, 1e-7))
    ]

    expected = float(np.hypot(by_step[0] * 1e-3, by_step[1] * 2e-3))
    assert _pole_std(np.array([1.0, -1.7, 0.72]), roots[0], covariance) == pytest.approx(
        expected, rel=1e-4
    )
    assert _pole_std(np.array([1.0, -0.5]), 0.5, np.array([[0.04]])) == pytest.approx(0.2)


def test_gaps_and_several_experiments_are_estimated() -> None:
    valid = np.ones(2000, dtype=np.bool_)
    valid[::37] = False
    one = _data(1)
    data = merge([Dataset(u=one.u, y=one.y, Ts=1.0, valid=valid), _data(2)])

    fit = n4sid(data, 2)

    np.testing.assert_allclose(fit.A, F, atol=5 * fit.std[:2].max())
    np.testing.assert_allclose(fit.B, B, atol=5 * fit.std[2:4].max())


@pytest.mark.parametrize("missing", [False, True])
def test_noise_is_not_estimated_from_the_time_before_the_first_sample(missing: bool) -> None:
    """The noise begins far from 0, and A y looks back on it."""
    e = 0.3 * np.random.default_rng(3).standard_normal((2, 500))
    v = [apply_filter(C, F, x) + apply_filter([1e3, -5e2], F, impulse([1.0], 500)) for x in e]
    for x in v:
        x[100] = np.nan if missing else x[100]

    found, _ = noise_start([_without_past(np.array(F), x) for x in v], nc=2, nd=0)

    np.testing.assert_allclose(found, C, atol=0.15)


@pytest.mark.parametrize("seed", range(4))
def test_the_order_is_suggested_by_the_states_errors(seed: int) -> None:
    fit = n4sid(_data(seed, 3000))

    assert fit.order == fit.projection.suggested_order == 2
    correlations = fit.projection.canonical_correlations
    assert (np.diff(correlations) <= 0).all()
    assert 0 <= correlations[-1] <= correlations[0] <= 1
    assert "<- order" in fit.explain()


def test_a_model_of_two_outputs_has_the_correlations_of_its_projection() -> None:
    """The second output is the first one a sample later: a third state."""
    data = _data(0, 3000)
    late = np.append(0.0, data.y[:-1]) + 0.1 * np.random.default_rng(0).standard_normal(data.N)

    fit = n4sid(Signals(u=data.u, y=np.column_stack([data.y, late]), Ts=1.0), replicates=0)

    assert fit.order == fit.projection.suggested_order == 3
    assert fit.projection.canonical_correlations[2] > 0.5
    assert fit.projection.canonical_correlations[3] < 0.5
    assert fit.projection.singular_values.size > fit.projection.horizon > 3
    assert "   3   0.5" in fit.explain()


A4, B4, C4 = (
    np.convolve([1.0, -1.658, 0.81], [1.0, -0.113, 0.64]),
    [0.0, 1.0, 0.5, 0.3, -0.2],
    np.convolve([1.0, -0.697, 0.25], [1.0, 0.5, 0.36]),
)


def _of_fourth_order(seed: int, N: int, C: ArrayLike, D: ArrayLike) -> tuple[Dataset, Vector]:
    rng = np.random.default_rng(seed)
    u = telegraph(N, 0.3, 1.5, 3.5, seed=rng) - 2.5
    e = 0.5 * rng.standard_normal(N)
    return Dataset(u=u, y=apply_filter(B4, A4, u) + apply_filter(C, D, e), Ts=1.0), e


def _excess(fits: list[Fit], C: ArrayLike, D: ArrayLike) -> float:
    """Return how far the mean one-step loss on fresh data is above the least, as a share of it."""
    fresh, e = _of_fourth_order(1000, 4000, C, D)
    own = [apply_filter(x.A, x.C, fresh.y) - apply_filter(x.B, x.C, fresh.u) for x in fits]
    return float(np.mean((np.array(own) - e) ** 2) / np.mean(e**2))


def test_the_noise_model_of_short_data_has_nearly_the_least_error() -> None:
    """12 parameters from 300 samples cost 4 % of loss; a horizon of 10 samples costs 29 %."""
    data = [_of_fourth_order(seed, 300, C4, A4)[0] for seed in range(12)]

    fits, long = ([n4sid(x, 4, horizon=h) for x in data] for h in (None, 10))

    assert _excess(fits, C4, A4) < 0.09
    assert _excess(long, C4, A4) > 0.18


def test_noise_on_the_output_keeps_the_long_horizon() -> None:
    """The predictor forgets as slowly as the system."""
    data = [_of_fourth_order(seed, 1000, [1.0], [1.0])[0] for seed in range(6)]

    fits, short = ([n4sid(x, 4, horizon=h) for x in data] for h in (None, 6))

    assert min(fit.projection.horizon for fit in fits) >= 10
    assert 2 * _excess(fits, [1.0], [1.0]) < _excess(short, [1.0], [1.0])


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_model_for_simulation_may_have_a_pole_at_1_alone(noise: float) -> None:
    rng = np.random.default_rng(4)
    u = telegraph(500, 0.3, 1.5, 3.5, seed=rng) - 2.5
    y = apply_filter([0.0, 0.2], [1.0, -1.0], u) + noise * rng.standard_normal(500)
    data = Dataset(u=u, y=y, Ts=1.0)

    fit = n4sid(data, 1, integrator=True, focus="simulation")

    assert fit.A.tolist() == [1.0, -1.0]
    best = oe(data, nb=1, nf=1, integrator=True)
    assert compare(data, fit)[0].rms_error == pytest.approx(
        compare(data, best)[0].rms_error, rel=1e-3, abs=1e-9
    )


@pytest.mark.parametrize("integrator", [False, True])
def test_a_model_for_simulation_is_the_best_output_error_model(integrator: bool) -> None:
    """It has the same minimum as a search from other starts."""
    A = np.convolve(F, [1.0, -1.0] if integrator else [1.0])
    rng = np.random.default_rng(4)
    u = telegraph(1500, 0.3, 1.5, 3.5, seed=rng) - 2.5
    y = apply_filter(B, A, u) + apply_filter([1.0], [1.0, -0.9], 0.3 * rng.standard_normal(1500))
    data = Dataset(u=u, y=y, Ts=1.0)
    n = A.size - 1

    fit = n4sid(data, n, integrator=integrator, focus="simulation")

    best = oe(data, nb=n, nf=n, integrator=integrator)
    plain = n4sid(data, n, integrator=integrator)
    rms = [compare(data, f)[0].rms_error for f in (fit, best, plain)]
    assert rms[0] == pytest.approx(rms[1], rel=1e-5)
    assert rms[0] < rms[2]
    assert compare(data, fit, horizon=1)[0].rms_error < 0.7 * rms[0]
    assert abs(np.sum(fit.A)) < 1e-12 or not integrator


def test_a_model_for_simulation_is_stable_and_runs_through_gaps() -> None:
    valid = np.ones(400, dtype=np.bool_)
    valid[60::97] = False
    rng = np.random.default_rng(2)
    parts = []
    for _ in range(2):
        u = rng.standard_normal(400)
        y = apply_filter([0.0, 1.0], [1.0, -1.005], u) + rng.standard_normal(400)
        parts.append(Dataset(u=u, y=y, Ts=1.0, valid=valid))

    free = n4sid(merge(parts), 1)
    fit = n4sid(merge(parts), 1, focus="simulation")

    assert abs(np.roots(free.A)[0]) > 1
    assert abs(np.roots(fit.A)[0]) < 1
    assert not any("unstable" in w for w in fit.warnings)


def test_orders_weights_and_horizons_out_of_range_are_refused() -> None:
    u = np.random.default_rng(1).standard_normal(300)
    clean = Dataset(u=u, y=apply_filter(B, F, u), Ts=1.0)

    assert n4sid(clean).order == 2
    with pytest.raises(ValueError, match="the data show 2 states; lower the order"):
        n4sid(clean, 4)
    with pytest.raises(ValueError, match="y is always 3: give the column that varies"):
        n4sid(Dataset(u=u, y=np.full(300, 3.0), Ts=1.0), 1)
    with pytest.raises(ValueError, match="weights='svd' must be one of"):
        n4sid(clean, 2, "svd")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match='focus=\'both\' must be "prediction" or "sim'):
        n4sid(clean, 2, focus="both")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="horizon=3 must be an integer >= 4"):
        n4sid(clean, 2, horizon=3)
    with pytest.raises(ValueError, match="60 samples without a gap of more than 30, needs"):
        n4sid(clean[:100], 2, horizon=30)


def test_outputs_that_are_never_measured_together_have_independent_noise() -> None:
    """Two outputs are read in turn."""
    rng = np.random.default_rng(5)
    u = rng.standard_normal((400, 1))
    y = np.column_stack([apply_filter([0, 1.0], [1, -0.5], u[:, 0])] * 2)
    y += 0.1 * rng.standard_normal(y.shape)
    valid = np.arange(400)[:, None] % 2 == [[0, 1]]
    data = Signals(u=u, y=y, valid=valid, Ts=0.1)

    fit = n4sid(data, order=1, replicates=20)

    pole = fit.poles()
    assert abs(pole.values[0] - 0.5) < 4 * pole.std[0] < 0.2
