"""Result of a subspace estimation: a model with its singular values."""

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
    """A state-space model from a subspace method, which also has the form A y = B u + C e.

    The innovations form is x(t+1) = A_s x(t) + B_s u(t) + K e(t), y(t) = C_s x(t) + D_s u(t) +
    e(t). The polynomials are computed from the innovations form: A is det(q - A_s) and C is det(q -
    A_s + K C_s), both divided by q^n.

    Examples
    --------
    The fourth canonical correlation is much smaller than the third: the order is 3.

    >>> import armrig
    >>> fit = armrig.n4sid(armrig.example_recording().dataset("alpha"))
    >>> fit.order, fit.suggested_order
    (3, 3)
    >>> fit.canonical_correlations[:4].round(1)
    array([1. , 1. , 1. , 0.3])
    """

    weights: str
    """Weights of the projection: "cva", "moesp" or "n4sid"."""
    horizon: int
    """Number of past samples in the projection that determines the poles; the number of future
    samples is equal."""
    singular_values: Vector
    """Singular values of the weighted projection of the future on the past, largest first,
    (horizon,)."""
    canonical_correlations: Vector
    """Canonical correlations of future and past, 0 to 1, at the longest horizon tried. They do not
    depend on `weights`: they are the singular values for the weights "cva"."""
    suggested_order: int
    """Order with the least MDL, at most 10. MDL is computed from the one-step errors of the
    estimated states."""

    @property
    def order(self) -> int:
        """Number of states; the states of a delay beyond one sample are not counted."""
        return int(self.A.size) - 1

    def state_space(self) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
        """Return A_s (n, n), B_s (n, 1), C_s (1, n), D_s (1, 1) and K (n, 1) in observer form.

        The state x_k(t) is the sum of the terms with y, u and e before t in the difference equation
        of y(t + k - 1). The dimension n is the larger of the order and nk + nb - 1.

        Examples
        --------
        >>> import armrig
        >>> fit = armrig.n4sid(armrig.example_recording().dataset("alpha"))
        >>> A, B, C, D, K = fit.state_space()
        >>> A.round(1)
        array([[ 2.5,  1. ,  0. ],
               [-2.1,  0. ,  1. ],
               [ 0.6,  0. ,  0. ]])
        >>> C, D
        (array([[1., 0., 0.]]), array([[0.]]))
        """
        n = max(self.A.size, self.B.size) - 1
        a, b, c = (np.pad(p, (0, n + 1 - p.size)) for p in (self.A, self.B, self.C))
        A = np.eye(n, k=1)
        A[:, 0] = -a[1:]
        B = (b[1:] - a[1:] * b[0])[:, None]
        return A, B, np.eye(1, n), np.array([[b[0]]]), (c[1:] - a[1:])[:, None]

    def to_control(self) -> control.StateSpace:
        """Return the model from u to y as a python-control state-space system with dt=Ts.

        Examples
        --------
        >>> import armrig
        >>> fit = armrig.n4sid(armrig.example_recording().dataset("alpha"))
        >>> system = fit.to_control()
        >>> system.nstates, system.input_labels, system.output_labels, system.dt
        (3, ['u'], ['alpha'], 0.01)
        """
        import control

        A, B, C, D, _ = self.state_space()
        return control.ss(A, B, C, D, self.Ts, inputs=["u"], outputs=[self.output])

    def explain(self) -> str:
        """Return a text with the canonical correlations and the order that the data suggest.

        Examples
        --------
        >>> import armrig
        >>> fit = armrig.n4sid(armrig.example_recording().dataset("alpha"))
        >>> print(fit.explain())
        canonical correlations of past and future:
           1   0.9999...
           2   0.999...
           3   0.994...  <- order
           4   0.25...
          ...
        the one-step errors suggest order 3 (MDL)
        """
        values = self.canonical_correlations[: max(10, self.order + 2)]
        lines = ["canonical correlations of past and future:"]
        lines += [
            f"  {k:2}  {value:8.5f}{'  <- order' if k == self.order else ''}"
            for k, value in enumerate(values, 1)
        ]
        lines.append(f"the one-step errors suggest order {self.suggested_order} (MDL)")
        return "\n".join(lines)
