"""Breaks among live samples, told as values: by the daemon, or as what this listener missed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import nan
from threading import Lock
from typing import Any, Generic, TypeVar

from armrig_core.telemetry import Sample

MISSED = "the listener, or the way to it, did not keep up"
"""Reason of a gap that the daemon knows nothing of."""
MOST_TOLD, MOST_TOLD_BYTES = 10_000, 1 << 20
"""Gaps told that are kept until the sample behind them comes; a daemon's has 60 B."""
_T = TypeVar("_T")


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


class Newest(Generic[_T]):
    """Forgets the oldest where there is too much; one thread may add while another takes."""

    def __init__(self, most: int, most_bytes: int) -> None:
        """Keep at most so many, and of so many B together."""
        self._most, self._most_bytes = most, most_bytes
        self._kept: deque[tuple[_T, int]] = deque()
        self._size = 0
        self._lock = Lock()

    def __len__(self) -> int:
        """Return how many are kept."""
        return len(self._kept)

    def __iter__(self) -> Iterator[_T]:
        """Give those that are kept, the oldest first; none is to be added meanwhile."""
        return (value for value, _ in self._kept)

    def add(self, value: _T, size: int) -> None:
        """Add one of `size` B; one longer than all may be is forgotten at once."""
        with self._lock:
            self._kept.append((value, size))
            self._size += size
            while len(self._kept) > self._most or self._size > self._most_bytes:
                self._forget_oldest()

    def take(self) -> list[_T]:
        """Return all, the oldest first, and forget them."""
        with self._lock:
            kept, self._kept, self._size = self._kept, deque(), 0
        return [value for value, _ in kept]

    def forget_while(self, is_over: Callable[[_T], bool]) -> None:
        """Forget the oldest up to one that is not over."""
        with self._lock:
            while self._kept and is_over(self._kept[0][0]):
                self._forget_oldest()

    def _forget_oldest(self) -> None:
        _, size = self._kept.popleft()
        self._size -= size
