"""Error of an integration method against the step, and the recommended step of each method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf, isfinite, sin

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.data.columns import Matrix, Vector
from armrig.numerics.quantities import digits
from armrig.physics.integrators.methods import METHODS, method_named
from armrig.physics.integrators.stability import stability_limit
from armrig.physics.integrators.stepping import exact, integrate, require_positive, system

_MAX_COMPARED_INSTANTS = 2000  # at which a long solution is compared with the exact solution
_START_SHARE = 0.25  # first step as a share of the largest; smaller steps have an error ~ h^p
_AIMED_SHARE = 0.97  # error that a trial aims at, as a share of the tolerance
_MAX_TRIALS = 8
_MAX_STEPS = 2_000_000  # of a solution that verifies a step


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
    >>> problem = armrig.physics.sinusoid([[-5.0]], [1.0], omega=2.0)
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
    >>> problem = armrig.physics.sinusoid([[-5.0]], [1.0], omega=2.0)
    >>> for method in ("forward_euler", "heun"):
    ...     found = armrig.physics.convergence(problem, method, h=[0.02, 0.01, 0.005])
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


def all_methods(methods: Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of the given methods, or of all methods for None."""
    chosen = tuple(METHODS) if methods is None else tuple(methods)
    if not chosen:
        raise InputError(f"methods is empty; give at least one of {', '.join(METHODS)}")
    for name in chosen:
        method_named(name)
    return chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodAccuracy:
    """Error of one method with one step."""

    method: str
    """Name of the method, as for `integrate`."""
    h: float
    """Step in s."""
    limit: float
    """Largest absolutely stable step, in s."""
    error: float
    """Largest error of a state over the span with the step h, divided by its largest value."""

    @property
    def stable(self) -> bool:
        """True if the method is stable with this step."""
        return self.h < self.limit


@dataclass(frozen=True, slots=True, kw_only=True)
class RecommendedStep(MethodAccuracy):
    """Recommended step of one method."""

    verified: bool
    """True if the error was measured; False if it was estimated from the order of the method."""
    steps: int
    """Number of steps in the span."""
    work: int
    """Number of products with A and of solved systems of equations over the span."""
    reason: str
    """Text with the reason for this step."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Recommendation:
    """Recommended steps of several methods for one tolerance."""

    tolerance: float
    """Largest allowed error, as a share of each state's largest value."""
    span: float
    """Duration, in s."""
    rows: tuple[RecommendedStep, ...]
    """Advice for each method, the cheapest first."""

    def explain(self) -> str:
        """Return a text with the step of each method and its reason."""
        head = f"For an error of at most {self.tolerance:g} over {digits(self.span, 3)} s:"
        return "\n".join([head, *(f"- {METHODS[r.method].name}: {r.reason}" for r in self.rows)])

    def __repr__(self) -> str:
        """Return a table of the methods, the cheapest first."""
        head = f"{'method':14} {'h [s]':>10} {'limit [s]':>10} {'h/limit':>8} "
        lines = [head + f"{'error':>9} {'steps':>8} {'work':>8}"]
        for r in self.rows:
            share = f"{r.h / r.limit:8.3f}" if isfinite(r.limit) else f"{'-':>8}"
            lines.append(
                f"{r.method:14} {digits(r.h, 3):>10} {r.limit:10.4g} {share} "
                f"{digits(r.error, 2):>9} {r.steps:8d} {r.work:8d}"
            )
        return "\n".join(lines)


