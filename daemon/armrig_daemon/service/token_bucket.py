"""How often anybody may ask: a bucket of tokens for each kind of question, filled at a steady rate.

Judged on zenoh's thread before anything else is done with a question. A stop, a sign of life and
what carries the lease in force are never counted: a flood of others must not hold them up.
"""

from __future__ import annotations

from typing import NamedTuple

from armrig_core.codes import RefusalCode
from armrig_core.commands import Refused, refused

PER_S = 200
"""Questions of a kind that are answered each second, by whomever they are asked."""
BURST = 100
"""As many may come at once after a time of rest."""


class Bucket(NamedTuple):
    """What may still be asked at a time."""

    tokens: float = BURST
    at_s: float = 0.0
    """When there were so many, on the monotonic clock."""


def take(bucket: Bucket, now_s: float) -> Bucket | None:
    """Return the bucket after one more question, None where it is one too many."""
    return take_at(PER_S, BURST, bucket, now_s)


def take_at(per_s: float, burst: float, bucket: Bucket, now_s: float) -> Bucket | None:
    """Return the bucket after one more question at a rate and a burst; None if it is too many."""
    tokens = min(burst, bucket.tokens + per_s * (now_s - bucket.at_s))
    return Bucket(tokens - 1, now_s) if tokens >= 1 else None


def refusal(name: str) -> Refused:
    """Return what one too many is told."""
    text = f"{name}: too many queries, at most {PER_S} a second are answered: try again"
    return refused(RefusalCode.TOO_MANY, text, per_s=PER_S)
