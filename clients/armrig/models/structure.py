"""Orders of a model's polynomials, and number of unknowns for the signals before the data."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from armrig.numerics.polynomial import Array, impulse, lag_columns


@dataclass(frozen=True, slots=True, kw_only=True)
class Structure:
    """Orders of A y = sum of (B_j/F_j) u_j + (C/D) e, without the factor 1 - q^-1 of an integrator.

    The equation is that of one output with one input or several.
    """

    nb: tuple[int, ...]
    """Number of coefficients of B for each input; 0 if the input does not affect the output."""
    nk: tuple[int, ...]
    """Number of samples before each input affects y."""
    nf: tuple[int, ...]
    """Number of coefficients of F after the leading 1, for each input."""
    na: int = 0
    """Number of coefficients of A after the leading 1."""
    nc: int = 0
    """Number of coefficients of C after the leading 1."""
    nd: int = 0
    """Number of coefficients of D after the leading 1."""
    integrator: Literal["", "a", "f"] = ""
    """Polynomial with the additional factor 1 - q^-1: A or each F."""
    shared: bool = False
    """True if all inputs have the same F."""
    offset: bool = False
    """True if a level of the output, the effect of an input offset, is estimated. With an
    integrator the level is always estimated, unless `at_rest` is True."""
    at_rest: bool = False
    """True if each experiment begins with all signals at zero."""
    reach: int = 0
    """Least number of lags of u for which the start has pulses. A search over delays has the pulses
    of the longest delay, so that the costs of all delays are comparable."""

    def lags(self, j: int) -> range:
        """Return the lags of input j in B."""
        return range(self.nk[j], self.nk[j] + self.nb[j])

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Inputs that have the same F, for each F; all inputs without an F are one group."""
        if len(self.nb) == 1:
            return ((0,),)
        used = [j for j, n in enumerate(self.nb) if n]
        if self.shared:
            return (tuple(used),)
        plain = tuple(j for j in used if self.nf[j] == 0)
        return (*((plain,) if plain else ()), *((j,) for j in used if self.nf[j]))

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of coefficients of F after the leading 1, for each group."""
        return tuple(self.nf[group[0]] for group in self.groups)

    @property
    def memory(self) -> int:
        """Largest lag of y or e: after a gap in y, this number of past samples is unknown."""
        return max(self.nd + self.na, self.nc)

    @property
    def first(self) -> int:
        """Number of first samples that depend on u before the data and on no pulse of `counts`."""
        if self.at_rest:
            return 0
        pairs = zip(self.groups, self.counts, strict=True)
        reaches = [self._reach(group) for group, count in pairs if not count]
        return self.nd + max(reaches) if reaches else 0

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of pulses that replace the unknown state of B/F at the start, for each group.

        An equation-error model without F needs no pulses, because its output depends on a finite
        number of past u. An output-error model has pulses even without F.
        """
        inside = int(self.integrator == "f")
        return tuple(
            0
            if self.at_rest or (nf + inside == 0 and self.memory > 0)
            else max(self._reach(group), self.reach, nf + inside) - inside
            for group, nf in zip(self.groups, self.sizes, strict=True)
        )

    def _reach(self, group: tuple[int, ...]) -> int:
        """Return the largest lag of u in the B of a group."""
        return max(self.nk[j] + self.nb[j] for j in group) - 1

    def past_pulse_count(self, start: int) -> int:
        """Return the number of pulses that represent the past of y, if y begins at `start`."""
        if start == 0 and self.at_rest:
            return 0
        return max(self.memory, self.first - start)

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

    @property
    def parameters(self) -> int:
        """Number of estimated coefficients."""
        return self.na + sum(self.nb) + self.nc + self.nd + sum(self.sizes)

    @property
    def output_error(self) -> Structure:
        """The structure with the same B and F, and with white noise on the output."""
        return replace(self, na=0, nc=0, nd=0)


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
    pulses = lag_columns(impulse(F, N), range(count))
    if not drift:
        return pulses
    return np.column_stack([pulses, np.ones(N), np.arange(1.0, N + 1.0)])


def offset_from_ramp(B: Array, F: Array, slope: float, mean_input: float) -> float:
    """Return the offset u0 from the ramp's slope, for a model with input cumsum(u - mean_input)."""
    gain = float(np.sum(B) / np.sum(F))
    return mean_input - slope / gain if gain != 0 else float("nan")
