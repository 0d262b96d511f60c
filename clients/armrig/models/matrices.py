"""Matrices of an estimated state-space model, and the transfer function of each channel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armrig.models.polynomials import Polynomials, circle, coefficients
from armrig.models.state_space import Matrix, StateSpace, Vector


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matrices:
    """Matrices of x(t+1) = A x + B u + K e, y = C x + D u + e, and the delays of the inputs."""

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
    nk: tuple[int, ...]
    """Number of samples before each input affects the outputs: 0 with a direct term, otherwise at
    least 1."""

    @property
    def theta(self) -> Vector:
        """All entries of A, B, C, D and K, row by row."""
        return np.concatenate([M.ravel() for M in (self.A, self.B, self.C, self.D, self.K)])

    @property
    def names(self) -> tuple[tuple[str, int, int, int], ...]:
        """Letter, row, column and lag of each entry; the lag is always 0."""
        matrices = {"A": self.A, "B": self.B, "C": self.C, "D": self.D, "K": self.K}
        return tuple(
            (name, i, k, 0)
            for name, M in matrices.items()
            for i in range(M.shape[0])
            for k in range(M.shape[1])
        )

    def replaced(self, theta: Vector) -> Matrices:
        """Return the matrices with other entries."""
        blocks = (self.A, self.B, self.C, self.D, self.K)
        parts = np.split(theta, np.cumsum([M.size for M in blocks])[:-1])
        A, B, C, D, K = (p.reshape(M.shape) for p, M in zip(parts, blocks, strict=True))
        return Matrices(A=A, B=B, C=C, D=D, K=K, nk=self.nk)

    @property
    def coupled(self) -> bool:
        """True if there are several outputs: their channels have no C and D of their own."""
        return len(self.C) > 1

    @property
    def integrators(self) -> tuple[bool, ...]:
        """False for each output, because no root is 1 by construction."""
        return tuple(False for _ in self.C)

    def has(self, i: int, j: int) -> bool:
        """Return True: each input affects each output."""
        return True

    def channel(self, i: int, j: int) -> tuple[Polynomials, Matrix]:
        """Return the polynomials from input j to output i, and their derivatives (m, d).

        With x = q^-1, W = inv(1 - x A), c = C_i and b = B_j, the model is y = B/F u. With a single
        output and K, the model is F y = B u + C e ::

            F = det(1 - x A),    B = F (D + x c W b),    C = det(1 - x (A - K c))

        The derivatives are d F = -x F tr(W dA) and d W = x W dA W.
        """
        n, nu, ny = self.A.shape[0], self.B.shape[1], self.C.shape[0]
        x = circle(n + 1, np.linalg.eigvals(self.A))
        W = np.linalg.inv(np.eye(n) - x[:, None, None] * self.A)
        F = 1 / np.linalg.det(W)
        cW, Wb = self.C[i] @ W, W @ self.B[:, j]
        G = self.D[i, j] + x * (cW @ self.B[:, j])
        by_F, by_B, by_C = np.zeros((3, x.size, self.theta.size), dtype=np.complex128)
        c = n * (n + nu) + i * n + np.arange(n)
        by_F[:, : n * n] = (-x * F)[:, None] * W.transpose(0, 2, 1).reshape(x.size, -1)
        by_B[:, : n * n] = by_F[:, : n * n] * G[:, None]
        moved = (x**2 * F)[:, None, None] * cW[:, :, None] * Wb[:, None, :]
        by_B[:, : n * n] += moved.reshape(x.size, -1)
        by_B[:, n * n + np.arange(n) * nu + j] = (x * F)[:, None] * cW
        by_B[:, c] = (x * F)[:, None] * Wb
        by_B[:, n * (n + nu + ny) + i * nu + j] = F
        first = min(self.nk[j], 1)
        delay = self.nk[j] - first
        B = np.concatenate([np.zeros(delay + first), coefficients(F * G, x)[first:]])
        f = np.append(1.0, coefficients(F, x)[1:])
        dB, dF = coefficients(by_B, x)[first:], coefficients(by_F, x)[1:]
        if self.coupled or not self.K.any():
            return Polynomials.of_channel(B=B, F=f, nk=self.nk[j]), np.vstack([dB, dF])
        V = np.linalg.inv(np.eye(n) - x[:, None, None] * (self.A - self.K @ self.C))
        C = 1 / np.linalg.det(V)
        by_C[:, : n * n] = (-x * C)[:, None] * V.transpose(0, 2, 1).reshape(x.size, -1)
        by_C[:, c] = (x * C)[:, None] * (V @ self.K[:, 0])
        by_C[:, -n:] = (x * C)[:, None] * (self.C[0] @ V)
        form = Polynomials.of_channel(
            A=f, B=B, C=np.append(1.0, coefficients(C, x)[1:]), nk=self.nk[j]
        )
        return form, np.vstack([dF, dB, coefficients(by_C, x)[1:]])

    def innovations_form(self) -> StateSpace:
        """Return the innovations form, with a chain of states for each delay beyond one sample."""
        n, nu = self.B.shape
        delays = [max(k - 1, 0) for k in self.nk]
        A, B = np.zeros((n + sum(delays),) * 2), np.zeros((n + sum(delays), nu))
        A[:n, :n] = self.A
        begin = n
        for j, d in enumerate(delays):
            if d == 0:
                B[:n, j] = self.B[:, j]
                continue
            A[:n, begin] = self.B[:, j]
            A[begin : begin + d, begin : begin + d] = np.eye(d, k=1)
            B[begin + d - 1, j] = 1.0
            begin += d
        extra = ((0, 0), (0, sum(delays)))
        return StateSpace(
            A=A, B=B, C=np.pad(self.C, extra), D=self.D, K=np.pad(self.K, extra[::-1])
        )
