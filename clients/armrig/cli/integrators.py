"""The command that solves the arm's equations step by step (handout 4.1 to 4.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armrig.cli.figures import Plot, check_plot, write_plot
from armrig.cli.next_step import answers_here, for_the_report, free_name, say_next
from armrig.cli.options import Json, Verbose, print_json, say, say_more
from armrig.cli.parameters import AMPLITUDE_V, OMEGA, Amplitude, Omega

if TYPE_CHECKING:
    from armrig.physics.integrators.accuracy import Recommendation, Sinusoid

Methods = Annotated[
    list[str] | None,
    typer.Option(
        "--method",
        help="Method: forward_euler, ab2, trapezoidal, heun or midpoint; repeatable.",
        show_default="all",
    ),
]
Steps = Annotated[
    list[float] | None,
    typer.Option(
        "--h", metavar="S", help="Step size, in s; repeatable.", show_default="a recommended step"
    ),
]
Span = Annotated[
    float | None,
    typer.Option(
        "--span", metavar="S", help="Length of the solution, in s.", show_default="three periods"
    ),
]

_MAX_STEPS = 2_000_000
_STATE = 2  # the speed, which stays bounded while the angle grows


def integrate(
    method: Methods = None,
    h: Steps = None,
    omega: Omega = OMEGA,
    amplitude: Amplitude = AMPLITUDE_V,
    span: Span = None,
    tolerance: Annotated[
        float, typer.Option("--tolerance", help="Largest relative error of a recommended step.")
    ] = 1e-3,
    json: Json = False,
    plot: Plot = None,
    verbose: Verbose = False,
) -> None:
    """Solve the arm's equations numerically (handout 4).

    The input is sinusoidal, u = A sin(ωt). Each solution is compared with the exact solution.
    """
    check_plot(plot)
    problem = _problem(amplitude=amplitude, omega=omega, span=span)
    solved = _solved(problem, method or (), h or (), tolerance)
    _plot_solutions(solved, plot)
    if json:
        _print_json(solved)
    else:
        given = "" if omega == OMEGA else f" --omega {omega:g}"
        given += "" if amplitude == AMPLITUDE_V else f" --amplitude {amplitude:g}"
        _print_table(solved, verbose=verbose)
        values = {"files": for_the_report(), "answers": answers_here(), "report": free_name()}
        say_next("integrate", **values, sinusoid=given)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    """Result of one method at one step."""

    method: str
    h: float
    limit: float
    """Largest step for which the method is stable, in s."""
    stable: bool
    error: float
    """Largest error of a state, relative to the largest value of this state; it may be infinite."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solved:
    """The solutions of a problem."""

    problem: Sinusoid
    rows: list[_Row]
    advice: Recommendation | None
    """Recommended steps; None if the user gave the steps."""


def _problem(*, amplitude: float, omega: float, span: float | None) -> Sinusoid:
    from armrig_core.arm import ArmParameters, arm_matrices

    from armrig.physics.integrators.accuracy import sinusoid

    A, B, _ = arm_matrices(ArmParameters())
    return sinusoid(A, B, amplitude=amplitude, omega=omega, span=span)


def _solved(
    problem: Sinusoid, methods: Sequence[str], steps: Sequence[float], tolerance: float
) -> _Solved:
    """Solve with the given methods or all methods, at the given steps or at recommended steps."""
    from armrig.cli.spinner import spinner
    from armrig.physics.integrators.accuracy import all_methods
    from armrig.physics.integrators.stability import stability_limit

    limits = {m: stability_limit(problem.A, m) for m in all_methods(tuple(methods) or None)}
    for h in steps:
        _check_step(h, problem)
    advice = None
    with spinner("integrating"):
        if steps:
            steps_of = {m: list(steps) for m in limits}
        else:
            advice = _recommended(problem, tuple(limits), tolerance)
            steps_of = {row.method: [row.h] for row in advice.rows}
        rows = [
            _Row(method=m, h=h, limit=limit, stable=h < limit, error=problem.error(h, m))
            for m, limit in limits.items()
            for h in steps_of[m]
        ]
    return _Solved(problem=problem, rows=rows, advice=advice)


def _recommended(problem: Sinusoid, methods: Sequence[str], tolerance: float) -> Recommendation:
    from armrig.physics.integrators.accuracy import recommend_step

    return recommend_step(
        problem.A,
        problem.B,
        omega=problem.omega,
        tolerance=tolerance,
        amplitude=problem.amplitude,
        span=problem.span,
        methods=methods,
    )


def _check_step(h: float, problem: Sinusoid) -> None:
    """Refuse a step that is at most 0, longer than the span, or far too short."""
    if not (isfinite(h) and 0 < h <= problem.span):
        raise typer.BadParameter(
            f"--h {h:g}: a step is > 0 and at most the span, {problem.span:.4g} s"
        )
    if problem.span / h > _MAX_STEPS:
        raise typer.BadParameter(
            f"--h {h:g}: {problem.span / h:.0f} steps; at most {_MAX_STEPS}: "
            "give a larger step, or a shorter --span"
        )


def _plot_solutions(solved: _Solved, plot: Path | None) -> None:
    """Draw the solutions in all rows of the table; each step of --h has its own figure."""
    if plot is None:
        return
    from armrig.physics.integrators.figures import plot_solution

    steps = [{row.method: row.h for row in solved.rows}]
    if solved.advice is None:
        given = dict.fromkeys(row.h for row in solved.rows)
        steps = [{row.method: row.h for row in solved.rows if row.h == h} for h in given]
    write_plot(
        plot,
        height=4.0,
        **{
            f"solution_{k}": partial(
                plot_solution, solved.problem, h, state=_STATE, label="speed [rad/s]"
            )
            for k, h in enumerate(steps, 1)
        },
    )


def _print_json(solved: _Solved) -> None:
    problem = solved.problem
    facts = {"omega": problem.omega, "amplitude": problem.amplitude, "span": problem.span}
    print_json(facts | {"rows": solved.rows})


def _print_table(solved: _Solved, *, verbose: bool) -> None:
    problem = solved.problem
    if solved.advice is not None:
        best = solved.advice.rows[0]
        say(f"least work for an error of {solved.advice.tolerance:g}: {best.method}", bold=True)
    say(
        f"x' = A x + B u, the handout's arm, u = {problem.amplitude:g} sin({problem.omega:g} t) V, "
        f"{problem.span:.4g} s from rest. error: largest error of a state, relative to the "
        "largest value of this state"
    )
    say(f"{'method':14} {'h [s]':>10} {'limit [s]':>10}  {'at h':8} {'error':>10}")
    for row in solved.rows:
        limit = f"{row.limit:10.5g}" if isfinite(row.limit) else f"{'no limit':>10}"
        error = f"{row.error:10.3g}" if isfinite(row.error) else f"{'overflow':>10}"
        stable = "stable" if row.stable else "UNSTABLE"
        say(f"{row.method:14} {row.h:10.4g} {limit}  {stable:8} {error}")
    say("The limit is the largest absolutely stable step (the handout calls it the minimum).")
    if not verbose:
        say_more("the meaning of the limit" + ", the reason for each step" * bool(solved.advice))
        return
    say(
        "At a larger step h, h λ is outside the method's region of stability for an eigenvalue λ "
        "of A."
    )
    if solved.advice is not None:
        say(solved.advice.explain())
