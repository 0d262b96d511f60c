"""The covariance of several outputs, against the covariance of one output and a written sum."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.estimation.multivariable.inference import OutputResiduals, exogenous_covariance
from armrig.numerics.covariance import exogenous_score
from armrig.numerics.polynomial import Array, filtered
from armrig.numerics.whiteness import autoregression
from scipy.linalg import toeplitz

SIZES = (130, 90)
NOISE = ([1.0, -0.8], [1.0, 0.6])


def two_experiments(outputs: int) -> list[list[OutputResiduals]]:
    """Return coloured residuals of different levels, and their influence on three parameters."""
    rng = np.random.default_rng(2)
    found = []
    for N, level in zip(SIZES, (1.0, -1.0), strict=True):
        white = rng.standard_normal((N, 2)) @ [[1.0, 0.5], [0.0, 1.0]]
        found.append(
            [
                OutputResiduals(
                    e=level + filtered([1.0], NOISE[i], white[:, i]),
                    y=np.zeros(N),
                    H=rng.standard_normal((N, 3)).cumsum(axis=0),
                    Psi=np.zeros((N, 0)),
                    Z=np.zeros((N, 0)),
                )
                for i in range(outputs)
            ]
        )
    return found


def test_the_covariance_of_one_output_is_the_score_of_one_output() -> None:
    experiments = two_experiments(1)

    expected = exogenous_score([of[0].H for of in experiments], [of[0].e for of in experiments])

    np.testing.assert_allclose(exogenous_covariance(experiments), expected, rtol=1e-9)


@pytest.mark.parametrize("outputs", [1, 2])
def test_the_order_of_the_experiments_does_not_matter(outputs: int) -> None:
    experiments = two_experiments(outputs)

    found = exogenous_covariance(experiments)

    np.testing.assert_allclose(exogenous_covariance(experiments[::-1]), found, rtol=1e-9)


def test_the_covariance_of_two_outputs_contains_their_common_noise() -> None:
    """The sum of H_i^T L_i L_k^T H_k S_ik over both outputs; L are the autoregressions' responses.

    S has the variances of the autoregressions, and the correlation of their errors.
    """
    experiments = two_experiments(2)
    models = [autoregression([of[i].e for of in experiments]) for i in range(2)]
    assert all(C.size > 1 for C, _ in models)
    errors = np.vstack(
        [
            np.column_stack([_whitened(C, r.e) for r, (C, _) in zip(of, models, strict=True)])
            for of in experiments
        ]
    )
    S = errors.T @ errors
    std = np.sqrt(np.diag(S))
    deviation = np.sqrt([s2 for _, s2 in models])
    S *= np.outer(deviation, deviation) / np.outer(std, std)

    expected = np.zeros((3, 3))
    for of in experiments:
        back = [_response(C, r.e.size).T @ r.H for r, (C, _) in zip(of, models, strict=True)]
        for i in range(2):
            for k in range(2):
                expected += S[i, k] * back[i].T @ back[k]
    np.testing.assert_allclose(exogenous_covariance(experiments), expected, rtol=1e-9)


def _response(C: Array, N: int) -> Array:
    """Return the lower triangular matrix of the impulse response of 1/C."""
    return np.tril(toeplitz(filtered([1.0], C, np.eye(1, N)[0])))


def _whitened(C: Array, e: Array) -> Array:
    """Return C e; e is 0 before the experiment."""
    return np.convolve(C, e)[: e.size]
