"""What the output does by itself: the part that initial state and input offset explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.polynomial import Array, impulse, lagged

Matrix = NDArray[np.float64]


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
