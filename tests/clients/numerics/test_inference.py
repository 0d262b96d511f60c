"""From residuals and their sensitivity to covariance, loss and verdict."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.numerics.inference import (
    Inference,
    OutputResiduals,
    Score,
    Test,
    infer,
)
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array, apply_filter
from scipy.special import chdtrc, chdtri

N, D = 400, 3
THETA = np.array([1.0, -2.0, 0.5])


def fitted(seed: int, C: list[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Phi, y and theta of y = Phi theta + C(q) e."""
    rng = np.random.default_rng(seed)
    Phi = np.column_stack(
        [apply_filter([1.0], [1.0, -0.8], x) for x in rng.standard_normal((D, N))]
    )
    y = Phi @ THETA + apply_filter(C, [1.0], rng.standard_normal(N))
    return Phi, y, np.linalg.lstsq(Phi, y, rcond=None)[0]


def inferred(
    residuals: list[Array],
    blocks: list[Array],
    *,
    spans: list[Array] | None = None,
    y: Array | None = None,
    **options: Any,
) -> Inference:
    """Return the inference of a regression from its residuals and its regressors."""
    basis = orthonormal(np.vstack(blocks))
    edges = np.cumsum([e.size for e in residuals])[:-1]
    measured = [None] * len(residuals) if y is None else np.split(y, edges)
    each = zip(residuals, np.split(basis.Q, edges), spans or measured, measured, strict=True)
    parts = [
        [OutputResiduals(e=e, H=Q, Z=span if spans else None, y=part)] for e, Q, span, part in each
    ]
    return infer(parts, basis.W, **options)


def regression(seed: int, C: list[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray, Inference]:
    Phi, y, theta = fitted(seed, C)
    e, blocks = np.split(y - Phi @ theta, [150]), np.split(Phi, [150])
    return Phi, y, theta, inferred(e, blocks, score="exogenous", y=y)


def test_the_results_of_least_squares_equal_those_of_the_textbook() -> None:
    """Lambda (Phi^T Phi)^-1 with N - d degrees of freedom."""
    Phi, y, theta, found = regression(1, [1.0])

    sse = float(np.sum((y - Phi @ theta) ** 2))
    expected = sse / (N - D) * np.linalg.inv(Phi.T @ Phi)
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-10)
    assert found.noise_variance == pytest.approx(sse / (N - D))
    assert found.quality[0].loss == pytest.approx(sse / N)
    assert found.quality[0].N == N
    assert found.quality[0].fit_percent == pytest.approx(100 * (1 - np.sqrt(sse / N) / np.std(y)))


@pytest.mark.parametrize("score", ["exogenous", "correlated"])
def test_the_robust_form_holds_for_coloured_noise(score: Score) -> None:
    """In 300 runs the estimates scatter by the robust deviations, and by more than the classic."""
    estimates, robust, classic = [], [], []
    for seed in range(300):
        Phi, y, theta = fitted(seed, [1.0, 0.9, 0.8])
        found = inferred([y - Phi @ theta], [Phi], score=score, test=None)
        estimates.append(theta)
        robust.append(np.diag(found.covariance_robust))
        classic.append(np.diag(found.covariance))

    scatter = np.std(estimates, axis=0)
    np.testing.assert_allclose(np.sqrt(np.mean(robust, axis=0)), scatter, rtol=0.15)
    assert (np.sqrt(np.mean(classic, axis=0)) < 0.8 * scatter).all()


@pytest.mark.parametrize("score", ["exogenous", "correlated"])
@pytest.mark.parametrize("apart", [1e-5, 1e-7, 1e-9])
def test_nearly_equal_columns_give_no_negative_variance(score: Score, apart: float) -> None:
    """Bread times M times bread would round to negative values, whose root is NaN."""
    rng = np.random.default_rng(4)
    x, z, w, v = rng.standard_normal((4, N))
    Phi = np.column_stack([x, x + apart * z, w, w + apart * v])
    e = apply_filter([1.0], [1.0, -0.8], rng.standard_normal(N))

    found = inferred([e], [Phi], score=score, test=None)

    std = np.sqrt(np.diag(found.covariance_robust))
    classic = np.sqrt(np.diag(found.covariance))
    assert np.all((std > 0.1 * classic) & (std < 10 * classic))


@pytest.mark.parametrize("test", ["portmanteau", "ljung-box"])
@pytest.mark.parametrize("samples", [N, 99])
def test_missing_residuals_do_not_change_the_result(samples: int, test: Test) -> None:
    """59 residuals of 99 samples are left: too few for 25 lags."""
    Phi, y, theta, _ = regression(2, [1.0])
    Phi, y = Phi[:samples], y[:samples]
    e = y - Phi @ theta
    there = np.arange(samples) >= 40  # a hole at the start moves no pair of neighbours apart

    holed, cut = (
        inferred([residuals], [Psi], score="correlated", y=output, test=test)
        for residuals, Psi, output in (
            (np.where(there, e, np.nan), np.where(there[:, None], Phi, 0.0), y),
            (e[there], Phi[there], y[there]),
        )
    )

    assert holed.quality[0].N == cut.quality[0].N
    assert holed.quality[0].fit_percent == pytest.approx(cut.quality[0].fit_percent, rel=1e-12)
    np.testing.assert_allclose(holed.covariance, cut.covariance, rtol=1e-12)
    np.testing.assert_allclose(holed.covariance_robust, cut.covariance_robust, rtol=1e-12)
    assert holed.quality[0].white.p_value == pytest.approx(cut.quality[0].white.p_value, rel=1e-9)