def recommend_step(
    A: ArrayLike,
    B: ArrayLike,
    *,
    omega: float,
    tolerance: float = 1e-3,
    amplitude: float = 1.0,
    x0: ArrayLike | None = None,
    span: float | None = None,
    methods: Sequence[str] | None = None,
) -> Recommendation:
    """Return for each method the largest stable step with an error within the tolerance.

    The step is computed from the order p of the method, because the error falls as h^p. If the span
    has at most 2 000 000 of these steps, the error is then measured by comparison with the exact
    solution for u = amplitude sin(omega t).

    Parameters
    ----------
    A, B, amplitude, omega, x0
        As for `armrig.physics.exact`; x0 is 0 by default.
    tolerance : float, default 1e-3
        Largest allowed error over the span, relative to the largest value of each state; 1e-8 to
        0.5.
    span : float, optional
        Duration in s; by default three periods of the input.
    methods : sequence of str, optional
        Names of methods; by default all.

    Raises
    ------
    ValueError
        A number is not allowed, `methods` is empty or has an unknown name, or no step of a method
        is stable.

    Examples
    --------
    >>> import armrig
    >>> system = armrig.physics.arm(armrig.physics.ArmParameters())
    >>> found = armrig.physics.recommend_step(system.A, system.B, omega=5.0, tolerance=0.01)
    >>> for row in found.rows:
    ...     print(f"{row.method}: {1000 * row.h:.1f} ms")
    trapezoidal: 12.0 ms
    ab2: 5.6 ms
    heun: 8.1 ms
    midpoint: 8.0 ms
    forward_euler: 0.5 ms
    """
    require_positive(tolerance=tolerance)
    if not 1e-8 <= tolerance <= 0.5:
        raise InputError(
            f"tolerance={tolerance!r} must be from 1e-8 (near the rounding errors) to 0.5"
        )
    problem = sinusoid(A, B, amplitude=amplitude, omega=omega, x0=x0, span=span)
    rows = sorted(
        (_advice(problem, m, tolerance) for m in all_methods(methods)), key=lambda r: r.work
    )
    return Recommendation(tolerance=tolerance, span=problem.span, rows=tuple(rows))


def _advice(problem: Sinusoid, method: str, tolerance: float) -> RecommendedStep:
    limit = stability_limit(problem.A, method)
    if limit == 0:
        raise InputError(
            f"{method} is not stable on this system at any step; "
            "use another method, or a system whose motion does not grow"
        )
    largest = min(limit, problem.span / 10)
    h, error, verified = _step_for(problem, method, tolerance, largest)
    steps = max(1, ceil(problem.span / h - 1e-9))
    return RecommendedStep(
        method=method,
        h=h,
        limit=limit,
        error=error,
        verified=verified,
        steps=steps,
        work=steps * METHODS[method].work,
        reason=_limit_reason(method, h, limit, error, tolerance)
        + ("" if verified else " The error follows from the order; it was not verified."),
    )


def _step_for(
    problem: Sinusoid, method: str, tolerance: float, largest: float
) -> tuple[float, float, bool]:
    """Return the largest step within the tolerance, its error, and True for a measured error."""
    order = METHODS[method].order
    best, best_error = 0.0, inf
    h = _START_SHARE * largest
    for _ in range(_MAX_TRIALS):
        if problem.span / h > _MAX_STEPS:
            return h, _AIMED_SHARE * tolerance, False
        error = problem.error(h, method)
        if best < h and error <= tolerance:
            best, best_error = h, error
        if 0.9 * tolerance <= error <= tolerance:
            break
        change = (
            0.25 if error == inf else (_AIMED_SHARE * tolerance / max(error, 1e-300)) ** (1 / order)
        )
        h = min(h * change, largest)
    while best == 0:  # no step of the trials was within the tolerance
        h /= 2
        error = problem.error(h, method)
        if error <= tolerance:
            best, best_error = h, error
    return best, best_error, True


def _limit_reason(method: str, h: float, limit: float, error: float, tolerance: float) -> str:
    order = METHODS[method].order
    halved = f"the method has order {order}, so half the step has "
    halved += f"a {'half' if order == 1 else 'quarter'} of the error"
    if limit == inf:
        return (
            f"h = {digits(h, 3)} s gives an error of {digits(error, 2)}. No step is unstable, so "
            f"accuracy alone decides; {halved}."
        )
    share = h / limit
    if share > 0.9 and error < 0.9 * tolerance:
        return (
            f"h = {digits(h, 3)} s, {100 * share:.0f} % of the limit {limit:.4g} s. Stability "
            f"decides: the error of {digits(error, 2)} would allow a larger step."
        )
    return (
        f"h = {digits(h, 3)} s gives an error of {digits(error, 2)}. Accuracy decides: the step is "
        f"{digits(100 * share, 2)} % of the limit {limit:.4g} s; {halved}."
    )
