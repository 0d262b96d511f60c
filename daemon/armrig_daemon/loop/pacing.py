"""Deadlines of the ticks, as absolute times, so that delays do not add up."""

from __future__ import annotations

from typing import NamedTuple


class Pace(NamedTuple):
    """Tick `k` is due at `origin_ns + (k - k_origin) · period_ns`."""

    period_ns: int
    origin_ns: int
    k_origin: int

    def due_ns(self, k: int) -> int:
        """Return the time at which tick `k` is due."""
        return self.origin_ns + (k - self.k_origin) * self.period_ns

    def current(self, k: int, now_ns: int) -> int:
        """Return the tick to perform now: the newest due tick, or `k` if no tick is due.

        Missed ticks are skipped. Catching up in a burst would sample at the wrong times.
        """
        late = now_ns - self.due_ns(k)
        return k + max(0, late // self.period_ns)


def change(pace: Pace, k: int, period_ns: int, now_ns: int) -> Pace:
    """Return a pace whose next tick is `k`; with an unchanged period the phase stays the same.

    With another period, tick `k` is one period from now.
    """
    if period_ns == pace.period_ns:
        return Pace(period_ns, now_ns + (pace.origin_ns - now_ns) % period_ns, k)
    return Pace(period_ns, now_ns + period_ns, k)
