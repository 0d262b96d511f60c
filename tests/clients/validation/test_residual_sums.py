"""The residual tests against their sums written out: lags, experiments, deviations of theta."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import armrig
import numpy as np
import pytest
from armrig import Signals
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.estimation.arx import arx
from armrig.estimation.polynomial_structures import oe
from armrig.models.fit import Fit
from armrig.models.predictor import parameters_of, prediction_errors
from armrig.numerics.covariance import pairwise_covariance
from armrig.numerics.polynomial import Array, apply_filter
from armrig.numerics.whiteness import joint_p_value, portmanteau
from armrig.validation.output_whiteness import _white, white_by_output
from armrig.validation.projection import projection
from armrig.validation.residuals import residuals
from scipy.stats import chi2

from tests.benchmarks.verdict_levels import drawn
from tests.clients.validation.plants import (
    SAMPLES,
    oe_of_two_outputs,
    two_outputs,
    under_control,
)
from tests.plants import chassis_and_arm
from tests.sampling import sampled

L = 6
NK = [[1, 2], [1, 1]]
"""Delays of the channels of `two_outputs`."""


def data(seed: int, N: int, B: list[float] | None = None) -> Dataset:
    """Return y = B/F u + e about a level, so that a mean that stays is seen."""
    rng = np.random.default_rng(seed)
    u = 3.0 + rng.standard_normal(N)
    y = apply_filter(B or [0, 1, 0.5], [1, -1.2, 0.6], u) + 0.3 * rng.standard_normal(N)
    return Dataset(u=u, y=y, Ts=1)


def two_experiments() -> Dataset:
    return merge([data(2, 180), data(3, 130)])


def lagged_inputs(part: Dataset, mean: float, L: int) -> Array:
    """Return u(t - k), k = -L … L, one column each, 0 outside of the experiment."""
    padded = np.concatenate([np.zeros(L), part.u - mean, np.zeros(L)])
    return np.column_stack([padded[L - k : L - k + part.N] for k in range(-L, L + 1)])


def written_out(fit: Fit, judged: Dataset, *, own: bool) -> tuple[Array, Array, float]:
    """Return s_k, k = -L … L, its covariance M, and the scale of a correlation."""
    known = prediction_errors(fit, judged)
    e = np.concatenate([np.nan_to_num(r.e[:, 0]) for r in known])
    Z = []
    for part, r in zip(judged.experiments(), known, strict=True):
        lagged = lagged_inputs(part, float(np.mean(judged.u)), L)
        lagged[~r.known[:, 0]] = 0.0
        Z.append(lagged - r.S[:, 0] @ (r.S[:, 0].T @ lagged))
    (quality,) = fit.quality
    assert len(quality.autoregression) == 1  # white: R_e is s² I, and on other data s² as estimated
    s2 = fit.noise_variance
    whole, Psi = np.vstack(Z), np.vstack([r.Psi[:, 0] for r in known])
    scale = float(np.sqrt(np.sum(whole[:, L] ** 2) * (e @ e)))
    s = whole.T @ e
    if own:
        Q = np.linalg.qr(Psi)[0]
        estimated = Psi.shape[1] + sum(r.S.shape[2] for r in known)
        N = np.count_nonzero(np.isfinite(np.concatenate([r.e for r in known])))
        s2 = (e @ e) / (N - estimated)
        whole = whole - Q @ (Q.T @ whole)
        return s, s2 * whole.T @ whole, scale
    slope = whole.T @ Psi
    return s, s2 * whole.T @ whole + slope @ fit.covariance_robust @ slope.T, scale


@pytest.mark.parametrize("own", [False, True])
def test_the_input_is_tested_by_the_sums_of_the_docstring(own: bool) -> None:
    judged = two_experiments()
    fit = oe(judged if own else data(1, 400), nb=2, nf=2)
    fit = replace(fit, covariance_robust=9.0 * fit.covariance)

    tested = residuals(fit, judged, lags=L)

    s, M, scale = written_out(fit, judged, own=own)
    past, future = slice(L, None), slice(0, L)
    assert tested.on_estimation_data is own
    n = fit.N * fit.loss / fit.noise_variance  # degrees of freedom of s²
    for p, at in ((tested.missing_dynamics, past), (tested.feedback, future)):
        expected = joint_p_value(s[at], M[at, at], 1e-4, n, independent=not own)
        assert p == pytest.approx(expected, rel=1e-6)
    np.testing.assert_array_equal(tested.cross_lags, np.arange(-L, L + 1))
    np.testing.assert_allclose(tested.cross_correlation, s / scale, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(tested.cross_std, np.sqrt(np.diag(M)) / scale, rtol=1e-6)


def test_a_direct_term_that_the_model_lacks_is_dynamics_missing() -> None:
    seen = data(1, 400, B=[0.3, 1.0, 0.5])

    tested = residuals(arx(seen, na=4, nb=4, nk=1), seen)

    assert tested.missing_dynamics < 1e-6
    assert tested.feedback > 0.01


def test_no_pair_of_residuals_spans_two_experiments() -> None:
    judged, fit = two_experiments(), oe(data(1, 400), nb=2, nf=2)

    tested = residuals(fit, judged, lags=L)

    parts = [r.e[r.known] for r in prediction_errors(fit, judged)]
    N = sum(e.size for e in parts)
    pairs = np.array([sum(e.size - k for e in parts) for k in range(L + 1)])
    R = np.array([sum(float(e[k:] @ e[: e.size - k]) for e in parts) for k in range(L + 1)]) / pairs
    Q = (N + 2) / N * np.sum(pairs[1:] * (R[1:] / R[0]) ** 2)
    np.testing.assert_allclose(tested.autocorrelation, R / R[0], rtol=1e-9)
    assert tested.ljung_box == pytest.approx(chi2.sf(Q, L), rel=1e-9)


@pytest.mark.parametrize("own", [False, True])
def test_the_whiteness_test_accounts_for_the_estimated_parameters(own: bool) -> None:
    """By its projection on the estimation data, by its covariance on other data."""
    judged = two_experiments()
    fit = oe(judged if own else data(1, 100), nb=2, nf=2)
    known = prediction_errors(fit, judged)
    signals = [[getattr(r, name)[:, 0] for r in known] for name in ("e", "Psi", "S")]

    tested = residuals(fit, judged, lags=L)

    p = {
        asked: portmanteau(*signals, L, None if asked else fit.covariance).p_value
        for asked in (True, False)
    }
    assert abs(p[True] - p[False]) > 1e-3
    assert tested.white.p_value == pytest.approx(p[own], rel=1e-9)


def test_a_constant_input_tests_neither_dynamics_nor_feedback() -> None:
    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([-1.0, 1.0], 100), 4)
    noise = 0.1 * rng.standard_normal(400)
    fit = arx(Dataset(u=u, y=apply_filter([0, 1], [1, -0.7], u) + noise, Ts=0.1), na=1, nb=1)

    said = repr(residuals(fit, Dataset(u=np.ones(400), y=3.3 + noise, Ts=0.1)))

    assert "dynamics missing: not tested" in said
    assert "feedback: not tested" in said
    assert "no feedback" not in said


def joint(test: Any) -> list[float]:
    return [test.white.p_value, test.missing_dynamics, test.feedback]


@pytest.mark.parametrize(
    ("outputs", "inputs", "orders"),
    [
        (["y1"], ["u1"], {"nb": 2, "nf": 2}),
        (["y1"], ["u1", "u2"], {"nb": [[2, 1]], "nf": [[2, 1]], "nk": [[1, 2]]}),
        (["y1", "y2"], ["u1", "u2"], {"nb": [[2, 1], [1, 1]], "nf": [[2, 1], [1, 1]], "nk": NK}),
    ],
    ids=["1x1", "1x2", "2x2"],
)
@pytest.mark.parametrize("missing", sampled([0.0, 0.2]))
def test_the_tests_of_a_true_model_pass(
    outputs: list[str], inputs: list[str], orders: dict[str, Any], missing: float
) -> None:
    p = []
    for seed in range(4):
        first, other = (
            two_outputs(k, missing=missing, cross=0.5 * ("u2" in inputs)).channels(outputs, inputs)
            for k in (seed, seed + 100)
        )
        fit = armrig.oe(first, **orders)
        for data in (first, other):
            p += joint(armrig.residuals(fit, data))

    assert min(p) > 0.0005
    assert 0.2 < np.mean(p) < 0.8


def test_the_residuals_of_a_joint_estimate_have_no_part_that_was_estimated() -> None:
    """Rows with orders of their own and correlated noise are weighted together."""
    data = two_outputs(0)
    fit: Any = armrig.arx(data, na=[[2, 1], [0, 1]], nb=[[2, 1], [1, 2]])  # type: ignore[arg-type]
    (part,) = prediction_errors(fit, data, on_own_data=True)
    projected = projection([part], with_parameters=True)
    B = np.concatenate([part.S, projected.T[0]], axis=2)
    WB = part.weight(B)

    np.testing.assert_allclose(np.einsum("tir,tik->rk", B, WB), np.eye(projected.rank), atol=1e-9)
    # A part of the noise would be about 1. The initial state is the difference from 0.
    left = np.einsum("tir,ti->r", WB, np.nan_to_num(part.e))
    assert np.abs(left).max() < 0.05


@pytest.mark.parametrize("run", [10, 60])
def test_a_sum_that_the_estimate_determines_is_not_tested(run: int) -> None:
    """The poles are so quick that B nearly fits each lag. A rest of the ramp would be p < 1e-40."""
    drawn = chassis_and_arm(23)
    data = drawn.signals(500, 0.0, (23, 500, run, 0))

    found = armrig.residuals(drawn.fit(data), data)

    assert min(found.missing_dynamics_by_pair.ravel()) > 0.01


def test_several_experiments_are_tested_together() -> None:
    parts = [two_outputs(seed)[: SAMPLES // 2] for seed in (0, 1)]
    data = armrig.merge(parts)
    fit: Any = armrig.oe(data, nb=[[2, 1], [1, 1]], nf=[[2, 1], [1, 1]], nk={("y1", "u2"): 2})  # type: ignore[arg-type]

    found = armrig.residuals(fit, data)

    # No product of samples of two experiments is in a mean.
    e = [found.e[: SAMPLES // 2], found.e[SAMPLES // 2 :]]
    lag_3 = sum(x[3:].T @ x[:-3] for x in e) / (SAMPLES - 6)
    lag_3 /= np.mean(found.e**2, axis=0).prod() ** 0.5
    assert found.autocorrelation[0, 1, 3] == pytest.approx(lag_3[0, 1])
    for white, quality in zip(found.white_by_output, fit.quality, strict=True):
        assert white.p_value == pytest.approx(quality.white.p_value, rel=0.02)
    assert min(joint(found)) > 0.001


def test_a_delay_too_long_shows_only_in_its_pair() -> None:
    found = armrig.residuals(oe_of_two_outputs(0, nk_12=3), two_outputs(100))

    assert found.missing_dynamics < 1e-6
    p = found.missing_dynamics_by_pair
    assert p[0, 1] < 1e-6
    assert min(p[0, 0], p[1, 0], p[1, 1]) > 1e-3
    assert "u2 to y1: dynamics missing (p < 0.001)" in repr(found)


def test_only_the_joint_test_rejects_delayed_common_noise() -> None:
    """y2 contains the noise of y1 three samples later: each output alone is white."""
    data, other = two_outputs(0), two_outputs(100)
    rng = np.random.default_rng(5)
    parts = []
    for signals in (data, other):
        e = 0.4 * rng.standard_normal(SAMPLES + 3)
        y = signals.y + np.column_stack([e[3:], e[:SAMPLES]])
        parts.append(signals.replaced(step=None, y=y))
    nk = {("y1", "u2"): 2}
    fit: Any = armrig.oe(parts[0], nb=[[2, 1], [1, 1]], nf=[[2, 1], [1, 1]], nk=nk)  # type: ignore[arg-type]

    found = armrig.residuals(fit, parts[1])

    assert found.white.p_value < 1e-6
    assert all(white.p_value > 0.01 for white in found.white_by_output)


def test_an_input_that_follows_an_output_shows_as_feedback() -> None:
    rng = np.random.default_rng(8)
    e = 0.5 * rng.standard_normal(SAMPLES)
    u = np.sign(rng.standard_normal((SAMPLES, 2)))
    v = apply_filter([1.0], [1, -0.8], e)
    u[:, 1] += np.append(0.0, v[:-1])  # u2 follows the noise of y
    y = apply_filter([0, 1.0], [1, -0.5], u[:, 0]) + apply_filter([0, 0.5], [1, -0.5], u[:, 1]) + v
    data = Signals(u=u, y=y[:, None], Ts=0.1, inputs=["u1", "u2"], outputs=["y"])
    fit: Any = armrig.oe(data, nb=1, nf=1)

    found = armrig.residuals(fit, data)

    assert found.feedback_by_pair[0, 1] < 1e-4
    assert found.feedback_by_pair[0, 0] > 1e-3
    assert armrig.open_loop(data)["y", "u2"].feedback  # type: ignore[index]
    assert not armrig.open_loop(data)["y", "u1"].feedback  # type: ignore[index]


@pytest.mark.parametrize("shape", ["1x1", "2x2"])
@pytest.mark.parametrize("factor", [20.0, 1e4])
def test_the_allowance_is_a_factor_of_deviations(shape: str, factor: float) -> None:
    """The variance of the parameters is added to that of the noise, and must be less."""
    fit = oe(data(1, 400), nb=2, nf=2) if shape == "1x1" else oe_of_two_outputs(0)
    judged = data(2, 300) if shape == "1x1" else two_outputs(100)
    wide = replace(fit, covariance_robust=factor * fit.covariance_robust)

    sure, unsure = (residuals(one, judged) for one in (fit, wide))

    expected = factor * (sure.allowance**2 - 1) if factor < 100 else np.inf
    assert unsure.allowance**2 - 1 == pytest.approx(expected, rel=1e-3)
    assert 0.9 < sure.allowance < 2
    assert not sure.powerless
    assert ("correlations without limit" in unsure.powerless) == (factor > 100)


def test_sums_and_deviations_of_each_pair_are_those_of_its_signals() -> None:
    """Correlation of e_i(t) with u_j(t - k), and its deviation about 1/sqrt(N) for white e."""
    fit, data = oe_of_two_outputs(0), two_outputs(100)

    found = armrig.residuals(fit, data, 5)

    e, u = np.nan_to_num(found.e), data.u - data.u.mean(axis=0)
    (part,) = prediction_errors(fit, data)
    WS = part.weight(part.S)
    for i, j, k in ((0, 1, 3), (1, 0, -4), (0, 0, 0), (1, 1, 5)):
        late, early = max(k, 0), max(-k, 0)
        x, z = e[late : SAMPLES - early, i], u[early : SAMPLES - late, j]
        # The initial states are estimated from the same data.
        left = u[:, j] - WS[:, i] @ (part.S[:, i].T @ u[:, j])
        expected = (x @ z) / np.sqrt(np.sum(e[:, i] ** 2) * np.sum(left**2))
        at = int(np.flatnonzero(found.cross_lags == k)[0])
        assert found.cross_correlation[i, j, at] == pytest.approx(expected, abs=1e-9)
    np.testing.assert_allclose(found.cross_std, 1 / np.sqrt(SAMPLES), rtol=0.6)


def test_given_weights_of_the_outputs_are_those_of_the_projection() -> None:
    """The estimator minimised the sum of w_i e_i²."""
    fit = replace(oe_of_two_outputs(0), output_weights=(2.0, 8.0))

    (part,) = prediction_errors(fit, two_outputs(0), on_own_data=True)

    weights = np.einsum("tij,tik->tjk", part.G, part.G)
    np.testing.assert_allclose(weights, np.broadcast_to(np.diag([2.0, 8.0]), weights.shape))


@pytest.mark.parametrize("own", [True, False])
def test_the_test_of_several_outputs_is_for_one_output_the_portmanteau_test(own: bool) -> None:
    """With few samples, to the digits, on the estimation data and on others."""
    fitted, judged = data(1, 50), data(1 if own else 11, 50)
    fit = oe(fitted, nb=2, nf=2)
    parts, J = prediction_errors(fit, judged, on_own_data=own), parameters_of(fit)
    projected = projection(parts, with_parameters=own)
    of_theta = None if own else J @ fit.covariance_robust @ J.T
    Lambda = pairwise_covariance(np.vstack([part.e for part in parts]))

    white = _white(projected, Lambda, 1 / np.sqrt(Lambda), of_theta, L)

    (expected,) = white_by_output(projected, of_theta, L)
    assert fit.estimated_from(judged) is own
    assert white.test == expected.test
    assert white.p_value == pytest.approx(expected.p_value, rel=1e-6)


def pendulum() -> tuple[Dataset, Dataset]:
    """Return two halves of a pendulum that a held torque drives to large angles."""
    rng = np.random.default_rng(1)
    u, x, y = np.repeat(rng.uniform(0, 1, 20), 120), np.zeros(2), np.empty(2400)
    for k in range(2400):
        y[k] = x[0]
        for _ in range(4):
            x = x + 0.0025 * np.array([x[1], 60 * u[k] - 0.8 * x[1] - 90 * np.sin(x[0])])
    y += 0.002 * rng.standard_normal(2400)
    whole = Dataset(u=u - u[:1200].mean(), y=y - y[:1200].mean(), Ts=0.01)
    return whole[:1200], whole[1200:]


@pytest.mark.parametrize("orders", [(2, 2), (5, 7)])
def test_a_wrong_model_is_not_white(orders: tuple[int, int]) -> None:
    """Its uncertain parameters and its own residuals would allow any misfit."""
    first, other = pendulum()

    tested = residuals(oe(first, nb=orders[0], nf=orders[1], starts="few"), other)

    assert tested.ljung_box < 1e-6
    assert tested.white.coloured
    assert "no dynamics missing (p" not in repr(tested)


def test_a_right_model_passes_in_resonant_noise() -> None:
    """Yule and Walker's equations would reject in 15 % of the runs at 5 %."""
    p = []
    for seed in range(25):
        rng = np.random.default_rng([5, seed])
        own, other = (drawn("oe", "resonant", 200, rng) for _ in range(2))
        fit = oe(own, nb=2, nf=2, starts="few")
        tested = [residuals(fit, judged) for judged in (own, other)]
        p += [p for test in tested for p in (test.missing_dynamics, test.feedback)]

    assert np.mean(np.array(p) < 0.05) < 0.08


