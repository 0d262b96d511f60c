"""The command `armrig model`, which prints the physical model (handout 2.1 to 2.3)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from armrig_core.telemetry import ALPHA, THETA_1

from armrig.cli.figures import Plot, check_plot, write_plot
from armrig.cli.next_step import say_next
from armrig.cli.options import Json, Verbose, echo, print_json, say
from armrig.cli.parameters import Given, cases, changes

if TYPE_CHECKING:
    from armrig_core.arm import ArmParameters

    from armrig.physics.step_response import Characteristics

_SECONDS = 2.0  # the speed is then steady to five digits
_STEPS = 200_000
_SLOPE_S = 1e-8  # so short that the slope keeps all shown digits
_STATES = (THETA_1, ALPHA, f"{THETA_1}'", f"{ALPHA}'")
_PRIME = "'"
_TOGETHER = {"both": "both changes", "all": "all changes"}
"""Possible headings of the column in which several parameters are changed at once."""
_TIMES = {
    "rise_time": "63 % time [s]",
    "equivalent_time": "equivalent [s]",
    "slowest_time": "slowest pole [s]",
}


def model(
    given: Given = None,
    verbose: Verbose = False,
    plot: Plot = None,
    json: Json = False,
) -> None:
    """Show what the physical model predicts (handout 2.1 to 2.3).

    The command prints A, B, poles, zeros, steady speed and initial slope. With --set, it compares
    the handout's parameters, each change alone and, if there are several changes, all changes
    together.
    """
    check_plot(plot)
    found = {name: _answer(p) for name, p in cases(given).items()}
    last = list(found.values())[-1]
    _draw({name: answer.parameters for name, answer in found.items()}, plot)
    if json:
        print_json({"models": {name: _facts(answer) for name, answer in found.items()}})
        return
    say(f"A and B with {changes(given) or 'the parameters of the handout'}:")
    echo(f"{_state_space(last.parameters)}\n\n{_table(found)}\n")
    say(
        f"A step of 1 V, simulated{_of(given)}: the speed begins to rise by {last.slope:.2f} "
        f"rad/s² and is {last.speed:.4f} rad/s after {_SECONDS:g} s. At t = 0 the chassis rests, "
        "so there is no back-EMF, and the spring has no tension: the torque accelerates J_1."
    )
    _say_later_rises(found, given)
    if verbose:
        say(f"\n{last.predicted.explain()}")
    say_next("model --set" if given else "model")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Answer:
    """Predictions for a set of parameters, and results of the simulated step."""

    predicted: Characteristics
    slope: float
    """Slope of the simulated speed at t = 0, in rad/s²."""
    speed: float
    """Simulated speed at the end, in rad/s."""

    @property
    def parameters(self) -> ArmParameters:
        return self.predicted.parameters


def _answer(p: ArmParameters) -> _Answer:
    import numpy as np

    from armrig.physics.step_response import characteristics, step_response

    speed = step_response(p, np.linspace(0.0, _SECONDS, _STEPS + 1))
    slope = float(step_response(p, [0.0, _SLOPE_S])[-1]) / _SLOPE_S
    return _Answer(predicted=characteristics(p), slope=slope, speed=float(speed[-1]))


def _say_later_rises(found: dict[str, _Answer], given: list[str] | None) -> None:
    """Print the models whose speed crosses 63 % of its steady value only after the first rise."""
    import numpy as np

    from armrig.physics.step_response import step_response

    for name, answer in found.items():
        crossed = answer.predicted.rise_time
        t = np.linspace(0.0, crossed if isfinite(crossed) else 0.0, 1001)
        if np.diff(step_response(answer.parameters, t)).min() < 0:
            of = changes(given) if name in _TOGETHER else name
            rises = "the first rise of the speed ends below 63 %, a later rise crosses 63 %"
            say(f"63 % time of {of}: {rises}.")


def _of(given: list[str] | None) -> str:
    """Return " with " and the changed parameters; "" for the parameters of the handout."""
    return f" with {changes(given)}" if given else ""


def _state_space(p: ArmParameters) -> str:
    """Return x' = A x + B u, with a line for each state."""
    from armrig_core.arm import arm_matrices

    A, B, _ = arm_matrices(p)
    lines = [f"x' = A x + B u  {''.join(f'{name:>10}' for name in _STATES)}       u [V]"]
    for name, row, (b,) in zip(_STATES, A + 0.0, B + 0.0, strict=True):
        by = "".join(f"{a:10.4g}" for a in row)
        lines.append(f"{name + _PRIME:>13} = {by}{b:12.4g}")
    return "\n".join(lines)


def _table(found: dict[str, _Answer]) -> str:
    """Return a table with a column for each model; five columns fit into 80 characters."""
    columns = [["", "steady [rad/s/V]", "slope [rad/s²/V]", *_TIMES.values()]]
    columns[0] += ["poles [1/s]", "", "", "zeros [1/s]"]
    for name, answer in found.items():
        p = answer.predicted
        poles = _roots(p.poles)
        poles += [""] * (3 - len(poles))
        times = [f"{getattr(p, time):.4f}" for time in _TIMES]
        figures = [f"{p.steady_speed:.4f}", f"{p.initial_slope:.2f}", *times, *poles]
        columns.append([_TOGETHER.get(name, name), *figures, *_roots(p.zeros)])
    widths = [max(map(len, column)) for column in columns]
    rows = zip(*columns, strict=True)
    return "\n".join(
        " ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def _roots(roots: Any) -> list[str]:
    """Return roots as texts; a pair is one text."""
    texts = []
    for z in roots.tolist():
        real = f"{z.real:.2f}" if z.real else "0"
        if z.imag > 0:
            texts.append(f"{real} ± {z.imag:.2f}i" if z.real else f"±{z.imag:.2f}i")
        elif z.imag == 0:
            texts.append(real)
    return texts


def _facts(answer: _Answer) -> dict[str, Any]:
    from armrig_core.arm import arm_matrices

    p = answer.predicted
    A, B, _ = arm_matrices(p.parameters)
    return {
        "parameters": asdict(p.parameters),
        "states": _STATES,
        "A": A.tolist(),
        "B": B.tolist(),
        "steady_speed": p.steady_speed,
        "initial_slope": p.initial_slope,
        "rigid_slope": p.rigid_slope,
        "poles": [[z.real, z.imag] for z in p.poles.tolist()],
        "zeros": [[z.real, z.imag] for z in p.zeros.tolist()],
        **{time: getattr(p, time) for time in _TIMES},
        "simulated": {"slope": answer.slope, "speed": answer.speed, "seconds": _SECONDS},
    }


def _draw(compared: dict[str, ArmParameters], plot: Path | None) -> None:
    from armrig.physics.figures import plot_physical_step, plot_sensitivities

    write_plot(
        plot,
        step=lambda ax: plot_physical_step(compared, ax=ax),
        sensitivities=lambda ax: plot_sensitivities(ax=ax),
    )
