"""The result of a subspace estimation: a model with its singular values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.models.fit import Fit

if TYPE_CHECKING:
    import control

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SubspaceFit(Fit):
    """x(t+1) = A_s x(t) + B_s u(t) + K e(t), y(t) = C_s x(t) + D_s u(t) + e(t), as A y = B u + C e.

    The polynomials are those of the state space in innovations form: A is det(q - A_s) and C is
    det(q - A_s + K C_s), both over q^n.
    """

    weights: str
    """"cva", "moesp" or "n4sid"."""
    horizon: int
    """Samples of past and of future that the poles come from."""
    singular_values: Vector
    """Of the weighted projection of the future on the past, largest first, (horizon,)."""
    canonical_correlations: Vector
    """Of future and past, 0 to 1, at the longest horizon that was looked at; those of "cva", with
    any weights."""
    suggested_order: int
    """Order of least MDL of the states' one-step errors; 10 at most."""

    @property
    def order(self) -> int:
        """Number of states, a delay beyond one sample not counted."""
        return int(self.A.size) - 1

    def state_space(self) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
        """Return A_s (n, n), B_s (n, 1), C_s (1, n), D_s (1, 1) and K (n, 1), observer form.

        x_k(t) is what y(t + k - 1) would be of a past that ended at t, less what x_1 … x_(k-1)
        add to it; n is the order, or nk + nb - 1 where that is more.
        """
        n = max(self.A.size, self.B.size) - 1
        a, b, c = (np.pad(p, (0, n + 1 - p.size)) for p in (self.A, self.B, self.C))
        A = np.eye(n, k=1)
        A[:, 0] = -a[1:]
        B = (b[1:] - a[1:] * b[0])[:, None]
        return A, B, np.eye(1, n), np.array([[b[0]]]), (c[1:] - a[1:])[:, None]

    def to_control(self) -> control.StateSpace:
        """Return the model from u to y as a python-control state space with dt=Ts."""
        import control

        A, B, C, D, _ = self.state_space()
        return control.ss(A, B, C, D, self.Ts, inputs=["u"], outputs=[self.output])

    def explain(self) -> str:
        """Return the singular values and what they say of the order."""
        values = self.canonical_correlations[: max(10, self.order + 2)]
        lines = ["canonical correlations of past and future:"]
        lines += [
            f"  {k:2}  {value:8.5f}{'  <- order' if k == self.order else ''}"
            for k, value in enumerate(values, 1)
        ]
        lines.append(f"the one-step errors speak for order {self.suggested_order} (MDL)")
        return "\n".join(lines)
