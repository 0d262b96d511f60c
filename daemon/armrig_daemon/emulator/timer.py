"""The timer of scheduled mode (PROTOCOL.md, section 6): when each sample is due, in device ns."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True, kw_only=True)
class Timer:
    """Ticks at t_0 + k Ts, each a product and no sum, so that nothing drifts."""

    first_ns: int
    """t_0: trigger of theta_1's conversion in sample 0."""
    period_ns: int
    """Ts."""
    lead_ns: int
    """The first conversion is triggered this long before theta_1's last."""
    hold_ns: int
    """u is latched this long after theta_1's trigger."""
    k_stop: int
    """Samples to take; 0 is no end."""
    k: int = 0
    """Index of the next sample to be triggered; does not wrap."""

    @property
    def ends(self) -> bool:
        """Whether no sample is left: what comes next is the end of the run."""
        return 0 < self.k_stop <= self.k

    @property
    def due_ns(self) -> int:
        """When the first conversion for sample k is due, or the end of the run."""
        tick_ns = self.first_ns + self.k * self.period_ns
        # The end takes the place of a latch, so that the last input is held for its whole Ts.
        return tick_ns + self.hold_ns if self.ends else tick_ns - self.lead_ns
