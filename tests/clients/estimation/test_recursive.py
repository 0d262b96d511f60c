"""ARX sample by sample."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.estimation.arx import arx
from armrig.estimation.recursive import RarxState, rarx, rarx_start, rarx_step
from armrig.numerics.polynomial import apply_filter


def _data(seed: int, N: int = 400, a: float = -1.2) -> Dataset:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(N)
    F = [1.0, a, 0.6]
    y = apply_filter([0.0, 1.0, 0.5], F, u) + apply_filter([1.0], F, 0.3 * rng.standard_normal(N))
    return Dataset(u=u, y=y, Ts=1.0)


@cache
def _runs(forgetting: float) -> list[RarxState]:
    found = []
    for seed in range(150):
        data = _data(seed, 100)
        state = rarx_start(na=2, nb=2, forgetting=forgetting)
        for u, y in zip(data.u, data.y, strict=True):
            state = rarx_step(state, u, y)
        found.append(state)
    return found


@pytest.mark.parametrize(("na", "nb", "nk"), [(2, 2, 1), (0, 3, 0), (1, 1, 2), (3, 1, 1)])
def test_an_estimate_without_forgetting_equals_that_of_all_samples(
    na: int, nb: int, nk: int
) -> None:
    valid = np.ones(400, dtype=np.bool_)
    valid[[100, 200, 201]] = False
    one = _data(1)
    data = merge([Dataset(u=one.u, y=one.y, Ts=1.0, valid=valid), _data(2)])

    state = rarx(data, na=na, nb=nb, nk=nk).state
    fit = arx(data, na=na, nb=nb, nk=nk)

    np.testing.assert_allclose(state.theta, fit.theta, rtol=1e-10)
    np.testing.assert_allclose(state.std, fit.std, rtol=1e-9)
    assert state.weight == fit.N
    np.testing.assert_array_equal(state.B[:nk], 0.0)


def test_a_row_with_a_missing_sample_does_not_forget() -> None:
    one = _data(1, 200)
    valid = np.ones(200, dtype=np.bool_)
    valid[[50, 120, 121, 190]] = False
    data = Dataset(u=one.u, y=one.y, Ts=1.0, valid=valid)

    state = rarx(data, na=1, nb=1, forgetting=0.95).state

    known = valid[1:] & valid[:-1]
    Phi = np.column_stack([-one.y[:-1], one.u[:-1]])[known]
    w = 0.95 ** np.arange(known.sum() - 1, -1, -1.0)
    theta = np.linalg.lstsq(Phi * np.sqrt(w)[:, None], one.y[1:][known] * np.sqrt(w), rcond=None)[0]
    e = one.y[1:][known] - Phi @ theta
    degrees = w.sum() - 2 * (w @ w) / w.sum()
    np.testing.assert_allclose(state.theta, theta, rtol=1e-10)
    assert state.weight == pytest.approx(w.sum(), rel=1e-12)
    assert state.noise_variance == pytest.approx(float(w @ e**2) / degrees, rel=1e-9)


def test_the_error_is_that_of_the_prediction() -> None:
    """The prediction uses the parameters before the sample."""
    one = _data(1, 60)
    valid = np.arange(60) != 30
    found = rarx(Dataset(u=one.u, y=one.y, Ts=1.0, valid=valid), na=1, nb=1, forgetting=0.9)

    phi = np.column_stack([-one.y[:-1], one.u[:-1]])
    expected = one.y[1:] - np.sum(phi * found.theta[:-1], axis=1)
    there = np.ones(60, dtype=np.bool_)
    there[[30, 31]] = False
    assert np.isnan(found.error[[30, 31]]).all()
    np.testing.assert_allclose(found.error[10:][there[10:]], expected[9:][there[10:]], rtol=1e-9)


def test_a_change_of_the_system_is_followed() -> None:
    data = merge([_data(1, 600), _data(2, 600, a=-0.8)])

    follows, stays = (rarx(data, na=2, nb=2, forgetting=f) for f in (0.97, 1.0))

    assert follows.theta[599, 0] == pytest.approx(-1.2, abs=0.1)
    assert follows.theta[-1, 0] == pytest.approx(-0.8, abs=0.1)
    assert -1.15 < stays.theta[-1, 0] < -0.85


@pytest.mark.exhaustive
def test_the_deviations_hold_while_forgetting() -> None:
    """Ratio of scatter and reported deviation, 150 runs."""
    states = _runs(0.97)

    ratio = np.std([s.theta for s in states], axis=0) / np.mean([s.std for s in states], axis=0)

    assert ((ratio > 0.85) & (ratio < 1.15)).all()


def test_the_noise_variance_holds_while_forgetting() -> None:
    """Within the error of the mean of 150 runs, for four parameters and ten samples."""
    variances = [state.noise_variance for state in _runs(0.9)]

    assert abs(np.mean(variances) - 0.09) < 3 * np.std(variances) / np.sqrt(150)


def test_a_step_does_not_change_the_previous_state() -> None:
    state = rarx_step(rarx_start(na=1, nb=1), 1.0, 2.0)
    before = (state.R.copy(), state.u.copy(), state.y.copy())

    rarx_step(state, 3.0, 4.0)

    for now, then in zip((state.R, state.u, state.y), before, strict=True):
        np.testing.assert_array_equal(now, then)


def test_undetermined_parameters_have_infinite_deviations() -> None:
    state = rarx_start(na=1, nb=2)
    for _ in range(50):
        state = rarx_step(state, 0.0, 0.0)

    assert not state.determined
    assert np.isinf(state.std).all()


def test_parameters_that_the_samples_no_longer_determine_are_kept() -> None:
    """After 100 samples at one level, the excited samples weigh 0.5^100."""
    u = np.where(np.arange(140) < 40, _data(1, 140).u, 1.0)
    data = Dataset(u=u, y=apply_filter([0, 1.0, 0.5], [1, -0.4], u), Ts=1.0)

    found = rarx(data, na=1, nb=2, forgetting=0.5)

    assert not found.state.determined
    known = np.isfinite(found.theta).all(axis=1)
    assert known[np.argmax(known) :].all()
    assert np.isfinite(found.error[-50:]).all()


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_the_unit_of_u_changes_no_recursive_estimate(unit: float) -> None:
    data = _data(1, 80)
    data = data.replaced(u=unit * data.u, step=None)

    state = rarx(data, na=2, nb=2).state

    fit = arx(data, na=2, nb=2)
    assert state.determined
    np.testing.assert_allclose(state.theta, fit.theta, rtol=1e-7)
    np.testing.assert_allclose(state.std, fit.std, rtol=1e-7)


def test_the_noise_is_unknown_with_as_many_samples_as_parameters() -> None:
    rng = np.random.default_rng(1)
    state = rarx_start(na=0, nb=3)
    for _ in range(7):  # the first row is that of the fourth sample
        state = rarx_step(state, *rng.standard_normal(2))
        assert np.isfinite(state.noise_variance) == (state.weight > 3)
        assert state.determined == (state.weight >= 3)

    assert state.weight == 4


def test_a_forgetting_factor_above_1_is_refused() -> None:
    with pytest.raises(ValueError, match=r"forgetting=1.1 must be above 0 and at most 1"):
        rarx_start(na=1, nb=1, forgetting=1.1)
