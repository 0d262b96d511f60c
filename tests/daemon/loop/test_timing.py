"""Percentiles within 1/32 of the truth, and stalls that count for every tick they cost."""

from __future__ import annotations

import numpy as np
import pytest
from armrig_daemon.loop.meter import Histogram
from hypothesis import given
from hypothesis import strategies as st


@given(st.lists(st.integers(0, 10**10), min_size=1, max_size=300), st.floats(0.01, 1.0))
def test_a_quantile_is_exact_to_one_thirty_second(values: list[int], q: float) -> None:
    """It is never below the true quantile, and at most 1/32 above it."""
    histogram = Histogram()
    for value in values:
        histogram.add(value)

    true = int(np.quantile(values, q, method="inverted_cdf"))

    assert true <= histogram.quantiles(q)[0] <= true + true / 32 + 1


def test_a_stall_counts_once_for_every_missed_tick() -> None:
    """40 ms at 1 kHz are 40 late ticks: 40 of 1000 show at p99."""
    histogram = Histogram()
    for _ in range(960):
        histogram.add(10_000)
    histogram.add(40_000_000, missed=39, period_ns=1_000_000)

    timing = histogram.distribution(1e3)

    assert (timing.n, timing.missed) == (1000, 39)
    assert timing.p50 == pytest.approx(10, rel=0.04)
    assert timing.p99 == pytest.approx(31_000, rel=0.05)
    assert timing.max == 40_000


def test_an_empty_histogram_has_a_distribution_of_zeros() -> None:
    timing = Histogram().distribution(1e3)

    assert (timing.n, timing.p50, timing.max) == (0, 0.0, 0.0)


def test_histogram_counts_a_long_suspend_in_bounded_time() -> None:
    """A suspend of ten hours at 1 kHz missed 36 million ticks."""
    histogram = Histogram()

    histogram.add(36_000_000_000_000, missed=36_000_000, period_ns=1_000_000)

    assert histogram.missed == 36_000_000
