"""Rates of requests, on a clock that is moved by hand."""

from __future__ import annotations

from armrig_core.codes import RefusalCode
from armrig_daemon.service.token_bucket import BURST, PER_S, Bucket, refusal, take
from hypothesis import given
from hypothesis import strategies as st

NOW_S = 1e6


def _asked(bucket: Bucket, now_s: float, times: int) -> tuple[Bucket, int]:
    """Return the bucket after so many questions at once, and the number of admitted ones."""
    let_in = 0
    for _ in range(times):
        left = take(bucket, now_s)
        if left is not None:
            bucket, let_in = left, let_in + 1
    return bucket, let_in


def test_a_burst_after_a_rest_is_let_in_and_no_more() -> None:
    assert _asked(Bucket(), NOW_S, 10 * BURST)[1] == BURST


def test_a_flood_is_let_in_at_the_steady_rate() -> None:
    bucket, _ = _asked(Bucket(), NOW_S, 10 * BURST)
    in_all = 0
    for ms in range(1, 10_001):
        bucket, let_in = _asked(bucket, NOW_S + ms / 1000, 3)
        in_all += let_in

    assert abs(in_all - 10 * PER_S) <= 1


def test_requests_below_the_rate_are_never_refused() -> None:
    bucket: Bucket | None = Bucket()
    for k in range(10_000):
        assert bucket is not None
        bucket = take(bucket, NOW_S + k / (0.99 * PER_S))
    assert bucket is not None


@given(st.lists(st.floats(0, 0.1), min_size=1, max_size=500))
def test_no_stretch_of_time_lets_in_more_than_a_burst_and_its_share(waits: list[float]) -> None:
    bucket, now_s, in_all = Bucket(), NOW_S, 0
    for wait_s in waits:
        now_s += wait_s
        bucket, let_in = _asked(bucket, now_s, 1)
        in_all += let_in

    assert in_all <= BURST + PER_S * (now_s - NOW_S) + 1


def test_a_refusal_names_the_bound_and_that_it_passes() -> None:
    told = refusal("status")

    assert told.error == "status: too many queries, at most 200 a second are answered: try again"
    assert (told.code, told.passes) == (RefusalCode.TOO_MANY, True)
    assert told.parameters == {"per_s": 200}
