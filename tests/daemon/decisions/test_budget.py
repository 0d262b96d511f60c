"""Capacity of the wire, by the numbers of PROTOCOL.md."""

from __future__ import annotations

import pytest
from armrig_daemon.decisions.budget import check, min_exchange_us, min_scheduled_us


def test_the_budget_is_the_sum_of_request_conversions_and_answer() -> None:
    """52 bytes of 10 bits, and two conversions of 104 µs."""
    assert min_exchange_us(500_000) == 1040 + 208
    assert min_exchange_us(1_000_000) == 520 + 208


@pytest.mark.parametrize("scheduled", [False, True])
@pytest.mark.parametrize("baud", [115_200, 500_000, 1_000_000])
def test_a_sampling_time_1_us_too_short_is_refused(baud: int, scheduled: bool) -> None:
    least_us = (min_scheduled_us if scheduled else min_exchange_us)(baud)

    check(least_us, baud, scheduled=scheduled)
    with pytest.raises(ValueError, match=f"at least {least_us / 1e6:g} s"):
        check(least_us - 1, baud, scheduled=scheduled)


def test_the_converter_bounds_the_sampling_time_at_any_baud_rate() -> None:
    assert min_scheduled_us(100_000_000) == 208


@pytest.mark.parametrize("m", [2, 3, 16])
@pytest.mark.parametrize("scheduled", [False, True])
def test_the_budget_includes_each_conversion_of_an_oversampled_reading(
    m: int, scheduled: bool
) -> None:
    least_us = max(2 * m * 104, min_scheduled_us(500_000)) if scheduled else 2 * m * 104 + 1040

    check(least_us, 500_000, scheduled=scheduled, oversampling=m)
    with pytest.raises(ValueError, match=r"baud in") as refused:
        check(least_us - 1, 500_000, scheduled=scheduled, oversampling=m)
    assert str(refused.value) == (
        f"Ts={(least_us - 1) / 1e6:g} s cannot be carried at 500000 baud in "
        f"{'scheduled' if scheduled else 'exchange'} mode with [device] oversampling = {m}: "
        f"at least {least_us / 1e6:g} s, or a higher baud rate, or less oversampling"
    )


def test_a_refusal_without_oversampling_does_not_mention_it() -> None:
    with pytest.raises(ValueError, match=r"exchange mode: .* a higher baud rate$"):
        check(1000, 500_000)
