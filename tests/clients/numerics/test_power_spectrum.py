"""The averaged spectrum against its segments written out."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.numerics.power_spectrum import power_spectrum
from numpy.typing import NDArray


def by_segments(
    stretches: list[NDArray[np.float64]], L: int, Ts: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return omega and the mean of the periodograms of all Hann-windowed segments."""
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(L) / L)
    found = []
    for x in stretches:
        for begin in range(0, x.size - L + 1, L - L // 2):
            part = x[begin : begin + L]
            X = np.fft.rfft(window * (part - part.mean()))
            power = np.abs(X) ** 2 * Ts / (window @ window) / (2 * np.pi)
            power[1 : (L + 1) // 2] *= 2  # both signs of the frequency
            found.append(power)
    return 2 * np.pi * np.fft.rfftfreq(L, Ts), np.mean(found, axis=0)


@pytest.mark.parametrize(
    ("sizes", "L"), [((700, 90, 290), 135), ((130,), 16), ((37, 20), 16), ((20, 17), 16)]
)
def test_all_segments_have_equal_weight_in_the_average(sizes: tuple[int, ...], L: int) -> None:
    """A stretch that is shorter than a segment does not count."""
    rng, Ts = np.random.default_rng(1), 0.02
    parts = [10 + (k + 1) * rng.standard_normal(n) for k, n in enumerate(sizes)]
    holed = np.concatenate([np.append(part, np.nan) for part in parts])

    expected = by_segments([part for part in parts if part.size >= L], L, Ts)

    for signals in (parts, [holed], [holed[: sizes[0]], holed[sizes[0] :]]):
        for ours, theirs in zip(power_spectrum(signals, Ts), expected, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


def test_a_segment_is_an_eighth_of_the_samples_but_not_longer_than_the_longest_stretch() -> None:
    x = np.random.default_rng(2).standard_normal(40_000)

    sizes = [power_spectrum([part], 1.0)[0].size for part in (x[:800], x)]
    alone = power_spectrum([np.where(np.arange(800) % 21 > 0, x[:800], np.nan)], 1.0)[0].size

    assert sizes == [51, 2049]  # of 100 and of 4096 samples
    assert alone == 11  # of 20 samples, not of 95
