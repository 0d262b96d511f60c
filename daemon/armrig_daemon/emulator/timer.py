"""The timer of scheduled mode (PROTOCOL.md, section 6); all times are in ns of device time."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True, kw_only=True)
class Timer:
    """Ticks at t_0 + k Ts; each tick is computed from k, so that no errors accumulate."""

    first_ns: int
    """Time t_0 at which the conversion of theta_1 in sample 0 is triggered."""
    period_ns: int
    """Sampling time Ts."""
    lead_ns: int
    """Time from a sample's first trigger to the trigger of its last conversion of theta_1."""
    hold_ns: int
    """Time from theta_1's trigger to the latch of u."""
    k_stop: int
    """Number of samples to take; 0 for a run without an end."""
    k: int = 0
    """Index of the next sample; it does not wrap."""

    @property
    def ends(self) -> bool:
        """True if all samples were taken, so that the end of the run is due next."""
        return 0 < self.k_stop <= self.k

    @property
    def due_ns(self) -> int:
        """Time of the first conversion of sample k, or of the end of the run."""
        tick_ns = self.first_ns + self.k * self.period_ns
        # The run ends at the time of the next latch, so that the last input is held for a whole Ts.
        return tick_ns + self.hold_ns if self.ends else tick_ns - self.lead_ns