def test_nuisance_parameters_reduce_the_degrees_of_freedom() -> None:
    Phi, y, theta, plain = regression(3, [1.0])
    e = y - Phi @ theta
    span = orthonormal(np.ones((N, 1))).Q

    by_span = inferred([e], [Phi], spans=[span], score="exogenous")
    by_number = inferred([e], [Phi], parameters=[D + 1], score="exogenous")

    assert by_span.noise_variance == by_number.noise_variance
    assert by_span.noise_variance == pytest.approx(plain.noise_variance * (N - D) / (N - D - 1))


def test_coloured_residuals_are_rejected_and_white_residuals_are_not() -> None:
    for C, white in (([1.0], True), ([1.0, 0.9], False)):
        Phi, y, theta, found = regression(4, C)
        e = [y - Phi @ theta]
        assert (found.quality[0].white.p_value > 0.01) == white
        p = inferred(e, [Phi], score="exogenous", test="ljung-box").quality[0].white.p_value
        assert (p > 0.01) == white
        assert np.isnan(inferred(e, [Phi], score="exogenous", test=None).quality[0].white.p_value)
        assert np.isnan(
            inferred(e, [Phi], score="exogenous", rounding=1e9).quality[0].white.p_value
        )


def test_the_noise_is_unknown_with_as_many_parameters_as_samples() -> None:
    Phi, y, theta, _ = regression(6, [1.0])
    e = (y - Phi @ theta)[:4]

    with pytest.raises(ValueError, match=r"4 samples .* 3 parameters and 1 initial"):
        inferred([e], [Phi[:4]], spans=[np.full((4, 1), 0.5)], score="exogenous")


def test_a_fitted_autoregression_reduces_the_ljung_box_degrees_of_freedom() -> None:
    """At most all degrees but one."""
    Phi, y, theta, _ = regression(7, [1.0])
    e = y - Phi @ theta
    p = [
        inferred([e], [Phi], score="exogenous", test="ljung-box", prewhitening=n)
        .quality[0]
        .white.p_value
        for n in (0, 3, 99)
    ]

    Q = chdtri(25, p[0])
    assert p[1:] == pytest.approx([chdtrc(22, Q), chdtrc(1, Q)])


@pytest.mark.parametrize("score", ["exogenous", "correlated"])
@pytest.mark.parametrize("level", [1.0, 20.0])
def test_the_influence_may_have_any_scale(score: Score, level: float) -> None:
    """An estimator of several outputs weights them: H is no orthonormal basis of Psi."""
    Phi, y, theta, _ = regression(8, [1.0, 0.5])
    e, basis = y - Phi @ theta, orthonormal(Phi)
    plain = infer([[OutputResiduals(e=e, H=basis.Q, y=y)]], basis.W, score=score)

    scaled = infer(
        [[OutputResiduals(e=e, y=y, H=basis.Q / level, Psi=Phi)]], level * basis.W, score=score
    )

    np.testing.assert_allclose(scaled.covariance, plain.covariance, rtol=1e-10)
    np.testing.assert_allclose(scaled.covariance_robust, plain.covariance_robust, rtol=1e-10)
    np.testing.assert_allclose(scaled.noise_covariance, plain.noise_covariance, rtol=1e-12)
    (own,), (expected,) = scaled.quality, plain.quality
    assert (own.loss, own.N, own.fit_percent) == (expected.loss, expected.N, expected.fit_percent)
    assert own.white.p_value == pytest.approx(expected.white.p_value, rel=1e-9)


def test_two_outputs_have_the_degrees_of_freedom_of_their_own_parameters() -> None:
    """Outputs with parameters of their own and independent noise: each has its own inference."""
    rng = np.random.default_rng(9)
    each = [fitted(seed, [1.0]) for seed in (10, 11)]
    levels, outputs, H = (1.0, 3.0), [], []
    for k, ((Phi, y, theta), level) in enumerate(zip(each, levels, strict=True)):
        e, basis = level * (y - Phi @ theta), orthonormal(Phi)
        influence = np.zeros((N, 2 * D))
        influence[:, k * D : (k + 1) * D] = basis.Q @ basis.W.T
        e[rng.permutation(N)[:k]] = np.nan
        H.append((e, basis))
        outputs.append(OutputResiduals(e=e, y=level * y, H=influence, Psi=Phi))

    found = infer([outputs], np.eye(2 * D), score="exogenous")

    for k, (e, basis) in enumerate(H):
        alone = infer([[OutputResiduals(e=e, H=basis.Q)]], basis.W, score="exogenous")
        block = slice(k * D, (k + 1) * D)
        assert found.noise_covariance[k, k] == pytest.approx(alone.noise_variance)
        np.testing.assert_allclose(found.covariance[block, block], alone.covariance, rtol=1e-9)
        assert found.quality[k].loss == pytest.approx(alone.quality[0].loss)
    off = found.covariance[:D, D:]
    expected = found.noise_covariance[0, 1] * outputs[0].H[:, :D].T @ outputs[1].H[:, D:]
    np.testing.assert_allclose(off, expected, rtol=1e-9)
