"""The covariance of a score, against sums written out: experiments, holes and blocks."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.numerics import covariance
from armrig.numerics.covariance import joint_exogenous_score, newey_west_score
from armrig.numerics.inference import OutputResiduals, infer
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array, apply_filter
from armrig.numerics.whiteness import autoregression
from scipy.linalg import toeplitz

SIZES = (130, 90)


def two_experiments(
    seed: int, C: list[float], sizes: tuple[int, int] = SIZES
) -> tuple[list[Array], list[Array]]:
    """Return Psi and residuals 1/C e of two experiments, a hole in the second."""
    rng = np.random.default_rng(seed)
    blocks = [rng.standard_normal((n, 3)).cumsum(axis=0) for n in sizes]
    residuals = [apply_filter([1.0], C, rng.standard_normal(n)) for n in sizes]
    residuals[1][40:43], blocks[1][40:43] = np.nan, 0.0
    return blocks, residuals


@pytest.mark.parametrize(("sizes", "L"), [(SIZES, 4), ((2200, 90), 8)])
def test_newey_and_west_weigh_the_pairs_of_each_experiment(sizes: tuple[int, int], L: int) -> None:
    """The weights are 1 - k/(L + 1) up to L = 4 (N/100)^(2/9), also in blocks of 2048 rows."""
    blocks, residuals = two_experiments(1, [1.0, -0.8], sizes)

    M = newey_west_score(blocks, residuals)

    expected = np.zeros((3, 3))
    for Psi, e in zip(blocks, residuals, strict=True):
        scores = Psi * np.nan_to_num(e)[:, None]
        expected += scores.T @ scores
        for k in range(1, L + 1):
            pairs = scores[k:].T @ scores[:-k]
            expected += (1 - k / (L + 1)) * (pairs + pairs.T)
    np.testing.assert_allclose(M, expected, rtol=1e-10)


@pytest.mark.parametrize("d", [1, 12])
def test_for_white_residuals_the_robust_covariance_is_the_classic(d: int) -> None:
    """The same degrees of freedom are subtracted: 12 parameters are a fifth of 60 residuals."""
    rng = np.random.default_rng(5)
    Phi, y = rng.standard_normal((60, d)), rng.standard_normal(60)
    e = y - Phi @ np.linalg.lstsq(Phi, y, rcond=None)[0]
    assert autoregression([e])[0].size == 1  # white, as the autoregression sees it

    basis = orthonormal(Phi)
    found = infer([[OutputResiduals(e=e, H=basis.Q)]], basis.W, score="exogenous")

    np.testing.assert_allclose(found.covariance_robust, found.covariance, rtol=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_an_autoregression_has_at_most_a_tenth_of_the_residuals_as_its_order(seed: int) -> None:
    """Residuals with a period of seven samples need the order 7; missing ones do not count."""
    rng = np.random.default_rng(seed)
    period, noise = rng.standard_normal(7), 0.05 * rng.standard_normal(300)
    orders = {}
    for N in (40, 60, 69, 300):
        e = np.resize(period, N) + noise[:N]
        holed = np.insert(e, [10, 30] * 15, np.nan)
        orders[N] = [autoregression([x])[0].size - 1 for x in (e, holed)]

    assert all(max(of_both) <= N // 10 for N, of_both in orders.items())
    assert 7 <= max(orders[300]) <= 10 * np.log10(300)


NOISE = ([1.0, -0.8], [1.0, 0.6])


def coloured(outputs: int) -> tuple[list[list[Array]], list[list[Array]]]:
    """Return H and residuals of different levels, for each of two experiments and each output."""
    rng = np.random.default_rng(2)
    H, e = [], []
    for N, level in zip(SIZES, (1.0, -1.0), strict=True):
        white = rng.standard_normal((N, 2)) @ [[1.0, 0.5], [0.0, 1.0]]
        e.append([level + apply_filter([1.0], NOISE[i], white[:, i]) for i in range(outputs)])
        H.append([rng.standard_normal((N, 3)).cumsum(axis=0) for _ in range(outputs)])
    return H, e


def noise_of(e: list[list[Array]]) -> list[tuple[Array, float]]:
    return [autoregression([*of]) for of in zip(*e, strict=True)]


@pytest.mark.parametrize("outputs", [1, 2])
def test_the_order_of_the_experiments_does_not_matter(outputs: int) -> None:
    H, e = coloured(outputs)

    found, turned = (
        joint_exogenous_score(*both, noise_of(both[1])) for both in ((H, e), (H[::-1], e[::-1]))
    )

    np.testing.assert_allclose(turned, found, rtol=1e-9)


@pytest.mark.parametrize(("outputs", "rows"), [(1, 1 << 16), (1, 37), (2, 1 << 16)])
def test_the_covariance_of_several_outputs_contains_their_common_noise(
    outputs: int, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sum of H_i^T L_i L_k^T H_k S_ik over the outputs; L are the autoregressions' responses.

    S has the variances of the autoregressions, and the correlation of their errors. Blocks of rows
    give the same sum.
    """
    monkeypatch.setattr(covariance, "_FILTER_ROWS", rows)
    H, e = coloured(outputs)
    models = noise_of(e)
    assert all(C.size > 1 for C, _ in models)
    errors = np.vstack(
        [
            np.column_stack([_whitened(C, x) for x, (C, _) in zip(of, models, strict=True)])
            for of in e
        ]
    )
    S = errors.T @ errors
    std = np.sqrt(np.diag(S))
    deviation = np.sqrt([s2 for _, s2 in models])
    S *= np.outer(deviation, deviation) / np.outer(std, std)

    expected = np.zeros((3, 3))
    for of in H:
        back = [_response(C, h.shape[0]).T @ h for h, (C, _) in zip(of, models, strict=True)]
        for i in range(outputs):
            for k in range(outputs):
                expected += S[i, k] * back[i].T @ back[k]
    np.testing.assert_allclose(joint_exogenous_score(H, e, models), expected, rtol=1e-9)


def _response(C: Array, N: int) -> Array:
    """Return the lower triangular matrix of the impulse response of 1/C."""
    return np.tril(toeplitz(apply_filter([1.0], C, np.eye(1, N)[0])))


def _whitened(C: Array, e: Array) -> Array:
    """Return C e; e is 0 before the experiment."""
    return np.convolve(C, e)[: e.size]
