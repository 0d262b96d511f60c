"""State-space model with several inputs and outputs: simulation and prediction.

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
from armrig.data.dataset import Signals
from armrig.numerics.least_squares import column_norms
from armrig.numerics.polynomial import Array
from armrig.numerics.recursion import recursion

Complex = NDArray[np.complex128]

_MIN_SINGULAR_VALUE = 1e-4  # least singular value of the responses, divided by the largest
_MIN_SHOWN_VALUE = 1e-10  # this ratio for a combination of states with a significant effect
_SHOWN_SIGMAS = 5.0  # least significant effect of a combination of states, in σ of the noise


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


def frozen(values: Any) -> Any:
    """Return a read-only copy of an array of numbers, or a tuple of such copies."""
    if isinstance(values, tuple):
        return tuple(map(frozen, values))
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def freeze(value: Any, names: tuple[str, ...]) -> None:
    """Replace the fields `names` of a dataclass by read-only arrays, or tuples of arrays."""
    for name in names:
        object.__setattr__(value, name, frozen(getattr(value, name)))


def predicted(
    system: StateSpace,
    part: Signals,
    *,
    horizon: int | None,
    integrating: tuple[bool, ...],
    offset: bool = False,
    noise_std: Vector,
) -> Array:
    """Return ŷ (N, ny) of one experiment from y up to t - horizon; from u alone if horizon is None.

    The initial state and a ramp of each integrating output are estimated by least squares. With
    `offset`, the level of each other output is estimated, too. The ramp or the level represents the
    offset of the input. The errors are divided by `noise_std` (ny,), the standard deviations of e.
    The innovation of a missing output is taken as 0. If the model is unstable, ŷ may be infinite.
    The predictions of an output are NaN before its first measured sample.
    """
    if horizon is None:
        system = system.deterministic
    used = part.valid if horizon is not None else np.zeros_like(part.valid)
    with np.errstate(over="ignore", invalid="ignore"):
        r = error_responses(system, part, integrating=integrating, offset=offset, used=used)
        if not np.isfinite(r.errors).all():
            return np.full(part.y.shape, np.inf)
        c, x = r.combination(part, noise_std), r.x
        for _ in range((horizon or 1) - 1):
            ahead = x[:-1] @ system.A.T + r.inputs[:-1] @ system.B.T
            x = np.concatenate([x[:1], ahead])
        is_trend = np.arange(c.size) > system.order
        own = _outputs(system, x, r.inputs) - r.outputs * is_trend[:, None]
    found = np.asarray(np.einsum("k,tki->ti", c, own))
    # Before the first measured sample of an output, hardly any data determine its state.
    unknown = np.cumsum(part.valid, axis=0) == 0
    return np.where(unknown, np.nan, found) if horizon is not None else found


def error_responses(
    system: StateSpace,
    part: Signals,
    *,
    integrating: tuple[bool, ...],
    offset: bool = False,
    used: Array | None = None,
) -> ErrorResponses:
    """Return the responses of the one-step error y - ŷ to the data and to estimated quantities.

    The estimated quantities are the initial state, the ramps and the levels of `predicted`. The
    innovations of outputs not marked in `used`, by default the valid ones, are taken as 0.
    """
    at = [i for i, integrates in enumerate(integrating) if integrates or offset]
    n = system.order
    inputs, outputs = np.zeros((2, part.N, 1 + n + len(at), max(part.nu, part.ny)))
    inputs, outputs = inputs[:, :, : part.nu], outputs[:, :, : part.ny]
    inputs[:, 0], outputs[:, 0] = part.u, np.where(part.valid, part.y, 0.0)
    for k, i in enumerate(at, 1 + n):
        outputs[:, k, i] = np.arange(1.0, part.N + 1.0) if integrating[i] else 1.0
    x0 = np.zeros((1 + n + len(at), n))
    x0[1 : 1 + n] = np.eye(n)
    x = _states(system, inputs, outputs, x0, part.valid if used is None else used)
    errors = outputs - _outputs(system, x, inputs)
    return ErrorResponses(inputs=inputs, outputs=outputs, x=x, errors=errors)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ErrorResponses:
    """The m responses of a system: to the data, to each unit initial state, and to each trend."""

    inputs: Array
    """Inputs (N, m, nu)."""
    outputs: Array
    """Outputs (N, m, ny)."""
    x: Array
    """States (N, m, n)."""
    errors: Array
    """Errors of the one-step predictions (N, m, ny)."""

    def combination(self, part: Signals, noise_std: Vector) -> Array:
        """Return the coefficients (m,) with the least squared errors; the first of them is 1."""
        weighted = (self.errors / noise_std).transpose(0, 2, 1)[part.valid]
        return np.append(1.0, -_initial(weighted[:, 1:], weighted[:, 0]))


def _initial(responses: Array, errors: Array) -> Array:
    """Return least-squares coefficients of the responses, without undetermined combinations."""
    # States of channels with nearly the same poles have nearly the same responses. Their estimates
    # would be large, with opposite signs, and spoil the predictions of missing samples.
    scale = np.maximum(column_norms(responses), 1e-100)
    U, s, V = np.linalg.svd(responses / scale, full_matrices=False)
    z = U.T @ errors
    least = np.where(np.abs(z) > _SHOWN_SIGMAS, _MIN_SHOWN_VALUE, _MIN_SINGULAR_VALUE)
    kept = s > least * s[:1]
    return np.asarray(V[kept].T @ (z[kept] / s[kept])) / scale


def _outputs(system: StateSpace, x: Array, u: Array) -> Array:
    return np.asarray(x @ system.C.T + u @ system.D.T)


def _states(system: StateSpace, u: Array, y: Array, x0: Array, used: Array) -> Array:
    """Return the states x(0) … x(N-1), (N, m, n), computed from the outputs marked in `used`."""
    A, B, C, D, K = system.A, system.B, system.C, system.D, system.K
    if not used.any() or not K.any():
        return recursion(A, u @ B.T, x0)[:-1]
    if used.all():
        return recursion(A - K @ C, u @ (B - K @ D).T + y @ K.T, x0)[:-1]
    x = np.empty((*u.shape[:2], A.shape[0]))
    now, driven = x0, u @ B.T
    direct = y - u @ D.T
    for t in range(u.shape[0]):
        x[t] = now
        e = (direct[t] - now @ C.T) * used[t]
        now = now @ A.T + driven[t] + e @ K.T
    return x
