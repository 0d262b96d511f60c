"""Which polynomials a model has, and what of its past is not known when the data begin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class Structure:
    """Orders of A y = (B/F) u + (C/D) e, an integrator's factor 1 - q^-1 not counted."""

    nb: int
    """Numerator coefficients."""
    nk: int
    """Samples before u reaches y."""
    na: int = 0
    """Coefficients of A after the 1."""
    nc: int = 0
    """Coefficients of C after the 1."""
    nd: int = 0
    """Coefficients of D after the 1."""
    nf: int = 0
    """Coefficients of F after the 1."""
    integrator: Literal["", "a", "f"] = ""
    """Polynomial that has the factor 1 - q^-1 besides."""
    offset: bool = False
    """The input's offset is free; with an integrator it always is, unless at rest."""
    at_rest: bool = False
    """Each experiment begins with everything at zero."""

    @property
    def reach(self) -> int:
        """How many samples B looks back on u."""
        return self.nk + self.nb - 1

    @property
    def memory(self) -> int:
        """How many samples A, C and D look back: what a gap in y makes unknown."""
        return max(self.nd + self.na, self.nc)

    @property
    def first(self) -> int:
        """How many samples at the start look back on an unknown u, where no state stands for it."""
        return 0 if self.at_rest or self.count else self.nd + self.reach

    @property
    def count(self) -> int:
        """How many pulses stand for the unknown state of B/F at the start of an experiment.

        Without F the unknown past of u ends with the memory of B, and of an output-error model
        without F it is still the state.
        """
        inside = int(self.integrator == "f")
        if self.at_rest or (self.nf + inside == 0 and self.memory > 0):
            return 0
        return max(self.reach, self.nf + inside) - inside

    @property
    def trend(self) -> int:
        """Columns of the trend: 0 none, 1 level, 2 level and ramp."""
        if self.at_rest:
            return 0
        if self.integrator:
            return {"f": 2, "a": 1}[self.integrator]
        return int(self.offset)

    @property
    def white(self) -> bool:
        """The noise is white on the output: what is left of past y says nothing of the next."""
        return self.memory == 0
