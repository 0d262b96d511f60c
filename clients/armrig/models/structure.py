"""Orders of a model's polynomials, and number of unknowns for the signals before the data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.polynomial import Array, impulse, lagged

Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Structure:
    """Orders of A y = (B/F) u + (C/D) e, without the factor 1 - q^-1 of an integrator."""

    nb: int
    """Number of coefficients of B."""
    nk: int
    """Number of samples before u affects y."""
    na: int = 0
    """Number of coefficients of A after the leading 1."""
    nc: int = 0
    """Number of coefficients of C after the leading 1."""
    nd: int = 0
    """Number of coefficients of D after the leading 1."""
    nf: int = 0
    """Number of coefficients of F after the leading 1."""
    integrator: Literal["", "a", "f"] = ""
    """Polynomial with the additional factor 1 - q^-1."""
    offset: bool = False
    """True if the input offset is estimated. With an integrator the offset is always estimated,
    unless `at_rest` is True."""
    at_rest: bool = False
    """True if each experiment begins with all signals at zero."""

    @property
    def reach(self) -> int:
        """Largest lag of u in B."""
        return self.nk + self.nb - 1

    @property
    def memory(self) -> int:
        """Largest lag of y or e: after a gap in y, this number of past samples is unknown."""
        return max(self.nd + self.na, self.nc)

    @property
    def first(self) -> int:
        """Number of first samples that depend on u before the data; 0 with pulses, or at rest."""
        return 0 if self.at_rest or self.count else self.nd + self.reach

    @property
    def count(self) -> int:
        """Number of pulses that replace the unknown state of B/F at the start of an experiment.

        An equation-error model without F needs no pulses, because its output depends on a finite
        number of past u. An output-error model has pulses even without F.
        """
        inside = int(self.integrator == "f")
        if self.at_rest or (self.nf + inside == 0 and self.memory > 0):
            return 0
        return max(self.reach, self.nf + inside) - inside

    @property
    def trend(self) -> int:
        """Number of columns of the trend: 0 none, 1 level, 2 level and ramp."""
        if self.at_rest:
            return 0
        if self.integrator:
            return {"f": 2, "a": 1}[self.integrator]
        return int(self.offset)

    @property
    def white(self) -> bool:
        """True if the noise on the output is white, so that past y do not help to predict y."""
        return self.memory == 0


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeResponse:
    """Nuisance parameters of one experiment, estimated with the model."""

    transients: tuple[float, ...]
    """Heights of the pulses at the first samples, in the unit of y. The pulses, filtered by 1/F,
    replace the unknown past."""
    level: float = 0.0
    """Constant part of an integrating output, in the unit of y."""
    offset: float = 0.0
    """Input offset u0, in the unit of u. At this constant input y is 0, or constant if y
    integrates."""


def transient_count(
    *, numerator_degree: int, denominator_degree: int, integrator: bool = False
) -> int:
    """Return the number of pulses that replace an unknown past: the number of states.

    With an integrator the count is smaller by one, because the level has a separate column.
    """
    return max(max(numerator_degree, denominator_degree) - int(integrator), 0)


def free_columns(F: Array, N: int, *, count: int, drift: bool) -> Array:
    """Return pulses at 0 … count-1 filtered by 1/F, then level and ramp, (N, count + 2 drift).

    F is the denominator without the integrator. The ramp is t + 1, the sum of a unit input.
    """
    pulses = lagged(impulse(F, N), range(count))
    if not drift:
        return pulses
    return np.column_stack([pulses, np.ones(N), np.arange(1.0, N + 1.0)])


def offset_from_ramp(B: Array, F: Array, slope: float, mean_input: float) -> float:
    """Return the offset u0 from the ramp's slope, for a model with input cumsum(u - mean_input)."""
    gain = float(np.sum(B) / np.sum(F))
    return mean_input - slope / gain if gain != 0 else float("nan")
