"""Limit of the rate of queries: a token bucket for each kind, filled at a steady rate.

zenoh's thread applies the limit before anything else. A stop, a sign of life and a command with the
lease in force are never counted, so that a flood of other queries cannot delay them.
"""

from __future__ import annotations

from typing import NamedTuple

from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import Refused, refused

PER_S = 200
"""Largest number of queries of one kind that are answered each second, for all clients together."""
BURST = 100
"""Largest number of queries of one kind that may arrive at once after a time without queries."""


class Bucket(NamedTuple):
    """Number of queries that are allowed at the time `at_s`."""

    tokens: float = BURST
    at_s: float = 0.0
    """Time at which `tokens` was computed, on the monotonic clock."""


def take(bucket: Bucket, now_s: float) -> Bucket | None:
    """Return the bucket after another query; None if the query exceeds the limit."""
    return take_at(PER_S, BURST, bucket, now_s)


def take_at(per_s: float, burst: float, bucket: Bucket, now_s: float) -> Bucket | None:
    """Return the bucket after another query; None beyond the limits `per_s` and `burst`."""
    tokens = min(burst, bucket.tokens + per_s * (now_s - bucket.at_s))
    return Bucket(tokens - 1, now_s) if tokens >= 1 else None


def refusal(name: str) -> Refused:
    """Return the refusal of a query beyond the limit."""
    text = f"{name}: too many queries, at most {PER_S} a second are answered: try again"
    return refused(RefusalCode.TOO_MANY, text, per_s=PER_S)
