"""Numbers of decisions of a control law, in a run that may still be in progress."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple, Self

from armrig.numerics.quantities import plural


class DecisionCounts(NamedTuple):
    """Numbers of decisions of a run in control."""

    decisions: int = 0
    limited: int = 0
    """Number of decisions whose voltage was at a limit."""
    slewed: int = 0
    """Number of decisions whose change of the voltage was limited."""
    late: int = 0
    """Number of decisions without the newest sample."""
    missed: int = 0
    """Number of missed deadlines, if the client of the run sets each voltage."""

    def with_messages(self, messages: Iterable[Any]) -> Self:
        """Return the numbers with the messages of the stream `control` added."""
        counts = self
        for m in messages:
            counts = counts._replace(
                decisions=counts.decisions + 1,
                limited=counts.limited + (m.is_low or m.is_high),
                slewed=counts.slewed + m.is_slewed,
                late=counts.late + (m.predicted > 0),
                missed=m.predicted,
            )
        return counts

    @property
    def at_limit(self) -> str:
        """Return the share of decisions at a limit as text.

        Examples
        --------
        >>> DecisionCounts(decisions=64, limited=1).at_limit
        'at its limit in 1.56 %'
        """
        return f"at its limit in {_percent(self.limited, self.decisions)}"

    @property
    def of_law(self) -> str:
        """Return the shares of decisions at a limit, and with predicted samples, as text.

        Examples
        --------
        >>> DecisionCounts(decisions=200, limited=3, late=2).of_law
        'input at its limit in 1.5 % of samples, 2 decisions without the newest sample'
        """
        text = f"input {self.at_limit} of samples"
        if self.slewed:
            text += f", its change limited in {_percent(self.slewed, self.decisions)}"
        if self.late:
            text += f", {plural(self.late, 'decision')} without the newest sample"
        return text

    @property
    def of_client(self) -> str:
        """Return the share of missed deadlines as text.

        Examples
        --------
        >>> DecisionCounts(decisions=100, missed=3).of_client
        '3 of 99 deadlines missed'
        """
        return f"{self.missed} of {plural(max(0, self.decisions - 1), 'deadline')} missed"


def _percent(count: int, total: int) -> str:
    return f"{100 * count / max(total, 1):.3g} %"
