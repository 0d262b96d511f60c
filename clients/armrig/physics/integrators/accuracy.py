"""Error of a method against the step, for a sinusoidal input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf, sin

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

from armrig.physics.integrators.linear_system import exact, require_positive, system
from armrig.physics.integrators.methods import METHODS, method_named
from armrig.physics.integrators.stability import stability_limit
from armrig.physics.integrators.stepping import integrate

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_COMPARED = 2000  # instants at which a long solution is compared with the exact one


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sinusoid:
    """A linear system under u = amplitude sin(omega t), from x0, over `span` seconds."""

    A: Matrix
    """(nx, nx)."""
    B: Matrix
    """(nx, 1)."""
    amplitude: float
    """Of the input, in its unit."""
    omega: float
    """In rad/s."""
    x0: Vector
    """(nx,)."""
    span: float
    """In s."""

    def solve(self, h: float, n: int, method: str) -> tuple[Vector, Matrix]:
        """Return t (n + 1,) and x (n + 1, nx)."""
        return integrate(
            self.A, self.B, lambda t: self.amplitude * sin(self.omega * t), self.x0, h, n, method
        )

    def truth(self, t: ArrayLike) -> Matrix:
        """Return the exact x at the times t, (len(t), nx)."""
        return exact(self.A, self.B, self.amplitude, self.omega, self.x0, t)

    def error(self, h: float, method: str) -> float:
        """Return the largest error over the span, each state against its own largest value."""
        n = max(1, ceil(self.span / h - 1e-9))
        t, x = self.solve(h, n, method)
        seen = np.unique(np.linspace(0, n, min(n, _COMPARED) + 1).round().astype(int))
        right = self.truth(t[seen])
        size = np.abs(right).max(axis=0)
        with np.errstate(over="ignore", invalid="ignore"):
            share = np.abs(x[seen] - right).max(axis=0) / np.where(size > 0, size, 1.0)
        return float(share.max()) if np.isfinite(share).all() else inf


def sinusoid(
    A: ArrayLike,
    B: ArrayLike,
    *,
    amplitude: float = 1.0,
    omega: float,
    x0: ArrayLike | None = None,
    span: float | None = None,
) -> Sinusoid:
    """Return the problem; by default from rest, over three periods of the input.

    Raises
    ------
    ValueError
        A shape or a number is impossible.
    """
    A_, B_, x0_ = system(A, B, x0)
    require_positive(omega=omega)
    if B_.shape[1] != 1:
        raise InputError(f"B has shape {B_.shape}; one input is allowed")
    span = 3 * 2 * np.pi / omega if span is None else span
    require_positive(span=span)
    return Sinusoid(A=A_, B=B_, amplitude=amplitude, omega=omega, x0=x0_, span=span)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Convergence:
    """How the error of one method falls with the step."""

    method: str
    """As `integrate` takes it."""
    h: Vector
    """Steps in s, falling."""
    error: Vector
    """Largest error over the span at each step; inf where it grew without bound."""
    limit: float
    """Largest absolutely stable step, in s."""

    @property
    def orders(self) -> Vector:
        """Observed order between neighbours, log(e1/e2) / log(h1/h2), (len(h) - 1,)."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.diff(np.log(self.error)) / np.diff(np.log(self.h)))

    @property
    def order(self) -> float:
        """Observed order between the two smallest steps."""
        return float(self.orders[-1])


def convergence(problem: Sinusoid, method: str, h: ArrayLike | None = None) -> Convergence:
    """Return the error of a method over steps h; by default from twice the limit in ten halvings.

    Where there is no limit, from a third of the input's period on.
    """
    method_named(method)
    limit = stability_limit(problem.A, method)
    if h is None:
        largest = 2 * limit if 0 < limit < inf else 2 * np.pi / problem.omega / 3
        h = largest * 0.5 ** np.arange(11)
    steps = np.sort(np.asarray(h, dtype=np.float64))[::-1]
    error = np.array([problem.error(float(x), method) for x in steps])
    return Convergence(method=method, h=steps, error=error, limit=limit)


def growth(A: ArrayLike, method: str, h: float, *, n: int = 20_000) -> float:
    """Return how the free motion has grown in the second half of n steps: > 1 is unstable.

    All modes are excited alike; those that stand still (eigenvalues at 0) are subtracted, as the
    largest velocity |x(k+1) - x(k)| is compared, of the last tenth with that of the middle one.
    """
    A_, *_ = system(A, np.zeros(np.shape(A)[0]))
    size = A_.shape[0]
    x0 = np.real(np.linalg.eig(A_)[1].sum(axis=1))
    _, x = integrate(A_, np.zeros(size), lambda t: 0.0, x0, h, n, method)
    with np.errstate(over="ignore", invalid="ignore"):
        speed = np.linalg.norm(np.diff(x, axis=0), axis=1)
    middle, last = (float(speed[k - n // 10 : k].max()) for k in (n // 2, n))
    if not np.isfinite(last):
        return inf
    return last / middle if middle > 0 else 0.0


def all_methods(methods: Sequence[str] | None) -> tuple[str, ...]:
    """Return the methods asked for, all by default."""
    chosen = tuple(METHODS) if methods is None else tuple(methods)
    for name in chosen:
        method_named(name)
    return chosen
