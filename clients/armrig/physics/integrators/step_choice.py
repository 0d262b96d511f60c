"""Which step to take, what it costs, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf, isfinite

from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.physics.integrators.accuracy import Sinusoid, all_methods, sinusoid
from armrig.physics.integrators.linear_system import require_positive
from armrig.physics.integrators.methods import METHODS
from armrig.physics.integrators.stability import stability_limit

_SEARCH_FROM = 0.25  # of the limit, or of the largest step: where the error is already regular
_AIM = 0.97  # of the tolerance
_TRIALS = 8
_MOST_STEPS = 2_000_000  # of a run that verifies a step


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """The step recommended for one method."""

    method: str
    """As `integrate` takes it."""
    h: float
    """Step in s."""
    limit: float
    """Largest absolutely stable step, in s."""
    error: float
    """Largest error over the span at h, as a share of each state's largest value."""
    verified: bool
    """The error was measured; False where it is what the order promises (too many steps)."""
    steps: int
    """Steps for the span."""
    work: int
    """Products with A, or solutions with its factors, for the span."""
    reason: str
    """Why this step."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Recommendation:
    """Steps for several methods that keep to one tolerance."""

    tolerance: float
    """Largest error allowed, as a share of each state's largest value."""
    span: float
    """In s."""
    rows: tuple[Advice, ...]
    """One a method, the cheapest first."""

    def explain(self) -> str:
        """Say for each method which step to take, and why."""
        head = f"For an error of at most {self.tolerance:g} over {self.span:.3g} s:"
        return "\n".join([head, *(f"- {METHODS[r.method].name}: {r.reason}" for r in self.rows)])

    def __repr__(self) -> str:
        """Show the table, cheapest first."""
        head = f"{'method':14} {'h [s]':>10} {'limit [s]':>10} {'h/limit':>8} "
        lines = [head + f"{'error':>9} {'steps':>8} {'work':>8}"]
        for r in self.rows:
            share = f"{r.h / r.limit:8.3f}" if isfinite(r.limit) else f"{'-':>8}"
            lines.append(
                f"{r.method:14} {r.h:10.3g} {r.limit:10.4g} {share} "
                f"{r.error:9.2g} {r.steps:8d} {r.work:8d}"
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
    """Return for each method the largest step that is stable and keeps to the tolerance.

    The step is found from the order (the error falls as h^p) and verified against the exact
    solution for u = amplitude sin(omega t).

    Parameters
    ----------
    A, B, amplitude, omega, x0
        As for `armrig.exact`; x0 is rest by default.
    tolerance : float, default 1e-3
        Largest error over the span, each state against its own largest value; 1e-8 to 0.5.
    span : float, optional
        In s; three periods of the input by default.
    methods : sequence of str, optional
        All by default.

    Raises
    ------
    ValueError
        A number is impossible, or no step of a method is stable.
    """
    require_positive(tolerance=tolerance)
    if not 1e-8 <= tolerance <= 0.5:
        raise InputError(f"tolerance={tolerance!r} must be from 1e-8 (rounding comes near) to 0.5")
    problem = sinusoid(A, B, amplitude=amplitude, omega=omega, x0=x0, span=span)
    rows = sorted(
        (_advice(problem, m, tolerance) for m in all_methods(methods)), key=lambda r: r.work
    )
    return Recommendation(tolerance=tolerance, span=problem.span, rows=tuple(rows))


def _advice(problem: Sinusoid, method: str, tolerance: float) -> Advice:
    limit = stability_limit(problem.A, method)
    if limit == 0:
        raise InputError(
            f"{method} is stable on this system at no step; "
            "take another method, or a system whose motion does not grow"
        )
    largest = min(limit, problem.span / 10)
    h, error, verified = _step_for(problem, method, tolerance, largest)
    steps = max(1, ceil(problem.span / h - 1e-9))
    return Advice(
        method=method,
        h=h,
        limit=limit,
        error=error,
        verified=verified,
        steps=steps,
        work=steps * METHODS[method].work,
        reason=_reason(method, h, limit, error, tolerance)
        + ("" if verified else " The error is what the order promises; it was not run."),
    )


def _step_for(
    problem: Sinusoid, method: str, tolerance: float, largest: float
) -> tuple[float, float, bool]:
    """Return the largest step found that meets the tolerance, its error, and if it was measured."""
    order = METHODS[method].order
    best, best_error = 0.0, inf
    h = _SEARCH_FROM * largest
    for _ in range(_TRIALS):
        if problem.span / h > _MOST_STEPS:
            return h, _AIM * tolerance, False
        error = problem.error(h, method)
        if best < h and error <= tolerance:
            best, best_error = h, error
        if 0.9 * tolerance <= error <= tolerance:
            break
        change = 0.25 if error == inf else (_AIM * tolerance / max(error, 1e-300)) ** (1 / order)
        h = min(h * change, largest)
    while best == 0:  # the order's law alone has not met it
        h /= 2
        error = problem.error(h, method)
        if error <= tolerance:
            best, best_error = h, error
    return best, best_error, True


def _reason(method: str, h: float, limit: float, error: float, tolerance: float) -> str:
    order = METHODS[method].order
    halved = f"it is of order {order}: half the step, a {'half' if order == 1 else 'quarter'} "
    halved += "of the error"
    if limit == inf:
        return (
            f"h = {h:.3g} s gives an error of {error:.2g}. No step is unstable, so accuracy alone "
            f"decides; {halved}."
        )
    share = h / limit
    if share > 0.9 and error < 0.9 * tolerance:
        return (
            f"h = {h:.3g} s, {100 * share:.0f} % of the limit {limit:.4g} s. Stability decides: "
            f"the error of {error:.2g} would allow more."
        )
    return (
        f"h = {h:.3g} s gives an error of {error:.2g}. Accuracy decides: the step is "
        f"{100 * share:.2g} % of the limit {limit:.4g} s; {halved}."
    )
