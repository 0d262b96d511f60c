"""Matrices of an estimated state-space model, and the transfer function of each channel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armrig.models.model import Matrix, Vector
from armrig.models.multivariable.interpolation import circle, coefficients
from armrig.models.multivariable.polynomials import Channel
from armrig.models.multivariable.state_space import StateSpace


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
        """True, because the channels have no noise polynomials of their own."""
        return True

    @property
    def integrators(self) -> tuple[bool, ...]:
        """False for each output, because no root is 1 by construction."""
        return tuple(False for _ in self.C)

    def has(self, i: int, j: int) -> bool:
        """Return True: each input affects each output."""
        return True

    def channel(self, i: int, j: int) -> Channel:
        """Return B and F from input j to output i, with F(x) = det(1 - x A) and x = q^-1.

        With W = inv(1 - x A), B = F (D + x C W B). The derivatives are d F = -x F tr(W dA) and
        d W = x W dA W.
        """
        n = self.A.shape[0]
        x = circle(n + 1, np.linalg.eigvals(self.A))
        W = np.linalg.inv(np.eye(n) - x[:, None, None] * self.A)
        F = 1 / np.linalg.det(W)
        cW, Wb = self.C[i] @ W, W @ self.B[:, j]
        G = self.D[i, j] + x * (cW @ self.B[:, j])
        by_F, by_B = np.zeros((2, x.size, self.theta.size), dtype=np.complex128)
        by_F[:, : n * n] = (-x * F)[:, None] * W.transpose(0, 2, 1).reshape(x.size, -1)
        by_B[:, : n * n] = by_F[:, : n * n] * G[:, None]
        moved = (x**2 * F)[:, None, None] * cW[:, :, None] * Wb[:, None, :]
        by_B[:, : n * n] += moved.reshape(x.size, -1)
        nu, ny = self.B.shape[1], self.C.shape[0]
        b = n * n + np.arange(n) * nu + j
        c = n * (n + nu) + i * n + np.arange(n)
        by_B[:, b] = (x * F)[:, None] * cW
        by_B[:, c] = (x * F)[:, None] * Wb
        by_B[:, n * (n + nu + ny) + i * nu + j] = F
        first = min(self.nk[j], 1)
        delay = self.nk[j] - first
        return Channel(
            polynomials={
                "A": np.ones(1),
                "B": np.concatenate([np.zeros(delay + first), coefficients(F * G, x)[first:]]),
                "C": np.ones(1),
                "D": np.ones(1),
                "F": np.append(1.0, coefficients(F, x)[1:]),
            },
            J=np.vstack([coefficients(by_B, x)[first:], coefficients(by_F, x)[1:]]),
            nk=self.nk[j],
            integrator=False,
        )

    def realised(self) -> StateSpace:
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
            A=A,
            B=B,
            C=np.pad(self.C, extra),
            D=self.D,
            K=np.pad(self.K, extra[::-1]),
        )
