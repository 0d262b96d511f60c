"""Polynomials of A(q) y(t) = B(q)/F(q) u(t) + C(q)/D(q) e(t) with any number of signals.

Row i of the model is ::

    sum_k A_ik y_k = sum_j B_ij/F_ij u_j + C_i/D_i e_i

If A has elements outside its diagonal, all F and D are 1 (ARX, ARMAX).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from armrig.models.state_space import Complex, Matrix, StateSpace, Vector, freeze

Row = tuple[Vector, ...]

_ONE = np.ones(1)
_RADIUS = 1.05
"""Radius of the circle in q, divided by the modulus of the largest pole. If all poles are inside
the unit circle, this number is the radius itself."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Polynomials:
    """Polynomials of all rows of the model: one row for each output."""

    A: tuple[Row, ...]
    """A_ik for each row i and output k; A_ii begins with 1, and A_ik with i ≠ k begins with 0."""
    B: tuple[Row, ...]
    """B_ij for each row i and input j, beginning with nk zeros."""
    C: Row
    """C_i of each row."""
    D: Row
    """D_i of each row."""
    F: tuple[Row, ...]
    """F_ij for each row i and input j."""
    nk: tuple[tuple[int, ...], ...]
    """Number of samples before input j affects output i."""
    integrators: tuple[bool, ...]
    """True for each output whose row has the factor 1 - q^-1 by construction, in F, or in A if
    there is no F."""

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        freeze(self, ("A", "B", "C", "D", "F"))

    @classmethod
    def of_channel(
        cls,
        *,
        B: ArrayLike,
        nk: int,
        A: ArrayLike = _ONE,
        C: ArrayLike = _ONE,
        D: ArrayLike = _ONE,
        F: ArrayLike = _ONE,
        integrator: bool = False,
    ) -> Polynomials:
        """Return the polynomials from one input to one output."""
        a, b, c, d, f = (np.asarray(p, dtype=np.float64) for p in (A, B, C, D, F))
        return cls(
            A=((a,),), B=((b,),), C=(c,), D=(d,), F=((f,),), nk=((nk,),), integrators=(integrator,)
        )

    @property
    def theta(self) -> Vector:
        """Parameters, row after row: a, b, c, d, f."""
        return np.concatenate([p for *_, p in self._parts()])

    def replaced(self, theta: Vector) -> Polynomials:
        """Return the polynomials with other coefficients."""
        rows: dict[str, list[list[Vector]]] = {x: [[] for _ in self.A] for x in "abcdf"}
        begin = 0
        for letter, i, _, first, p in self._parts():
            leading = np.ones(1) if letter != "b" else np.zeros(first)
            if letter == "a":
                leading = self.A[i][len(rows["a"][i])][:1]
            rows[letter][i].append(np.append(leading, theta[begin : begin + p.size]))
            begin += p.size
        return replace(
            self,
            A=tuple(map(tuple, rows["a"])),
            B=tuple(map(tuple, rows["b"])),
            C=tuple(row[0] for row in rows["c"]),
            D=tuple(row[0] for row in rows["d"]),
            F=tuple(map(tuple, rows["f"])),
        )

    @property
    def names(self) -> tuple[tuple[str, int, int, int], ...]:
        """Letter, row, column and lag of each parameter; the column of C and D equals the row."""
        return tuple(
            (letter, i, k, first + n)
            for letter, i, k, first, p in self._parts()
            for n in range(p.size)
        )

    def _parts(self) -> Iterator[tuple[str, int, int, int, Vector]]:
        """Yield letter, row, column, first lag and coefficients of each estimated polynomial."""
        for i in range(len(self.A)):
            for k, a in enumerate(self.A[i]):
                yield "a", i, k, 1, a[1:]
            for j, b in enumerate(self.B[i]):
                yield "b", i, j, self.nk[i][j], b[self.nk[i][j] :]
            yield "c", i, i, 1, self.C[i][1:]
            yield "d", i, i, 1, self.D[i][1:]
            for j, f in enumerate(self.F[i]):
                yield "f", i, j, 1, f[1:]

    def slice_of(self, letter: str, i: int, k: int) -> slice:
        """Return the slice of theta with the coefficients of one polynomial."""
        begin = 0
        for name, row, column, _, p in self._parts():
            if (name, row, column) == (letter, i, k):
                return slice(begin, begin + p.size)
            begin += p.size
        raise InputError(f"the model has no polynomial {letter}[{i}, {k}]")

    @property
    def coupled(self) -> bool:
        """True if an output affects another output: A is not diagonal."""
        return any(a.any() for i, row in enumerate(self.A) for k, a in enumerate(row) if i != k)

    def has(self, i: int, j: int) -> bool:
        """Return whether input j affects output i."""
        return self.coupled or self.B[i][j].size > self.nk[i][j]

    def channel(self, i: int, j: int) -> tuple[Polynomials, Matrix]:
        """Return the polynomials from input j to output i, and their derivatives.

        The derivatives (m, d) are those of the m parameters of the channel with respect to theta.
        """
        if not self.has(i, j):
            raise InputError("this input does not affect this output: nb is 0")
        if self.coupled:
            return self._channel_by_adjugate(i, j)
        columns = {"a": i, "b": j, "c": i, "d": i, "f": j}
        at = np.concatenate(
            [np.r_[self.slice_of(letter, i, k)] for letter, k in columns.items()]
        ).astype(np.int_)
        form = Polynomials.of_channel(
            A=self.A[i][i],
            B=self.B[i][j],
            C=self.C[i],
            D=self.D[i],
            F=self.F[i][j],
            nk=self.nk[i][j],
            integrator=self.integrators[i],
        )
        return form, np.eye(self.theta.size)[at]

    def _channel_by_adjugate(self, i: int, j: int) -> tuple[Polynomials, Matrix]:
        """Return B/F with F = det A and B = row i of adj A times column j of B."""
        # F and B are interpolated from points on a circle. With X = inv(A), the derivatives are
        # d det A = det A tr(X dA) and d (adj A B) = (d det A) X B + det A (X dB - X dA X B).
        ny = len(self.A)
        degrees = [max(a.size - 1 for a in row) for row in self.A]
        degree = sum(degrees)
        last = max(degree - degrees[k] + self.B[k][j].size - 1 for k in range(ny))
        n = max(degree, last) + 1
        x = circle(n, np.linalg.eigvals(self.innovations_form().A))
        A = np.array([[np.polyval(a[::-1], x) for a in row] for row in self.A]).transpose(2, 0, 1)
        b = np.array([np.polyval(self.B[k][j][::-1], x) for k in range(ny)]).T
        X = np.linalg.inv(A)
        det = np.linalg.det(A)
        Xb = np.einsum("tik,tk->ti", X, b)
        d = self.theta.size
        by_det, by_B = np.zeros((2, n, d), dtype=np.complex128)
        for letter, k, m, first, p in self._parts():
            if not p.size or letter not in "ab" or (letter == "b" and m != j):
                continue
            powers = x[:, None] ** (first + np.arange(p.size))
            at = self.slice_of(letter, k, m)
            if letter == "a":
                by_det[:, at] = (det * X[:, m, k])[:, None] * powers
                by_B[:, at] = by_det[:, at] * Xb[:, i, None]
                by_B[:, at] -= (det * X[:, i, k] * Xb[:, m])[:, None] * powers
            else:
                by_B[:, at] = (det * X[:, i, k])[:, None] * powers
        F, B = (coefficients(v, x) for v in (det, det * Xb[:, i]))
        dF, dB = (coefficients(v, x) for v in (by_det, by_B))
        paths = [k for k in range(ny) if self.B[k][j].size > self.nk[k][j]]
        nk = min(self.nk[k][j] + int(k != i) for k in paths)
        form = Polynomials.of_channel(
            B=np.append(np.zeros(nk), B[nk : last + 1]), F=np.append(1.0, F[1 : degree + 1]), nk=nk
        )
        return form, np.vstack([dB[nk : last + 1], dF[1 : degree + 1]])

    def innovations_form(self) -> StateSpace:
        """Return the innovations form; the last states are the noise states of OE and BJ models."""
        rows = [self._row(i) for i in range(len(self.A))]
        ny = len(rows)
        parts = [driven for driven, _ in rows] + [noise for _, noise in rows]
        stack = _stack_blocks(parts)
        C = np.hstack([np.outer(np.eye(ny)[k % ny], p["C"]) for k, p in enumerate(parts)]) + 0.0
        D = np.vstack([p["D"] for p in parts[:ny]])
        # The rows of an ARX model are driven by y = C x + D u + e.
        return StateSpace(
            A=stack["A"] + stack["Y"] @ C,
            B=stack["B"] + stack["Y"] @ D,
            C=C,
            D=D,
            K=stack["K"] + stack["Y"],
            noise_states=sum(p["C"].size for p in parts[ny:]),
        )

    def _row(self, i: int) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the matrices of row i: for the states that u drives, and for the noise states."""
        ny, nu = len(self.A), len(self.B[i])
        D = np.array([b[0] if b.size else 0.0 for b in self.B[i]])
        if all(f.size == 1 for f in self.F[i]) and self.D[i].size == 1:
            n = max(p.size for p in (*self.A[i], *self.B[i], self.C[i])) - 1
            part = _observer(n, nu, ny)
            part["Y"] = -np.column_stack([_tail(a, n) for a in self.A[i]])
            part["B"] = np.column_stack([_tail(b, n) for b in self.B[i]])
            part["K"][:, i] = _tail(self.C[i], n)
            part["D"] = D
            return part, _observer(0, nu, ny)
        # A row with A and with F or D has the responses B/(A F) and C/(A D).
        F = [np.convolve(self.A[i][i], f) for f in self.F[i]]
        below = np.convolve(self.A[i][i], self.D[i])
        blocks = []
        for j, (b, f) in enumerate(zip(self.B[i], F, strict=True)):
            n = max(b.size, f.size) - 1
            block = _observer(n, nu, ny)
            block["A"][:, :1] -= _tail(f, n)[:, None]
            block["B"][:, j] = _tail(b, n) - _tail(f, n) * D[j]
            blocks.append(_with_sum(block) if self.integrators[i] else block)
        driven = _stack_blocks(blocks) | {"C": np.concatenate([p["C"] for p in blocks]), "D": D}
        n = max(self.C[i].size, below.size) - 1
        noise = _observer(n, nu, ny)
        noise["A"][:, :1] -= _tail(below, n)[:, None]
        noise["K"][:, i] = _tail(self.C[i], n) - _tail(below, n)
        return driven, noise


def _observer(n: int, nu: int, ny: int) -> dict[str, Any]:
    """Return the matrices of a chain of n delays, whose first state is the output."""
    return {
        "A": np.eye(n, k=1),
        "B": np.zeros((n, nu)),
        "K": np.zeros((n, ny)),
        "Y": np.zeros((n, ny)),
        "C": np.eye(1, n)[0],
        "D": np.zeros(nu),
    }


def _stack_blocks(blocks: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the matrices of the states of all blocks."""
    return {"A": block_diag(*(p["A"] for p in blocks))} | {
        name: np.vstack([p[name] for p in blocks]) for name in "BKY"
    }


