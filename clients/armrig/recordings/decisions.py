"""Numbers of decisions of a control law, in a run that may still be in progress."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from armrig.numerics.quantities import digits, plural


class DecisionCounts(NamedTuple):
    """Numbers of decisions: all, at a limit, with a limited change, without the newest sample."""

    decisions: int = 0
    limited: int = 0
    slewed: int = 0
    late: int = 0

    def with_messages(self, messages: Iterable[Any]) -> DecisionCounts:
        """Return the numbers with the messages of the stream `control` added."""
        bits = [(1, m.is_low or m.is_high, m.is_slewed, m.predicted > 0) for m in messages]
        return DecisionCounts(*map(sum, zip(self, *bits, strict=True)))

    @property
    def at_limit(self) -> str:
        """Share of decisions at a limit as text."""
        return f"at its limit in {self._percent(self.limited)}"

    @property
    def limits_text(self) -> str:
        """Shares of decisions at a limit, and with predicted samples, as text."""
        text = f"input {self.at_limit} of samples"
        if self.slewed:
            text += f", its change limited in {self._percent(self.slewed)}"
        late = plural(self.late, "decision")
        return f"{text}, {late} without the newest sample" if self.late else text

    def _percent(self, count: int) -> str:
        return f"{digits(100 * count / max(self.decisions, 1), 3)} %"
