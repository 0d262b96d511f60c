"""A subspace model by hand: its matrices and its text."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from armrig.models.fit import Fit
from armrig.models.subspace_fit import SubspaceFit

from tests.clients.models.made_fits import made


def subspace(**orders: Any) -> SubspaceFit:
    fit = made(structure="n4sid", **orders)
    known = {f.name: getattr(fit, f.name) for f in fields(Fit)}
    correlations = np.array([0.99999, 0.95, 0.3, 0.2, 0.1, 0.05, 0.04, 0.03, 0.02, 0.01, 0.001])
    return SubspaceFit(
        **known, weights="cva", horizon=15, singular_values=correlations,
        canonical_correlations=correlations, suggested_order=3,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("B", "nk", "n"), [((0.3, 1.0, 0.5), 0, 2), ((0, 1.0, 0.5), 1, 2), ((0, 0, 0, 0.7), 3, 3)]
)
def test_the_matrices_have_the_responses_of_the_polynomials(
    B: tuple[float, ...], nk: int, n: int
) -> None:
    """From u by B/A, and from e by C/A, also with a direct term and with a delay."""
    fit = subspace(A=(1, -1.2, 0.5), B=B, C=(1, 0.4, 0.1), nk=nk)

    A, Bs, C, D, K = fit.state_space()

    assert A.shape == (n, n)
    for z in np.exp(1j * np.array([0.1, 0.9, 2.5])):
        inverse = np.linalg.inv(z * np.eye(n) - A)
        denominator = np.polyval(fit.A[::-1], 1 / z)
        expected = np.polyval(fit.B[::-1], 1 / z) / denominator
        assert (C @ inverse @ Bs + D)[0, 0] == pytest.approx(expected)
        noise = np.polyval(fit.C[::-1], 1 / z) / denominator
        assert (C @ inverse @ K + 1)[0, 0] == pytest.approx(noise)
        assert fit.to_control()(z) == pytest.approx(expected)
