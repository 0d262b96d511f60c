"""The command that solves the arm's equations step by step (handout 4.1 to 4.4)."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armrig.cli.figures import Plot, check_plot, write_plot
from armrig.cli.options import Json, print_json, say

if TYPE_CHECKING:
    from armrig.physics.integrators.accuracy import Sinusoid

_MOST_STEPS = 2_000_000
_STATE = 2  # the speed, which shows more than an angle that runs away


def integrate(
    method: Annotated[
        list[str] | None,
        typer.Option(
            "--method",
            help="forward_euler, ab2, trapezoidal, heun, midpoint; repeatable; all by default.",
        ),
    ] = None,
    h: Annotated[
        list[float] | None,
        typer.Option(
            "--h", metavar="S", help="Step; may be repeated. By default one is recommended."
        ),
    ] = None,
    omega: Annotated[float, typer.Option("--omega", help="Of the input, in rad/s.")] = 10.0,
    amplitude: Annotated[float, typer.Option("--amplitude", help="Of the input, in V.")] = 2.5,
    span: Annotated[
        float | None,
        typer.Option("--span", metavar="S", help="Length.", show_default="three periods"),
    ] = None,
    tolerance: Annotated[
        float, typer.Option("--tolerance", help="Largest error of a recommended step.")
    ] = 1e-3,
    json: Json = False,
    plot: Plot = None,
) -> None:
    """Solve the arm for a sinusoid by each method (handout 4).

    u = A sin(ωt), against the exact solution.
    """
    from armrig_core.arm import ArmParameters, arm_matrices

    from armrig.cli.waiting import waiting
    from armrig.physics.integrators.accuracy import sinusoid
    from armrig.physics.integrators.stability import stability_limit
    from armrig.physics.integrators.step_choice import recommend_step

    check_plot(plot)
    A, B, _ = arm_matrices(ArmParameters())
    problem = sinusoid(A, B, amplitude=amplitude, omega=omega, span=span)
    methods = tuple(dict.fromkeys(method)) if method else None
    limits = {m: stability_limit(A, m) for m in _all(methods)}
    steps = [_checked(x, problem) for x in h or ()]
    with waiting("integrating"):
        advised = None
        if not steps:
            advised = recommend_step(
                A,
                B,
                omega=omega,
                tolerance=tolerance,
                amplitude=amplitude,
                span=span,
                methods=methods,
            )
            steps_of = {r.method: [r.h] for r in advised.rows}
        else:
            steps_of = dict.fromkeys(limits, steps)
        rows: list[dict[str, Any]] = [
            {"method": m, "h": x, "limit": limits[m], "stable": x < limits[m]}
            | {"error": problem.error(x, m)}
            for m in limits
            for x in steps_of[m]
        ]
    if plot is not None:
        from armrig.plots import plot_solution

        shown = max(x for chosen in steps_of.values() for x in chosen)
        write_plot(
            plot,
            lambda ax: plot_solution(
                problem, shown, methods=methods, state=_STATE, label="speed [rad/s]", ax=ax
            ),
            height=5.0,
        )
    if json:
        facts = {"omega": omega, "amplitude": amplitude, "span": problem.span}
        print_json(facts | {"rows": [_finite(row) for row in rows]})
        return
    say(
        f"x' = A x + B u, the handout's arm, u = {amplitude:g} sin({omega:g} t) V, "
        f"{problem.span:.4g} s from rest; error: largest, each state against its own largest value"
    )
    say(f"{'method':14} {'h [s]':>10} {'limit [s]':>10} {'':8} {'error':>10}")
    for row in rows:
        limit = f"{row['limit']:10.5g}" if isfinite(row["limit"]) else f"{'none':>10}"
        error = f"{row['error']:10.3g}" if isfinite(row["error"]) else f"{'overflow':>10}"
        stable = "stable" if row["stable"] else "UNSTABLE"
        say(f"{row['method']:14} {row['h']:10.4g} {limit} {stable:8} {error}")
    if advised is not None:
        say(advised.explain())
    say(
        "The limit is the largest absolutely stable step (the handout calls it the minimum): at a "
        "larger one h λ leaves the method's region of stability for an eigenvalue λ of A."
    )


def _all(methods: Any) -> tuple[str, ...]:
    from armrig.physics.integrators.accuracy import all_methods

    return all_methods(methods)


def _checked(h: float, problem: Sinusoid) -> float:
    """Refuse a step that is none, or that would take for ever."""
    if not (isfinite(h) and 0 < h <= problem.span):
        msg = f"--h {h:g}: a step is > 0 and at most the span, {problem.span:.4g} s"
        raise typer.BadParameter(msg)
    if problem.span / h > _MOST_STEPS:
        msg = (
            f"--h {h:g}: {problem.span / h:.0f} steps; at most {_MOST_STEPS}: take a larger step, "
        )
        msg += "or a shorter --span"
        raise typer.BadParameter(msg)
    return h


def _finite(row: dict[str, Any]) -> dict[str, Any]:
    """Return the row with null for what is not finite, as JSON has no other word."""
    return {k: None if isinstance(v, float) and not isfinite(v) else v for k, v in row.items()}
