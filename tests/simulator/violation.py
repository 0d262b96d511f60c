"""Violation of an invariant, which ends a schedule."""

from __future__ import annotations

S1, S2, S3, S4, S5, S6 = "S1", "S2", "S3", "S4", "S5", "S6"


class Violation(Exception):  # noqa: N818 - its name everywhere
    """An invariant did not hold."""

    def __init__(self, invariant: str, t_ns: int, text: str) -> None:
        """Name the invariant, the time and the reason."""
        super().__init__(f"{invariant} at {t_ns / 1e6:.3f} ms: {text}")
        self.invariant, self.t_ns, self.text = invariant, t_ns, text
