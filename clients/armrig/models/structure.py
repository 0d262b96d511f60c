"""Which polynomials a model has, and what of its past is not known when the data begin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.polynomial import Array, impulse, lagged

Matrix = NDArray[np.float64]


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


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeResponse:
    """The nuisance parameters of one experiment, estimated with the model."""

    transients: tuple[float, ...]
    """Pulses at the first samples that replace the unknown past, filtered by 1/F, in y's unit."""
    level: float = 0.0
    """Constant under an integrating output, in y's unit."""
    offset: float = 0.0
    """Input that an integrating output answers with standstill (u0), in u's unit."""


def transient_count(
    *, numerator_degree: int, denominator_degree: int, integrator: bool = False
) -> int:
    """Return how many pulses an unknown past needs: the state's dimension.

    With an integrator one dimension is the level, which has a column of its own.
    """
    return max(max(numerator_degree, denominator_degree) - int(integrator), 0)


def free_columns(F: Array, N: int, *, count: int, drift: bool) -> Array:
    """Return (N, count + 2 drift): pulses at 0 … count-1 through 1/F, then level and ramp.

    F is the denominator without the integrator; the ramp is t + 1, the sum of a unit input.
    """
    pulses = lagged(impulse(F, N), range(count))
    if not drift:
        return pulses
    return np.column_stack([pulses, np.ones(N), np.arange(1.0, N + 1.0)])


def offset_from_ramp(B: Array, F: Array, slope: float, mean_input: float) -> float:
    """Return u0 from the ramp's slope, where the model was driven by cumsum(u - mean_input)."""
    gain = float(np.sum(B) / np.sum(F))
    return mean_input - slope / gain if gain != 0 else float("nan")
