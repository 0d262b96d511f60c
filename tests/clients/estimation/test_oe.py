"""Output error, on benign systems and on the lab's own trap: an angle that integrates."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.estimation.polynomial_structures import oe
from armrig.excitation import telegraph
from armrig.models.fit import Fit
from armrig.numerics.polynomial import Array, apply_filter, impulse
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from tests.sampling import sampled

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant

OMEGA = np.geomspace(0.5, 100.0, 200)


@settings(max_examples=20)
@given(
    st.floats(0.1, 0.97),
    st.floats(0.15, 2.9),
    st.floats(-0.8, 0.8),
    st.integers(0, 3),
    st.integers(0, 2**32 - 1),
)
def test_noise_free_data_give_back_the_true_parameters(
    radius: float, angle: float, zero: float, nk: int, seed: int
) -> None:
    F = np.array([1, -2 * radius * np.cos(angle), radius**2])
    B = np.append(np.zeros(nk), [1.0, -zero])
    u = np.random.default_rng(seed).standard_normal(300)
    y = apply_filter(B, F, u)

    fit = oe(Dataset(u=u[50:], y=y[50:], Ts=1), nb=2, nf=2, nk=nk)

    np.testing.assert_allclose(fit.F, F, atol=1e-6)
    np.testing.assert_allclose(fit.B, B, atol=1e-6)
    assert fit.search.converged
    assert not fit.warnings


def test_a_noise_free_angle_gives_back_the_plant_from_any_state(plant: HandoutPlant) -> None:
    u = telegraph(1500, 0.05, 0.0, 5.0, seed=1)
    y = plant.angle(u - 0.3)

    fit = oe(Dataset(u=u[500:], y=y[500:], Ts=plant.Ts), nb=4, nf=4, integrator=True)

    np.testing.assert_allclose(fit.theta, plant.theta, atol=1e-6)
    assert fit.free[0].offset == pytest.approx(0.3, abs=1e-6)


@pytest.fixture(scope="module")
def fits(plant: HandoutPlant) -> list[Fit]:
    return [oe(plant.dataset(seed), nb=4, nf=4, integrator=True) for seed in range(2)]


def test_the_handout_s_plant_is_found_to_one_per_cent(plant: HandoutPlant, fits: list[Fit]) -> None:
    """5 mrad of white noise, 30 s: median error of the frequency response ≤ 0.01, worst ≤ 0.02."""
    errors = [plant.relative_error(OMEGA, fit.frequency_response(OMEGA).G) for fit in fits]

    assert np.median(errors) <= 0.01
    assert max(errors) <= 0.02
    assert all(fit.search.converged and fit.search.agreed for fit in fits)


@pytest.mark.exhaustive
def test_the_plant_is_found_through_a_potentiometer_with_a_dead_band(plant: HandoutPlant) -> None:
    """10 bits over 352°, the dead band and 2 % of the samples missing."""
    seeds = range(20)
    recordings = [plant.through_potentiometer(plant.dataset(seed), seed) for seed in seeds]

    fits = [oe(data, nb=4, nf=4, integrator=True) for data in recordings]

    errors = [plant.relative_error(OMEGA, fit.frequency_response(OMEGA).G) for fit in fits]
    assert min(data.missing for data in recordings) > 60
    assert np.median(errors) <= 0.01
    assert max(errors) <= 0.02


def test_every_coefficient_of_the_plant_lies_inside_three_sigma(
    plant: HandoutPlant, fits: list[Fit]
) -> None:
    assert all((np.abs(fit.theta - plant.theta) < 3 * fit.std).all() for fit in fits)


def test_missing_outputs_remove_only_their_rows() -> None:
    """OE uses no past y."""
    rng = np.random.default_rng(5)
    u = rng.standard_normal(400)
    y = apply_filter([0, 1, 0.5], [1, -1.2, 0.6], u) + 0.1 * rng.standard_normal(400)
    valid = rng.random(400) > 0.3
    valid[:40] = False
    spoilt = np.where(valid, y, 1e6 * rng.standard_normal(400))

    fit = oe(Dataset(u=u, y=y, Ts=1, valid=valid), nb=2, nf=2)
    again = oe(Dataset(u=u, y=spoilt, Ts=1, valid=valid), nb=2, nf=2)

    assert np.count_nonzero(valid) == fit.N
    np.testing.assert_array_equal(fit.theta, again.theta)
    assert (np.abs(fit.theta - [1, 0.5, -1.2, 0.6]) < 4 * fit.std).all()


def test_each_experiment_has_its_own_state_level_and_offset(plant: HandoutPlant) -> None:
    whole = plant.dataset(2, std=0.0)
    parts = [whole[:900], whole[1000:1900], whole[2100:]]
    moved = [
        Dataset(u=p.u + k, y=p.y + 10.0 * k, Ts=p.Ts, output=p.output) for k, p in enumerate(parts)
    ]

    fit = oe(merge(moved), nb=4, nf=4, integrator=True)

    np.testing.assert_allclose(fit.theta, plant.theta, atol=1e-6)
    np.testing.assert_allclose([f.offset for f in fit.free], [0, 1, 2], atol=1e-6)


@pytest.mark.exhaustive
def test_many_short_experiments_leave_the_residuals_white(plant: HandoutPlant) -> None:
    """Without the correction, five nuisance parameters per hundred samples look like colour."""
    p = [
        oe(
            merge(plant.dataset(seed).split(30)), nb=4, nf=4, integrator=True, starts="few"
        ).whiteness
        for seed in range(10)
    ]

    assert np.count_nonzero(np.array(p) < 0.05) <= 2


def test_rounding_noise_is_not_reported_as_coloured(plant: HandoutPlant) -> None:
    fit = oe(plant.dataset(1, std=0.0), nb=4, nf=4, integrator=True)

    assert fit.search.converged
    assert fit.search.agreed
    assert fit.warnings == ()


def test_an_initial_state_of_zero_lowers_the_deviations() -> None:
    """initial="zero" has no nuisance parameters, so its standard deviations are smaller."""
    rng = np.random.default_rng(7)
    u = rng.standard_normal(60)
    y = apply_filter([0, 1], [1, -0.95], u) + 0.1 * rng.standard_normal(60)
    data = Dataset(u=u, y=y, Ts=1)

    at_rest, estimated = oe(data, nb=1, nf=1, initial="zero"), oe(data, nb=1, nf=1)

    assert at_rest.free[0].transients == ()
    assert len(estimated.free[0].transients) == 1
    assert (at_rest.std < estimated.std).all()


def test_the_backcast_state_is_the_least_squares_estimate() -> None:
    rng = np.random.default_rng(7)
    u = np.append(np.full(40, 2.0), rng.standard_normal(120))
    y = apply_filter([0, 1, 0.5], [1, -1.7, 0.8], u) + 0.3 * rng.standard_normal(160)
    data = Dataset(u=u[40:], y=y[40:], Ts=1)

    fit = oe(data, nb=2, nf=2, initial="backcast")

    def columns(f: Array) -> Array:
        pulses = [impulse([1.0, *f], data.N), np.append(0.0, impulse([1.0, *f], data.N - 1))]
        return np.column_stack(pulses)

    def forced(theta: Array) -> Array:
        return apply_filter([0.0, *theta[:2]], [1.0, *theta[2:]], data.u)

    state = np.linalg.lstsq(columns(fit.F[1:]), data.y - forced(fit.theta), rcond=None)[0]
    again = least_squares(
        lambda theta: data.y - forced(theta) - columns(theta[2:]) @ state, fit.theta, xtol=1e-12
    )
    np.testing.assert_allclose(fit.free[0].transients, state, rtol=1e-8)
    np.testing.assert_allclose(again.x, fit.theta, atol=1e-6)
    at_rest = oe(data, nb=2, nf=2, initial="zero")
    assert np.abs(state).max() > 1
    assert fit.loss < 0.9 * at_rest.loss
    np.testing.assert_array_equal(fit.theta, oe(data, nb=2, nf=2).theta)


@pytest.mark.exhaustive
@pytest.mark.parametrize("std", [0.01, 0.3])
def test_resonant_systems_are_identified_without_start_values(std: float) -> None:
    missed = []
    for seed in range(25):
        rng = np.random.default_rng([seed, 99])
        radius, angle = rng.uniform(0.7, 0.98, 2), rng.uniform(0.1, 2.8, 2)
        F = np.real(np.poly([*(radius * np.exp(1j * angle)), *(radius * np.exp(-1j * angle))]))
        B = np.append(0.0, rng.standard_normal(4))
        u = telegraph(1000, 0.3, seed=rng)
        clean = apply_filter(B, F, u)
        e = std * np.std(clean) * rng.standard_normal(1000)

        fit = oe(Dataset(u=u, y=clean + e, Ts=1), nb=4, nf=4)

        if fit.loss > np.mean(e**2) or not fit.search.converged:
            missed.append(seed)

    assert missed == []


def test_an_order_too_high_for_the_data_is_refused() -> None:
    """Nuisance parameters count, too: 1 + 1, one transient, and one more sample."""
    u = np.random.default_rng(0).standard_normal(3)

    with pytest.raises(ValueError, match="nb=1, nf=1, nk=1 needs at least 4 samples, got 3"):
        oe(Dataset(u=u, y=u, Ts=1), nb=1, nf=1)
    longer = np.random.default_rng(0).standard_normal(6)
    holed = Dataset(u=longer, y=longer[::-1], Ts=1, valid=np.arange(6) % 2 > 0)
    with pytest.raises(ValueError, match="nb=1, nf=1, nk=1 needs at least 4 samples, got 3"):
        oe(holed, nb=1, nf=1)


def test_an_input_without_excitation_is_refused() -> None:
    y = np.random.default_rng(0).standard_normal(50)

    with pytest.raises(ValueError, match=r"u determines only . of 2 numerator.*richer input"):
        oe(Dataset(u=(-1.0) ** np.arange(50), y=y, Ts=1), nb=2, nf=1)
    with pytest.raises(ValueError, match="u is constant: gain and level cannot be distinguished"):
        oe(Dataset(u=np.zeros(50), y=y, Ts=1), nb=2, nf=1)


@pytest.mark.parametrize("n", sampled([2, 4, 6]))
def test_an_order_too_high_on_quiet_data_has_both_deviations(n: int) -> None:
    """Poles and zeros cancel, so the derivatives agree to seven digits."""
    rng = np.random.default_rng(n)
    u = rng.choice([-1.0, 1.0], 500)
    y = apply_filter([0, 1.0], [1.0, -0.8], u) + 1e-6 * rng.standard_normal(500)

    fit = oe(Dataset(u=u, y=y, Ts=1.0), nb=n, nf=n)

    np.testing.assert_allclose(fit.std_robust, fit.std, rtol=0.5)
