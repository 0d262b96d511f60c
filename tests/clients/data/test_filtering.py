"""Filters treat u and y alike, and account for gaps."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.experiments import Trend
from armrig.data.treatment import prefilter, resample, retrend
from armrig.estimation.polynomial_structures import oe
from armrig.excitation import telegraph
from armrig.numerics.polynomial import apply_filter
from hypothesis import given, settings
from hypothesis import strategies as st

B, F = [0.0, 0.4, 0.2], [1.0, -1.2, 0.6]


def noise_free(N: int, seed: int = 1) -> Dataset:
    """Return B/F u."""
    u = telegraph(N, 0.2, seed=seed)
    return Dataset(u=u, y=apply_filter(B, F, u), Ts=0.01, unit="rad")


@pytest.mark.parametrize(
    "kind",
    [
        {"band": (0.0, 100.0)},
        {"band": (20.0, np.inf), "order": 2},
        {"band": (20.0, 200.0), "order": 2},
    ],
)
def test_the_model_of_filtered_data_is_the_same(kind: dict[str, object]) -> None:
    """L y = G L u, so noise-free data return the true parameters."""
    treated = prefilter(noise_free(2000), **kind)  # type: ignore[arg-type]

    fit = oe(treated, nb=2, nf=2)

    np.testing.assert_allclose(fit.theta, [0.4, 0.2, -1.2, 0.6], atol=1e-4)


def test_a_low_pass_attenuates_only_above_its_band() -> None:
    """A sine in the band passes with gain 1; a fourth order leaves 1/16 one octave above it."""
    t = 0.01 * np.arange(4000)
    data = Dataset(u=np.sin(2.0 * t), y=np.sin(40.0 * t), Ts=0.01)

    treated = prefilter(data, band=(0, 20.0))

    rms = np.sqrt(np.mean(treated.y[treated.valid] ** 2))
    assert np.sqrt(np.mean(treated.u[1000:] ** 2)) == pytest.approx(np.sqrt(0.5), rel=0.02)
    assert rms == pytest.approx(np.sqrt(0.5) / 16.7, rel=0.05)


@settings(max_examples=25)
@given(st.integers(0, 399), st.integers(1, 20), st.floats(-1e3, 1e3))
def test_a_missing_sample_never_reaches_a_valid_one(at: int, length: int, level: float) -> None:
    """The content of a gap has decayed to 1e-4."""
    data = noise_free(400)
    data = data.replaced(y=data.y + level, step=None)
    valid = np.ones(400, dtype=np.bool_)
    valid[at : at + length] = False
    holed = data.replaced(valid=valid, step=None)

    whole = prefilter(data, band=(0, 150.0), order=2)
    treated = prefilter(holed, band=(0, 150.0), order=2)

    both = treated.valid & whole.valid
    assert not treated.valid[at : at + length].any()
    np.testing.assert_allclose(treated.y[both], whole.y[both], atol=1e-4 * np.ptp(data.y))


def test_resampling_keeps_straight_lines_and_their_trend() -> None:
    """The filter is symmetric with gain 1."""
    n = np.arange(500)
    taken = Trend(y_level=1.0, y_slope=20.0)
    data = Dataset(u=n % 7, y=2 + 0.3 * n, Ts=0.01, trends=[taken])

    slow = resample(data, 0.05)

    assert slow.Ts == 0.05
    assert slow.N == 84
    np.testing.assert_allclose(retrend(slow).y, 3 + 0.5 * (40 + 5 * np.arange(84)))
    assert slow.history[-1].endswith("81 coefficients; 0 of 84 samples are missing")
    assert "resampled from 0.01 s to 0.05 s after a low-pass filter of 81" in slow.history[-1]


def test_resampling_suppresses_aliases() -> None:
    """Below 60 % of it a sine passes within 1 %; above it at most 1/400 remains."""
    n, factor = np.arange(6000), 5
    nyquist = np.pi / factor

    for share, low, high in (
        (0.3, 0.99, 1.01),
        (0.6, 0.99, 1.01),
        (1.02, 0, 1 / 400),
        (2.5, 0, 1 / 400),
    ):
        x = np.sqrt(2) * np.cos(share * nyquist * n + 0.3)
        slow = resample(Dataset(u=x, y=x, Ts=1.0), 5.0)
        assert low <= np.sqrt(np.mean(slow.y**2)) <= high, share
        np.testing.assert_allclose(slow.u, slow.y, atol=1e-12)


@settings(max_examples=25)
@given(st.lists(st.integers(0, 599), max_size=3), st.integers(2, 6))
def test_a_gap_remains_at_the_slower_rate(holes: list[int], factor: int) -> None:
    valid = np.ones(600, dtype=np.bool_)
    valid[holes] = False
    data = Dataset(u=np.arange(600), y=np.arange(600), Ts=1.0, valid=valid, starts=(0, 350))
    half = 8 * factor

    slow = resample(data, float(factor))

    for part, old in zip(slow.experiments(), data.experiments(), strict=True):
        centres = np.arange(half, old.N - half, factor)
        whole = [old.valid[c - half : c + half + 1].all() for c in centres]
        np.testing.assert_array_equal(part.valid, whole)
        np.testing.assert_allclose(part.u, old.u[centres], atol=1e-9)
        np.testing.assert_allclose(part.y[part.valid], old.u[centres][part.valid], atol=1e-9)


def test_an_experiment_as_long_as_the_filter_is_resampled() -> None:
    """One sample less is refused."""
    data = noise_free(33)

    assert resample(data, 0.02).N == 1
    with pytest.raises(ValueError, match=r"has 32 samples; resampling to 0.02 s needs 33"):
        resample(noise_free(32), 0.02)


def test_data_whose_gaps_would_remove_every_sample_are_refused() -> None:
    data = noise_free(300).replaced(valid=np.arange(300) % 30 > 0, step=None)

    with pytest.raises(ValueError, match="no stretch of y without a gap has the 33 samples"):
        resample(data, 0.02)
    with pytest.raises(ValueError, match="no stretch of y without a gap is as long"):
        prefilter(data, band=(0, 20.0))


def test_resampling_at_the_same_rate_does_not_change_the_data() -> None:
    data = noise_free(300)

    same = resample(data, 0.01)

    assert np.shares_memory(same.u, data.u)
    assert np.shares_memory(same.y, data.y)
    assert (repr(same), same.digest) == (repr(data), data.digest)
