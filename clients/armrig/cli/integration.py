"""The command that integrates the arm's equations numerically: integrate."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import isfinite
from typing import TYPE_CHECKING, Annotated

import typer
from armrig_core.process.options import option, preset

import armrig
from armrig.cli.next_step import say_handout
from armrig.cli.printing import fields_of, say, say_more, spinner, tell
from armrig.cli.results import Draw, OutputOptions, output_group
from armrig.numerics.quantities import digits

if TYPE_CHECKING:
    from armrig.physics.integrators.accuracy import MethodAccuracy, Recommendation, Sinusoid


def _check_amplitude(volts: float) -> float:
    """Return the amplitude unchanged; print a note if it exceeds the rig's largest input."""
    if not abs(volts) <= AMPLITUDE_V:
        tell(
            f"--amplitude {volts:g}: the sinusoid is only simulated, never played; the rig takes "
            f"0 to 5 V, an amplitude of at most {AMPLITUDE_V:g} V"
        )
    return volts


AMPLITUDE_V, OMEGA = 2.5, 10.0
"""Amplitude in V and frequency in rad/s of the sinusoid of handout part 4."""
OF_AMPLITUDE = option(
    "--amplitude",
    "Amplitude of the simulated sinusoid, in V.",
    callback=_check_amplitude,
)
OF_OMEGA = option("--omega", "Angular frequency of the sinusoid, in rad/s.")
Amplitude = Annotated[float, OF_AMPLITUDE]
Omega = Annotated[float, OF_OMEGA]
_MAX_STEPS = 2_000_000
_STATE = 2  # the speed, which stays bounded while the angle grows


def integrate(
    *,
    method: list[str] | None = preset(
        None,
        "Method: forward_euler, ab2, trapezoidal, heun or midpoint; repeatable.",
        "all methods",
    ),
    h: list[float] | None = preset(
        None, "Step size, in s; repeatable.", "the recommended step", metavar="S"
    ),
    omega: Omega = OMEGA,
    amplitude: Amplitude = AMPLITUDE_V,
    span: float | None = preset(
        None, "Length of the solution, in s.", "three periods", metavar="S"
    ),
    tolerance: float = preset(1e-3, "Largest relative error of a recommended step."),
    out: Annotated[OutputOptions, output_group("json", "plot", "verbose")],
) -> None:
    """Solve the arm's equations numerically (handout 4).

    The input is sinusoidal, u = A sin(ωt). Each solution is compared with the exact solution.
    """
    from armrig_core.rig.arm import arm_matrices

    A, B, _ = arm_matrices(armrig.physics.ArmParameters())
    problem = armrig.physics.sinusoid(A, B, amplitude=amplitude, omega=omega, span=span)
    rows, advice = _solve(problem, method or (), h or (), tolerance)

    def say_after() -> None:
        options = "" if omega == OMEGA else f" --omega {omega:g}"
        options += "" if amplitude == AMPLITUDE_V else f" --amplitude {amplitude:g}"
        say_handout(sinusoid=options)

    out.show(
        facts=lambda: (
            fields_of(problem, "omega amplitude span")
            | {"rows": [fields_of(row, "method h limit stable error") for row in rows]}
        ),
        say=lambda: _say_solutions(problem, rows, advice, verbose=out.verbose),
        figures=lambda: _solution_figures(problem, rows, each_step=advice is None),
        say_next=say_after,
        height=4.0,
    )


def _solve(
    problem: Sinusoid, methods: Sequence[str], steps: Sequence[float], tolerance: float
) -> tuple[Sequence[MethodAccuracy], Recommendation | None]:
    """Return the solutions of the methods, by default all, and the recommended steps if any."""
    from armrig.physics.integrators.accuracy import MethodAccuracy, all_methods

    names = all_methods(tuple(methods) or None)
    for h in steps:
        _check_step(h, problem)
    with spinner("integrating"):
        if steps:
            limits = {m: armrig.physics.stability_limit(problem.A, m) for m in names}
            return [
                MethodAccuracy(method=m, h=h, limit=limits[m], error=problem.error(h, m))
                for m in names
                for h in steps
            ], None
        arguments = fields_of(problem, "omega amplitude span")
        advice = armrig.physics.recommend_step(
            problem.A, problem.B, tolerance=tolerance, methods=names, **arguments
        )
    return sorted(advice.rows, key=lambda row: names.index(row.method)), advice


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


def _solution_figures(
    problem: Sinusoid, rows: Sequence[MethodAccuracy], *, each_step: bool
) -> dict[str, Draw]:
    """Return functions that draw all solutions; with `each_step`, a function for each step."""
    from armrig.physics.integrators.figures import plot_solution

    steps = [{row.method: row.h for row in rows}]
    if each_step:
        step_sizes = dict.fromkeys(row.h for row in rows)
        steps = [{row.method: row.h for row in rows if row.h == h} for h in step_sizes]
    draw = partial(plot_solution, problem, state=_STATE, label="speed [rad/s]")
    return {f"solution_{k}": partial(draw, h) for k, h in enumerate(steps, 1)}


def _say_solutions(
    problem: Sinusoid,
    rows: Sequence[MethodAccuracy],
    advice: Recommendation | None,
    *,
    verbose: bool,
) -> None:
    if advice is not None:
        best = advice.rows[0]
        say(f"least work for an error of {advice.tolerance:g}: {best.method}", bold=True)
    say(
        f"x' = A x + B u, the handout's arm, u = {problem.amplitude:g} sin({problem.omega:g} t) V, "
        f"{problem.span:.4g} s from rest. error: largest error of a state, relative to the "
        "largest value of this state"
    )
    say(f"{'method':14} {'h [s]':>10} {'limit [s]':>10}  {'at h':8} {'error':>10}")
    for row in rows:
        limit = f"{row.limit:10.5g}" if isfinite(row.limit) else f"{'no limit':>10}"
        error = f"{digits(row.error, 3):>10}" if isfinite(row.error) else f"{'overflow':>10}"
        stable = "stable" if row.stable else "UNSTABLE"
        say(f"{row.method:14} {row.h:10.4g} {limit}  {stable:8} {error}")
    say("The limit is the largest absolutely stable step (the handout calls it the minimum).")
    if not verbose:
        say_more("the meaning of the limit" + ", the reason for each step" * bool(advice))
        return
    say(
        "At a larger step h, h λ is outside the method's region of stability for an eigenvalue λ "
        "of A."
    )
    if advice is not None:
        say(advice.explain())
