"""Exact sampling of transfer functions, against scipy and against a finer sampling."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.numerics.exact_sampling import Hold, sample_system
from armrig.numerics.polynomial import apply_filter
from scipy.signal import cont2discrete

F = np.array([0.5, 0.3, 0.05])
HOLDS = pytest.mark.parametrize("hold", ["zoh", "foh"])


def test_small_samples_give_the_response_of_scipy() -> None:
    """Each numerator s^p/F is sampled as scipy samples it, for a held input and a straight line."""
    for hold in ("zoh", "foh"):
        found = sample_system(F, 0.0, hold)
        for p in range(F.size):
            B, A, _ = cont2discrete((np.eye(1, p + 1)[0], np.append(1, F)), 1.0, method=hold)
            own = np.append(np.zeros(found.nk), found.B[:, p])
            np.testing.assert_allclose(own, B[0][: own.size], atol=1e-13)
            np.testing.assert_allclose(found.F, A, atol=1e-13)


@HOLDS
@pytest.mark.parametrize("delay", [0.25, 2.5, 3.75])
def test_a_delay_may_be_any_part_of_a_sample(hold: Hold, delay: float) -> None:
    """The output equals that of a system with four times as many samples and a whole delay."""
    u = np.append(0.0, np.random.default_rng(1).standard_normal(60))
    fine = np.repeat(u, 4) if hold == "zoh" else np.interp(np.arange(241) / 4, np.arange(61), u)
    coarse, finer = (
        sample_system(F, delay, hold),
        sample_system(F / 4.0 ** np.arange(1, 4), 4 * delay, hold),
    )

    for p in range(F.size):
        responses = [
            apply_filter(np.append(np.zeros(s.nk), s.B[:, p] * scale), s.F, x)
            for s, x, scale in ((coarse, u, 1.0), (finer, fine, 4.0 ** (p - 3)))
        ]
        np.testing.assert_allclose(responses[0], responses[1][: 4 * u.size : 4], atol=1e-11)


@HOLDS
def test_the_derivatives_are_those_of_the_polynomials(hold: Hold) -> None:
    found, h = sample_system(F, 1.3, hold), 1e-6

    for k in range(F.size):
        step = h * np.eye(F.size)[k]
        ahead, behind = sample_system(F + step, 1.3, hold), sample_system(F - step, 1.3, hold)
        np.testing.assert_allclose((ahead.F - behind.F) / (2 * h), found.F_by_f[:, k], atol=1e-8)
        np.testing.assert_allclose((ahead.B - behind.B) / (2 * h), found.B_by_f[..., k], atol=1e-8)
    ahead, behind = sample_system(F, 1.3 + h, hold), sample_system(F, 1.3 - h, hold)
    np.testing.assert_allclose((ahead.B - behind.B) / (2 * h), found.B_by_delay, atol=1e-8)


@HOLDS
def test_a_delay_changes_the_polynomials_without_a_step(hold: Hold) -> None:
    """At a whole number of samples the coefficients continue on the next lag."""
    before, after = (sample_system(F, d, hold, fraction=True) for d in (2 - 1e-7, 2.0))

    assert after.nk == before.nk + 1
    np.testing.assert_allclose(before.B[1:], after.B[:-1], atol=1e-6)
    np.testing.assert_allclose(before.B[0], 0, atol=1e-6)
