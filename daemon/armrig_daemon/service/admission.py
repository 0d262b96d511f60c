"""Admission of commands: an owner's command without the valid lease is refused without parsing.

The check is cheap and runs in zenoh's thread, so that a stranger cannot delay the holder's
commands. The service and the core check admitted commands again; the core alone decides.

A token bucket for each kind of query, filled at a steady rate, limits the rate of queries. A stop,
a sign of life and a command with the lease in force are never counted, so that a flood of other
queries cannot delay them.
"""

from __future__ import annotations

from typing import NamedTuple

from armrig_core.access.access_control import MOST_BYTES, MOST_CALIBRATION_BYTES
from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import (
    REQUESTS,
    CalibrateRequest,
    LeasedRequest,
    Refused,
    RunOptions,
    build_refusal,
)

from armrig_daemon.decisions.orders import NOT_HELD

LEASED = frozenset(name for name, kind in REQUESTS.items() if issubclass(kind, LeasedRequest))
"""Names of the commands that contain a lease."""
RUNS = frozenset(name for name, kind in REQUESTS.items() if issubclass(kind, RunOptions))
"""Names of the commands that begin a run."""
PER_S = 200
"""Largest number of queries of one kind that are answered each second, for all clients together."""
BURST = 100
"""Largest number of queries of one kind that may arrive at once after a time without queries."""


def refusal(name: str, payload: bytes, lease: bytes) -> Refused | None:
    """Return the refusal of a command, or None if it is admitted.

    A command with an unknown name is admitted here, and refused by the service. `lease` is the
    lease in force, as far as the service knows; empty if no lease is in force. A lease consists of
    hexadecimal digits, which JSON encoders do not escape. A payload without the lease in force is
    therefore not from the holder.
    """
    if name in LEASED and not (lease and lease in payload):
        return build_refusal(RefusalCode.NOT_HELD, NOT_HELD)
    most = MOST_CALIBRATION_BYTES if name == CalibrateRequest.name else MOST_BYTES
    if name not in RUNS and len(payload) > most:
        text = f"{name}: {len(payload)} B, at most {most} B are allowed"
        return build_refusal(RefusalCode.TOO_LONG, text, bytes=len(payload), most_bytes=most)
    return None


class Bucket(NamedTuple):
    """Number of queries that are allowed at the time `at_s`."""

    tokens: float = BURST
    at_s: float = 0.0
    """Time at which `tokens` was computed, on the monotonic clock."""


def take(bucket: Bucket, now_s: float, per_s: float, burst: float) -> Bucket | None:
    """Return the bucket after another query; None if the query exceeds the limits."""
    tokens = min(burst, bucket.tokens + per_s * (now_s - bucket.at_s))
    return Bucket(tokens - 1, now_s) if tokens >= 1 else None


def too_many(name: str) -> Refused:
    """Return the refusal of a query beyond the limit."""
    text = f"{name}: too many queries, at most {PER_S} a second are answered: try again"
    return build_refusal(RefusalCode.TOO_MANY, text, per_s=PER_S)