def _with_sum(block: dict[str, Any]) -> dict[str, Any]:
    """Return a block with the sum of all states as its first state; F of the block has a root 1."""
    # In the original coordinates each rounding error would move this root.
    n = block["C"].size
    T, inverse = np.eye(n), np.eye(n)
    T[0], inverse[0, 1:] = 1.0, -1.0
    A = T @ block["A"] @ inverse
    A[0] = np.eye(1, n)[0]
    return block | {"A": A, "B": T @ block["B"], "C": block["C"] @ inverse}


def _tail(p: Vector, n: int) -> Vector:
    """Return the coefficients after the first coefficient, padded with zeros to length n."""
    return np.pad(p[1:], (0, n + 1 - p.size))


def circle(n: int, poles: Any) -> Complex:
    """Return n values of q^-1 on a circle in q that contains all poles."""
    radius = _RADIUS * max(1.0, float(np.max(np.abs(poles), initial=0.0)))
    return np.asarray(np.exp(-2j * np.pi * np.arange(n) / n) / radius)


def coefficients(values: Any, x: Complex) -> Any:
    """Return the n coefficients of the polynomials in q^-1 with the values (n, …) at the points x.

    The points are those of `circle`.
    """
    n = x.size
    powers = np.abs(x[0]) ** np.arange(n)
    transform = np.fft.ifft(values, axis=0).real
    return transform / powers.reshape((n,) + (1,) * (transform.ndim - 1))
