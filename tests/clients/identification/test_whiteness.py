"""The level of the test of whiteness."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.whiteness import portmanteau_p_value
from scipy.special import chdtrc


@pytest.mark.parametrize(("N", "lags"), [(250, 10), (250, 25), (500, 25)])
def test_white_noise_is_rejected_as_often_as_the_level_says(N: int, lags: int) -> None:
    """Ljung and Box's statistic of 20 000 series; chi-squared rejects 6 % where 5 % is meant."""
    e = np.random.default_rng(1).standard_normal((20_000, N))
    spectrum = np.abs(np.fft.rfft(e, 2 * N, axis=1)) ** 2
    R = np.fft.irfft(spectrum, axis=1)[:, : lags + 1]
    Q = N * (N + 2) * np.sum((R[:, 1:] / R[:, :1]) ** 2 / (N - np.arange(1, lags + 1)), axis=1)

    p = np.array([portmanteau_p_value(float(q), lags, N) for q in Q])

    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=0.005)
    assert np.mean(p < 0.01) == pytest.approx(0.01, abs=0.004)
    if lags == 25:
        assert np.mean(chdtrc(lags, Q) < 0.05) > 0.055


def test_many_samples_make_it_chi_squared() -> None:
    """And few lags, which share little."""
    assert portmanteau_p_value(37.65, 25, 10**7) == pytest.approx(chdtrc(25, 37.65), rel=1e-4)
    assert portmanteau_p_value(3.0, 2, 100) == pytest.approx(chdtrc(2, 3.0))
    assert np.isnan(portmanteau_p_value(0.0, 0, 100))
