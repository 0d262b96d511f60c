"""Gaps between live samples, reported by the daemon or detected by the listener."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import nan
from threading import Lock
from typing import Any, Generic, TypeVar

from armrig_core.codes import GapCode
from armrig_core.telemetry import Sample

MOST_TOLD, MOST_TOLD_BYTES = 10_000, 1 << 20
"""Largest number and largest total size, in B, of stored gaps.

A gap is stored until a later sample arrives.
"""
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveGap:
    """Gap in a live stream: consecutive samples that the listener did not receive.

    Examples
    --------
    A listener that receives the samples 502 and 505 missed the two samples between them.

    >>> import armrig
    >>> from armrig.rig.live_gaps import gaps_between
    >>> from armrig_core.telemetry import Sample
    >>> rows = armrig.example_recording().samples[[0, 3]]
    >>> (gap,) = gaps_between(*(Sample._make(row.tolist()) for row in rows), [])
    >>> gap.k_first, gap.count, gap.reason
    (503, 2, 'the listener, or the way to it, did not keep up')
    """

    k_first: int
    """Index of the first missing sample, as in `Sample.k`."""
    count: int
    """Number of missing samples."""
    t_from_ns: int
    """Beginning of the gap, in ns of the host's monotonic clock."""
    t_to_ns: int
    """End of the gap, in ns of the host's monotonic clock."""
    u_held_v: float
    """Voltage that the motor kept during the gap, in V; NaN if the listener cannot know it."""
    reason: str
    """Reason for the gap."""
    published: bool
    """True if the daemon published the samples, but this listener missed them."""
    code: str
    """Code of the reason: an `armrig_core.codes.GapCode`."""


def told_gaps() -> Newest[Any]:
    """Return a bounded store for the gaps that a daemon reports (`armrig.v1.Gap`)."""
    return Newest(MOST_TOLD, MOST_TOLD_BYTES)


def gaps_between(before: Sample, after: Sample, told: Iterable[Any]) -> Iterator[LiveGap]:
    """Yield the gaps between two consecutively received samples, in order.

    Parameters
    ----------
    before, after : Sample
        Two consecutively received samples. If `k` does not increase, the daemon was restarted, and
        no sample is missing.
    told : iterable of armrig.v1.Gap
        Gaps that the daemon reported, in any order.
    """
    k, end = before.k + 1, after.k
    for gap in sorted(told, key=lambda gap: int(gap.k_first)):
        first, after_last = max(gap.k_first, k), min(gap.k_first + gap.count, end)
        if first >= after_last:
            continue
        if first > k:
            yield _missed(before, after, k, first)
        yield LiveGap(
            k_first=first,
            count=after_last - first,
            t_from_ns=gap.t_from_ns,
            t_to_ns=gap.t_to_ns,
            u_held_v=gap.u_held_v,
            reason=gap.reason,
            published=False,
            code=gap.code or GapCode.UNKNOWN,
        )
        k = after_last
    if k < end:
        yield _missed(before, after, k, end)


def _missed(before: Sample, after: Sample, first: int, end: int) -> LiveGap:
    return LiveGap(
        k_first=first,
        count=end - first,
        t_from_ns=before.t_host_ns,
        t_to_ns=after.t_host_ns,
        u_held_v=nan,
        reason=GapCode.LISTENER_LATE.sentence,
        published=True,
        code=GapCode.LISTENER_LATE,
    )


class Newest(Generic[_T]):
    """Bounded store that drops the oldest values.

    One thread may add values while another thread takes values.
    """

    def __init__(self, most: int, most_bytes: int) -> None:
        """Create a store of at most `most` values with a total size of at most `most_bytes`."""
        self._most, self._most_bytes = most, most_bytes
        self._kept: deque[tuple[_T, int]] = deque()
        self._size = 0
        self._lock = Lock()

    def __len__(self) -> int:
        """Return the number of kept values."""
        return len(self._kept)

    def __iter__(self) -> Iterator[_T]:
        """Iterate over the kept values, oldest first; do not add a value during the iteration."""
        return (value for value, _ in self._kept)

    def add(self, value: _T, size: int) -> None:
        """Add a value of `size` B; if a limit is exceeded, drop the oldest values."""
        with self._lock:
            self._kept.append((value, size))
            self._size += size
            while len(self._kept) > self._most or self._size > self._most_bytes:
                self._forget_oldest()

    def take(self) -> list[_T]:
        """Remove all values, and return them in order, the oldest first."""
        with self._lock:
            kept, self._kept, self._size = self._kept, deque(), 0
        return [value for value, _ in kept]

    def forget_while(self, is_over: Callable[[_T], bool]) -> None:
        """Remove the oldest values; stop before the first value for which `is_over` is False."""
        with self._lock:
            while self._kept and is_over(self._kept[0][0]):
                self._forget_oldest()

    def _forget_oldest(self) -> None:
        _, size = self._kept.popleft()
        self._size -= size
