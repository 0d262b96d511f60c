"""State-space model with several inputs and outputs.

The innovations form is ::

    x(t+1) = A x(t) + B u(t) + K e(t),    y(t) = C x(t) + D u(t) + e(t)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armrig.data.columns import Matrix as Matrix
from armrig.data.columns import Vector as Vector
from armrig.numerics.polynomial import Array
from armrig.numerics.recursion import recursion

Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateSpace:
    """Matrices of the innovations form."""

    A: Matrix
    """Transition matrix (n, n)."""
    B: Matrix
    """Input matrix (n, nu)."""
    C: Matrix
    """Output matrix (ny, n)."""
    D: Matrix
    """Direct term (ny, nu)."""
    K: Matrix
    """Gain of the innovations (n, ny)."""
    noise_states: int = 0
    """Number of noise states, the last entries of the state vector. No input affects them."""

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        freeze(self, ("A", "B", "C", "D", "K"))

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.A.shape[0])

    @property
    def deterministic(self) -> StateSpace:
        """The model from u to y, without the states that no input affects."""
        n = self.order - self.noise_states
        return StateSpace(
            A=self.A[:n, :n],
            B=self.B[:n],
            C=self.C[:, :n],
            D=self.D,
            K=np.zeros((n, self.C.shape[0])),
        )

    def simulated(self, u: Array) -> Array:
        """Return the output (N, ny) for the input u (N, nu), from rest and without noise."""
        x = recursion(self.A, u @ self.B.T, np.zeros(self.order))[:-1]
        return np.asarray(x @ self.C.T + u @ self.D.T)


def read_only_copy(values: Any) -> Any:
    """Return a read-only copy of an array of numbers, or a tuple of such copies."""
    if isinstance(values, tuple):
        return tuple(map(read_only_copy, values))
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def freeze(value: Any, names: tuple[str, ...]) -> None:
    """Replace the fields `names` of a dataclass by read-only arrays, or tuples of arrays."""
    for name in names:
        object.__setattr__(value, name, read_only_copy(getattr(value, name)))
