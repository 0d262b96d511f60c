"""Sections 2 and 4 of the handout: results from the equations alone."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import isfinite
from typing import Any

import numpy as np
from armrig_core.rig.arm import ArmParameters, arm_matrices
from armrig_core.telemetry.channels import CHANNELS
from numpy.typing import NDArray

from armrig import plots
from armrig.numerics.quantities import NBSP, digits, join_names, minus, number, plural, power
from armrig.physics.integrators.accuracy import Sinusoid, convergence
from armrig.physics.integrators.methods import method_named
from armrig.physics.integrators.stability import stability_limit
from armrig.physics.step_response import Characteristics, characteristics, step_response
from armrig.plots.captions import symbol_of
from armrig.report.handout_study import METHODS, HandoutStudy
from armrig.report.sections import ReportFigure, ReportTable, Section, figure


def physical_sections(study: HandoutStudy) -> dict[str, Section]:
    """Return sections 2.1 to 2.3 by number."""
    p = ArmParameters()
    step = _step(characteristics(p), study.cases)
    return {"2.1": _model(p), "2.2": step, "2.3": _other_parameters(study.cases)}


def _model(p: ArmParameters) -> Section:
    A, B, _ = arm_matrices(p)
    return Section(
        paragraphs=(
            "Structure: circuit, motor, gear, chassis, spring and arm. With $k = N K_m$ the "
            "equations are:",
            "$ R_m i = u - u_m, quad u_m = k dot(theta)_1, quad Q_E = k i, quad "
            'Q_s = K_"lin" alpha, \\ J_1 dot.double(theta)_1 = Q_E + Q_s, quad '
            "J_2 (dot.double(theta)_1 + dot.double(alpha)) = -Q_s $",
            "State space: three states are needed for the energy of two inertias and a spring, and "
            "$theta_1$ is the fourth state. $i$ and the torques follow from the states and $u$. "
            "With the states $x = (theta_1, alpha, dot(theta)_1, dot(alpha))$ and the motor's "
            "voltage $u$ the rig is linear:",
            f"$ dot(x) = A x + B u, quad A = {_SYMBOLIC_A}, quad "
            "B = vec(0, 0, display(k/(R_m J_1)), display(-k/(R_m J_1))) $",
            "With the handout's values $A$ and $B$ are:",
            f"$ A = {_matrix(A)}, quad B = {_matrix(B)} $",
            "Left out are the inductance, friction ($b_1 = 0$), play and elasticity of the gear, "
            "bending of the arm and the springs' mass.",
        ),
        figures=figure(
            "rig",
            "Parts of the rig, and the quantities between them.",
            1.85,
            plots.plot_rig,
            floats=False,
        ),
    )


_SYMBOLIC_A = (
    "mat(0, 0, 1, 0; 0, 0, 0, 1; "
    '0, display(K_"lin"/J_1), display(-k^2/(R_m J_1)), 0; '
    '0, display(-K_"lin" (J_1 + J_2)/(J_1 J_2)), display(k^2/(R_m J_1)), 0)'
)


def _matrix(M: NDArray[Any]) -> str:
    rows = "; ".join(", ".join(f"{x + 0.0:.4g}" for x in row) for row in M.tolist())
    return f"mat({rows})"


_CHANGE_WORDS = {"both": "Changing both", "all": "Changing all"}
MAX_HIDDEN_CHANGE = 5e-4
"""Largest relative change that is not visible in a number with three digits."""


def _step(traits: Characteristics, cases: dict[str, ArmParameters]) -> Section:
    w = max(traits.poles, key=lambda z: z.imag)
    settled = float(step_response(traits.parameters, np.linspace(0.0, 2.0, 2001))[-1])
    return Section(
        paragraphs=(
            f"After a step of 1 V the simulated speed settles at {settled:.4f} rad/s. The steady "
            f"speed is $1 slash (N K_m)$ = {traits.steady_speed:.4f} rad/(s{NBSP}V). The slope at "
            f"$t = 0$ is $N K_m slash (R_m J_1)$ = {traits.initial_slope:.2f} rad/s².",
            "In steady state nothing accelerates, so torque and current are 0 and $u = u_m$. At "
            "$t = 0$ the chassis is at rest, so there is no back-EMF. The spring is not wound, so "
            "the torque accelerates $J_1$ alone. With a rigid arm the slope would be "
            f"{traits.rigid_slope:.2f} rad/s². Then the arm swings, with poles at {_pole(w)} 1/s.",
            f"The speed reaches 63 % after {1e3 * traits.rise_time:.1f} ms. The equivalent time, "
            f"the area above the response, is {1e3 * traits.equivalent_time:.1f} ms. The time "
            f'constant of the slowest pole, $1 slash abs(op("Re") s)$, is '
            f"{1e3 * traits.slowest_time:.1f} ms. In a first-order system these times are equal.",
        ),
        figures=figure(
            "step",
            "Speed of the chassis after a step of 1 V, with the handout's parameters and with "
            "two of them changed (2.3). Grey: steady speed and slope at 0.",
            2.6,  # the slope at t = 0 is visible below the legend
            partial(plots.plot_physical_step, cases, seconds=0.5),
        ),
    )


def _pole(z: complex) -> str:
    return minus(f"{z.real:.2f}") + f" ± {abs(z.imag):.2f}i"


def _other_parameters(cases: dict[str, ArmParameters]) -> Section:
    traits = {name: characteristics(p) for name, p in cases.items()}
    first, *changed = traits.values()
    effects = "; ".join(
        f"{_CHANGE_WORDS.get(name, name)} {_effect(after, first)}"
        for name, after in zip([*traits][1:], changed, strict=True)
    )
    table = ReportTable(
        caption="Step response, and poles of the swing, for each set of parameters.",
        header=("parameters", "steady speed [rad/(s V)]", "slope [rad/(s² V)]", "poles [1/s]"),
        rows=tuple(
            (
                name,
                f"{c.steady_speed:.4f}",
                f"{c.initial_slope:.2f}",
                _pole(max(c.poles, key=lambda z: z.imag)),
            )
            for name, c in traits.items()
        ),
    )
    return Section(
        paragraphs=(
            f"{effects[0].upper()}{effects[1:]}.",
            "Without friction the steady speed is $1 slash (N K_m)$, independent of inertias, "
            "spring and $R_m$. The slope at $t = 0$ is $N K_m slash (R_m J_1)$, independent of "
            '$J_2$ and $K_"lin"$, since the spring is not yet wound. All parameters move the '
            'poles: the larger $abs(op("Re") s)$, the sooner the swing dies out.',
        ),
        tables=(table,),
    )


def _effect(after: Characteristics, before: Characteristics) -> str:
    """Return a text that compares the step responses after and before a change of parameters."""
    ratios = {
        "steady speed": after.steady_speed / before.steady_speed,
        "slope": after.initial_slope / before.initial_slope,
    }
    moved = [
        f"multiplies the {name} by {digits(r, 3)}"
        for name, r in ratios.items()
        if abs(r - 1) > MAX_HIDDEN_CHANGE
    ]
    kept = [f"the {name}" for name, r in ratios.items() if abs(r - 1) <= MAX_HIDDEN_CHANGE]
    swing, was = (_pole(max(c.poles, key=lambda z: z.imag)) for c in (after, before))
    if kept:
        moved.append(f"does not change {' or '.join(kept)}")
    faster = f"moves the swing's poles from {was} to {swing} 1/s"
    return join_names([*moved, faster])


_METHOD_TEXTS = {
    "forward_euler": "Each step is $x(t+h) = x(t) + h f(t)$. The order is 1, and the region of "
    "stability is $abs(1 + h lambda) <= 1$. The handout asks for a minimum step, but the limit is "
    "a maximum: with a larger step, $h lambda$ of one of the poles is outside the region.",
    "ab2": "Each step is $x(t+h) = x(t) + h (3 f(t) - f(t-h)) slash 2$. The order is 2, with one "
    "evaluation of $f$ per step. The first step is a Heun step.",
    "trapezoidal": "Each step is $x(t+h) = x(t) + h (f(t) + f(t+h)) slash 2$. The order is 2. The "
    "method is implicit: each step solves a linear system. The region of stability is the whole "
    "left half-plane, so accuracy alone limits the step.",
    "heun": "Each step has two stages: an Euler step, then "
    "$x(t+h) = x(t) + h (f(t) + f^*(t+h)) slash 2$. $f^*$ is $f$ after the Euler step. The order "
    "is 2, with two evaluations of $f$ per step.",
}


def numerical_sections(study: HandoutStudy) -> dict[str, Section]:
    """Return sections 4.1 to 4.4 by number."""
    problem, methods = study.problem, tuple(METHODS.values())
    speed: dict[str, Any] = {"state": 2, "label": f"{symbol_of(CHANNELS[0].rate)} [rad/s]"}
    figures = {
        "4.1": figure(
            "integrators",
            "(a) Regions of stability, and the arm's hλ at forward Euler's limit; (b) "
            "error against step, with the observed orders.",
            2.4,
            partial(plots.plot_stability_regions, problem.A, methods=methods),
            partial(plots.plot_convergence, [convergence(problem, m) for m in methods]),
        ),
        "4.4": figure(
            "solution",
            "(a) The speed by each method at h = 20 ms; (b) the errors.",
            2.1,
            partial(plots.plot_solution, problem, 0.02, methods=methods, **speed),
            floats=False,
        ),
    }
    return {
        number_: _integrator(study, name, figures.get(number_, ()))
        for number_, name in METHODS.items()
    }


def _integrator(study: HandoutStudy, name: str, figures: tuple[ReportFigure, ...]) -> Section:
    problem = study.problem
    limit = stability_limit(problem.A, name)
    (advice,) = (row for row in study.steps.rows if row.method == name)
    h, steps, edge = advice.h, study.steps, "Every step is stable"
    tried = {h, 2 * h, 4 * h}
    if isfinite(limit):
        edge = f"The largest stable step is {1e3 * limit:.3f} ms"
        tried |= {0.98 * limit, 1.1 * limit}
    return Section(
        paragraphs=(
            f"{edge}. A step of {number(1e3 * h)} ms keeps the error of each state below "
            f"{100 * steps.tolerance:g} % of its largest value. The error is computed for "
            f"{plural(advice.steps, 'step')} over {digits(problem.span, 3)} s with "
            f"$u = {problem.amplitude:g} sin({problem.omega:g} t)$ V, against the exact solution.",
            _METHOD_TEXTS[name],
        ),
        tables=(_errors(problem, name, sorted(tried), limit),),
        figures=figures,
    )


def _errors(problem: Sinusoid, name: str, steps: Sequence[float], limit: float) -> ReportTable:
    """Return a table of the largest error at each step, relative to the states' largest values."""
    errors = [problem.error(h, name) for h in steps]
    marks = [f"{number(1e3 * h)}{'' if h <= limit else ' (unstable)'}" for h in steps]
    return ReportTable(
        caption=f"Largest error of a state, over its largest value: {method_named(name).name}.",
        header=("h [ms]", *marks),
        rows=(("largest error", *(power(e) if isfinite(e) else "overflow" for e in errors)),),
    )