def test_larger_errors_than_at_the_estimation_are_reported() -> None:
    fit, other = oe(data(1, 400), nb=2, nf=2), data(2, 400)
    noisier = other.replaced(y=other.y + 3 * (data(3, 400).y - data(4, 400).y), step=None)

    same, worse = residuals(fit, other), residuals(fit, noisier)

    assert same.larger == ""
    assert worse.error_ratio > 2
    assert "times as large as on the estimation data (p < 0.001)" in repr(worse)
    assert worse.rejects


def test_a_model_of_an_older_file_is_tested_with_the_noise_of_its_residuals() -> None:
    fit, other = oe(data(1, 400), nb=2, nf=2), data(2, 400)
    older = replace(fit, quality=(replace(fit.quality[0], autoregression=()),))

    tested = residuals(older, other)

    assert not tested.noise_of_estimation
    assert tested.missing_dynamics == pytest.approx(residuals(fit, other).missing_dynamics, abs=0.2)
    assert "Estimate the model again" in repr(tested)


def test_coloured_residuals_do_not_show_whether_dynamics_are_missing_if_u_is_slow() -> None:
    rng = np.random.default_rng(4)
    u, e = np.repeat(rng.choice([-1.0, 1.0], 8), 100), rng.standard_normal(800)
    seen = Dataset(
        u=u, y=apply_filter([0, 1], [1, -0.5], u) + apply_filter([1], [1, -0.99], e), Ts=0.1
    )

    tested = residuals(oe(seen, nb=1, nf=1), seen)

    assert "independent values. Record longer" in tested.blind
    assert "the data do not show whether dynamics are missing" in repr(tested)


@pytest.mark.parametrize("seed", [1, 2], ids=["estimation data", "validation data"])
def test_huge_deviations_of_several_outputs_end_in_a_result(seed: int) -> None:
    """A step of a thousandth of these deviations makes the predictor unstable."""
    fit = armrig.n4sid(two_outputs(1), order=3, replicates=10)
    covariances = {name: 1e12 * getattr(fit, name) for name in ("covariance", "covariance_robust")}

    tested = residuals(replace(fit, **covariances), two_outputs(seed))

    assert 0.0 <= tested.whiteness <= 1.0
    assert tested.on_estimation_data or "find nothing" in tested.powerless


def test_feedback_within_a_sample_is_not_taken_for_missing_dynamics() -> None:
    """The controller computes u from y of the same sample, so lag 0 alone is correlated."""
    loop = under_control()

    tested = residuals(armrig.bj(loop, nb=2, nc=1, nd=1, nf=2), loop)

    assert tested.feedback < 0.01 <= tested.missing_dynamics
    assert "feedback, or a delay too large" in repr(tested)
