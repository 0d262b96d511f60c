"""Error of an integration method against the step, for a sinusoidal input."""

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

_MAX_COMPARED_INSTANTS = 2000  # at which a long solution is compared with the exact solution


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sinusoid:
    """A linear system with u = amplitude sin(omega t), from x0, over `span` seconds."""

    A: Matrix
    """System matrix (nx, nx), in 1/s."""
    B: Matrix
    """Input matrix (nx, 1)."""
    amplitude: float
    """Amplitude of the input, in its unit."""
    omega: float
    """Angular frequency, in rad/s."""
    x0: Vector
    """Initial state (nx,)."""
    span: float
    """Duration, in s."""

    def solve(self, h: float, n: int, method: str) -> tuple[Vector, Matrix]:
        """Return times t (n + 1,) and states x (n + 1, nx), computed in n steps of size h."""
        return integrate(
            self.A, self.B, lambda t: self.amplitude * sin(self.omega * t), self.x0, h, n, method
        )

    def truth(self, t: ArrayLike) -> Matrix:
        """Return the exact x at the times t, (len(t), nx)."""
        return exact(self.A, self.B, self.amplitude, self.omega, self.x0, t)

    def error(self, h: float, method: str) -> float:
        """Return the largest error over the span, relative to the largest value of each state."""
        n = max(1, ceil(self.span / h - 1e-9))
        t, x = self.solve(h, n, method)
        seen = np.unique(np.linspace(0, n, min(n, _MAX_COMPARED_INSTANTS) + 1).round().astype(int))
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
    """Return a `Sinusoid` with checked values; by default, x0 is 0 and span is three input periods.

    Raises
    ------
    ValueError
        A shape or a number is not allowed.

    Examples
    --------
    >>> import armrig
    >>> problem = armrig.sinusoid([[-5.0]], [1.0], omega=2.0)
    >>> for h in (0.1, 0.05):
    ...     print(f"h = {h} s: error {100 * problem.error(h, 'heun'):.1f} %")
    h = 0.1 s: error 1.2 %
    h = 0.05 s: error 0.3 %
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
    """Error of one method as a function of the step."""

    method: str
    """Name of the method, as for `integrate`."""
    h: Vector
    """Steps in s, in falling order."""
    error: Vector
    """Error at each step size, as from `Sinusoid.error`; inf if the solution overflowed."""
    limit: float
    """Largest absolutely stable step, in s."""

    @property
    def orders(self) -> Vector:
        """Observed order between neighbouring steps, log(e1/e2) / log(h1/h2), (len(h) - 1,)."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.diff(np.log(self.error)) / np.diff(np.log(self.h)))

    @property
    def order(self) -> float:
        """Observed order between the two smallest steps."""
        return float(self.orders[-1])


def convergence(problem: Sinusoid, method: str, h: ArrayLike | None = None) -> Convergence:
    """Return the error of a method for steps h.

    By default the largest step is twice the stability limit. If the limit is 0 or infinite, the
    largest step is a third of the input's period. Ten more steps follow, each half as long as the
    previous step.

    Examples
    --------
    >>> import armrig
    >>> problem = armrig.sinusoid([[-5.0]], [1.0], omega=2.0)
    >>> for method in ("forward_euler", "heun"):
    ...     found = armrig.convergence(problem, method, h=[0.02, 0.01, 0.005])
    ...     print(f"{method}: order {found.order:.1f}, stable up to {found.limit:.1f} s")
    forward_euler: order 1.0, stable up to 0.4 s
    heun: order 2.0, stable up to 0.4 s
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
    """Return the growth of the free motion over the second half of n steps; > 1 is unstable.

    The initial state excites all modes equally. The largest |x(k+1) - x(k)| is computed in two
    intervals of n/10 steps: just before the middle, and at the end. The growth is the value at the
    end divided by the value at the middle. Constant modes (eigenvalues at 0) cause no differences.
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
    """Return the names of the given methods, or of all methods for None."""
    chosen = tuple(METHODS) if methods is None else tuple(methods)
    if not chosen:
        raise InputError(f"methods is empty; give at least one of {', '.join(METHODS)}")
    for name in chosen:
        method_named(name)
    return chosen
