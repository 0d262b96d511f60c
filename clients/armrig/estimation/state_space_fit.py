"""Matrices, covariance and quality of a state-space model, from its predictor of scaled signals.

The parameters of the predictor are Abar and C, along some directions, then the entries of Bbar and
K signal by signal, then those of D row by row. A and B are fixed while K changes: the derivatives
with respect to K are then responses to e, which differ more from the others than responses to y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armrig.data.dataset import Signals
from armrig.estimation.state_space_problem import (
    StateSpaceProblem,
    basis_of_states,
    by_part,
    stack_blocks,
    whiten,
    without,
)
from armrig.estimation.state_space_responses import Predictor
from armrig.models.matrices import Matrices
from armrig.numerics.inference import Inference, OutputResiduals, infer
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.polynomial import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Derivatives:
    """Derivatives of the matrices of the innovations form with respect to the d parameters."""

    Abar: Array
    """(d, n, n)."""
    A: Array
    """(d, n, n)."""
    B: Array
    """(d, n, nu)."""
    C: Array
    """(d, ny, n)."""
    D: Array
    """(d, ny, nu)."""
    K: Array
    """(d, n, ny)."""

    def moved(self, at: Predictor, step: Array) -> Predictor:
        """Return the predictor after a small step of the parameters (d,)."""
        A, B, C, D, K = (
            M + np.tensordot(step, by, axes=1)
            for M, by in ((getattr(at, x), getattr(self, x)) for x in "ABCDK")
        )
        return Predictor(Abar=A - K @ C, Bbar=B - K @ D, C=C, D=D, K=K, x0=at.x0)

    def at_fixed_pole(self, A: Array) -> Array:
        """Return a basis (d, d - 1) of the parameters that do not move the pole of A nearest 1."""
        z, V = np.linalg.eig(A)
        i = int(np.argmin(np.abs(z - 1)))
        moves = np.real(np.einsum("j,djk,k->d", np.linalg.inv(V)[i], self.A, V[:, i]))
        return np.asarray(np.linalg.qr(moves[:, None], mode="complete")[0][:, 1:])

    def along(self, N: Array) -> Derivatives:
        """Return the derivatives with respect to z, if the parameters are N z."""
        names = ("Abar", "A", "B", "C", "D", "K")
        return Derivatives(**{x: np.tensordot(N.T, getattr(self, x), axes=1) for x in names})


def derivatives(problem: StateSpaceProblem, at: Predictor, V: Array) -> Derivatives:
    """Return the derivatives of the matrices for the directions V of Abar and C.

    A and B do not change with the entries of K.
    """
    (n, ny), nu, m = at.K.shape, at.Bbar.shape[1], V.shape[1]
    of_K = n * ny * problem.noise
    d = m + n * nu + of_K + ny * nu * problem.direct
    Abar, C = np.zeros((d, n, n)), np.zeros((d, ny, n))
    Abar[:m], C[:m] = V[: n * n].T.reshape(-1, n, n), V[n * n :].T.reshape(-1, ny, n)
    Bbar, K, D = np.zeros((d, n, nu)), np.zeros((d, n, ny)), np.zeros((d, ny, nu))
    Bbar[m : m + n * nu] = np.eye(n * nu).reshape(-1, nu, n).swapaxes(1, 2)
    K[m + n * nu :][:of_K] = np.eye(of_K).reshape(-1, ny, n).swapaxes(1, 2)
    if problem.direct:
        D[m + n * nu + of_K :] = np.eye(ny * nu).reshape(-1, ny, nu)
    Abar, Bbar = Abar - K @ at.C, Bbar - K @ at.D
    return Derivatives(
        Abar=Abar, A=Abar + K @ at.C + at.K @ C, B=Bbar + K @ at.D + at.K @ D, C=C, D=D, K=K
    )


def matrices(
    at: Predictor, by: Derivatives, su: Array, sy: Array, delays: tuple[int, ...]
) -> tuple[Matrices, Array]:
    """Return the model in units of the data, and the derivatives of its theta."""
    form = Matrices(
        A=at.A,
        B=at.B / su,
        C=sy[:, None] * at.C,
        D=sy[:, None] * at.D / su,
        K=at.K / sy,
        nk=delays,
    )
    blocks = [by.A, by.B / su, sy[:, None] * by.C, sy[:, None] * by.D / su, by.K / sy]
    return form, np.hstack([b.reshape(len(b), -1) for b in blocks]).T


def influence(
    problem: StateSpaceProblem, at: Predictor, V: Array, states: Sequence[Basis] | None = None
) -> tuple[Array, tuple[Basis, ...]]:
    """Return the derivatives of the whitened predictions, and the effects of the initial states.

    The effects are a basis for each experiment, projected out of the derivatives (ny N, d). A known
    basis is an argument.
    """
    bases, left = [], []
    for i, part in enumerate(problem.parts):
        by, free = problem.sensitivities(i, at, V)
        bases.append(basis_of_states(part, free) if states is None else states[i])
        left.append(without(bases[-1], whiten(part, by)))
    return stack_blocks(left), tuple(bases)


def inference(
    data: Signals,
    problem: StateSpaceProblem,
    Psi: Array,
    states: Sequence[Basis],
    residuals: Sequence[Array],
    sy: Array,
) -> Inference:
    """Return the covariance of the parameters, and the quality of each output.

    Psi and the states are those of `influence`; residuals (N_i, ny) are errors of scaled outputs.
    """
    basis, ny = orthonormal(Psi), sy.size
    W = basis.W if ny > 1 else basis.W * problem.parts[0].weights.max() / sy
    experiments = []
    experiment_parts = zip(problem.parts, states, residuals, data.experiments(), strict=True)
    split = (by_part(problem.parts, M) for M in (basis.Q, Psi))
    for (part, Z, e, signals), Q, psi in zip(experiment_parts, *split, strict=True):
        late = signals.N - len(e)  # before the delayed inputs are known, the errors are unknown
        e = np.vstack([np.where(np.isnan(signals.y[:late]), np.nan, 0.0), e * sy])
        span = np.eye(signals.N, late)
        if ny == 1:
            span = np.hstack([span, _led(Z.Q, late)])
            outputs = [OutputResiduals(e=e[:, 0], y=signals.y[:, 0], H=_led(Q, late), Z=span)]
            experiments.append(outputs)
            continue
        G = part.weights
        each, white = (M.reshape(ny, len(part.u), -1) for M in (Q, psi))
        unwhitened = np.linalg.inv(G[0]) if part.rows.all() else np.eye(ny)
        outputs = []
        for i in range(ny):
            h = sum(G[:, k, i, None] * each[k] for k in range(i, ny)) / sy[i]
            Psi_i = _led(sum(unwhitened[i, k] * white[k] for k in range(i + 1)), late)
            outputs.append(
                OutputResiduals(e=e[:, i], y=signals.y[:, i], H=_led(h, late), Psi=Psi_i, Z=span)
            )
        experiments.append(outputs)
    # The outputs share the states, so that a state counts as 1/ny for each output.
    shared = 0 if ny == 1 else sum(Z.rank for Z in states)
    return infer(
        experiments,
        W,
        parameters=[(Psi.shape[1] + shared) / ny] * ny,
        score="correlated" if problem.noise else "exogenous",
    )


def _led(x: Array, late: int) -> Array:
    """Return x (N, k) after `late` rows of zeros."""
    return np.pad(x, ((late, 0), (0, 0))) if late else x
