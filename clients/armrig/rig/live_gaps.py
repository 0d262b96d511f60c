"""Breaks among live samples, told as values: by the daemon, or as what this listener missed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import nan
from typing import Any

from armrig_core.telemetry import Sample

from armrig.rig.newest import Newest

MISSED = "the listener, or the way to it, did not keep up"
"""Reason of a gap that the daemon knows nothing of."""
MOST_TOLD, MOST_TOLD_BYTES = 10_000, 1 << 20
"""Gaps told that are kept until the sample behind them comes; a daemon's has 60 B."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveGap:
    """Samples that a listener does not get; it stands where they would have stood."""

    k_first: int
    """Index of the first of them, counted as `Sample.k`."""
    count: int
    """How many in a row."""
    t_from_ns: int
    """From when, on the host's monotonic clock."""
    t_to_ns: int
    """Until when."""
    u_held_v: float
    """Voltage that the motor kept meanwhile, in V; NaN where the listener cannot know."""
    reason: str
    """Why they are missing."""
    published: bool
    """Whether they were published, and only this listener missed them: a recording has them."""


def told_gaps() -> Newest[Any]:
    """Return what keeps the gaps that a daemon tells, `armrig.v1.Gap`; the oldest are forgotten."""
    return Newest(MOST_TOLD, MOST_TOLD_BYTES)


def gaps_between(before: Sample, after: Sample, told: Iterable[Any]) -> Iterator[LiveGap]:
    """Give what is missing between two samples that came one after the other, in order.

    Parameters
    ----------
    before, after : Sample
        Where `after` is not later than `before` the daemon counts anew, and nothing is missing.
    told : iterable of armrig.v1.Gap
        What the daemon has told, in any order.
    """
    k, end = before.k + 1, after.k
    for gap in sorted(told, key=lambda gap: int(gap.k_first)):
        first, behind = max(gap.k_first, k), min(gap.k_first + gap.count, end)
        if first >= behind:
            continue
        if first > k:
            yield _missed(before, after, k, first)
        yield LiveGap(
            k_first=first,
            count=behind - first,
            t_from_ns=gap.t_from_ns,
            t_to_ns=gap.t_to_ns,
            u_held_v=gap.u_held_v,
            reason=gap.reason,
            published=False,
        )
        k = behind
    if k < end:
        yield _missed(before, after, k, end)


def _missed(before: Sample, after: Sample, first: int, end: int) -> LiveGap:
    return LiveGap(
        k_first=first,
        count=end - first,
        t_from_ns=before.t_host_ns,
        t_to_ns=after.t_host_ns,
        u_held_v=nan,
        reason=MISSED,
        published=True,
    )
