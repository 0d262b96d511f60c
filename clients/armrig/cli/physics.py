"""The commands on the rig's equations: model, simulate."""

from __future__ import annotations

import re
from dataclasses import asdict, fields, replace
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from armrig_core.errors import InputError
from armrig_core.process.options import option, preset
from armrig_core.rig.calibration import ALPHA, THETA_1

import armrig
from armrig.cli import recorded_data
from armrig.cli.next_step import command_line_name, say_next
from armrig.cli.printing import columns, echo, fields_of, say, spinner, tell
from armrig.cli.results import Draw, OutputOptions, output_group
from armrig.numerics.quantities import digits

if TYPE_CHECKING:
    from armrig.models.fit import Fit
    from armrig.physics.step_response import Characteristics


def _check_units(settings: list[str] | None) -> list[str] | None:
    """Return the parameters unchanged; print the parameters that are probably not in SI units."""
    for name, value in _values(settings).items():
        handout = getattr(armrig.physics.ArmParameters(), name)
        if handout and value > 0 and not 1 / _MAX_RATIO <= value / handout <= _MAX_RATIO:
            tell(
                f"--set {name}={value:g}: this is {digits(value / handout, 2)} times the value of "
                f"the handout, {handout:g}; is it in SI units?"
            )
    return settings


PARAMETERS = "J_1, J_2, N, K_lin, R_m, K_m or b_1"
"""Names of the parameters of `ArmParameters` for the help, which must not import numpy."""
OF_CHANGES = option(
    "--set NAME=VALUE", f"Value of {PARAMETERS}, in SI units; repeatable.", callback=_check_units
)
Given = Annotated[list[str] | None, OF_CHANGES]
_WITH_UNIT = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)? ?[^\d,.\s]")
_MAX_RATIO = 100.0
"""Ratio of a parameter to the handout's value, or the inverse, above which a note is printed."""


def parameters(settings: list[str] | None) -> armrig.physics.ArmParameters:
    """Return the parameters of the handout with the given changes."""
    return replace(armrig.physics.ArmParameters(), **_values(settings))


def cases(settings: list[str] | None) -> dict[str, armrig.physics.ArmParameters]:
    """Return the parameters by case (handout 2.3): no change, each change alone, all changes."""
    from armrig.physics.systems import beside_the_handout

    return beside_the_handout(parameters(settings))


def physics_beside(settings: list[str] | None) -> dict[str, armrig.physics.ArmParameters]:
    """Return the physical models to compare: the handout's model, and the changed model if any."""
    from armrig.physics.systems import HANDOUT

    handout = parameters(None)
    return (
        {HANDOUT: handout, changes(settings): parameters(settings)}
        if settings
        else {"physics": handout}
    )


def changes(settings: list[str] | None) -> str:
    """Return the changes as a label; "" without a change."""
    return ", ".join(f"{name}={value:g}" for name, value in _values(settings).items())


def _values(settings: list[str] | None) -> dict[str, float]:
    names = [f.name for f in fields(armrig.physics.ArmParameters)]
    values: dict[str, float] = {}
    for text in settings or ():
        name, _, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = None
        if name in names and value is None and _WITH_UNIT.match(number):
            from armrig.physics.grey_box.physical_models import UNITS

            unit = f", in {UNITS[name]}" if UNITS[name] else ""
            msg = f"--set {text}: give the number alone{unit}, such as "
            raise typer.BadParameter(
                f"{msg}--set {name}={getattr(armrig.physics.ArmParameters(), name):g}"
            )
        if name not in names or value is None:
            raise typer.BadParameter(
                f"--set {text}: give NAME=VALUE, such as J_1=0.0017; names are {', '.join(names)}"
            )
        values[name] = value
    return values


def simulate(
    *,
    file: recorded_data.File,
    model: list[Path] | None = preset(
        None, "Additional model file to simulate; repeatable.", metavar="JSON"
    ),
    settings: Given = None,
    part: recorded_data.Part,
    out: Annotated[OutputOptions, output_group("json", "plot", "verbose")],
) -> None:
    """Simulate saved models, and the arm (handout 3.4).

    The input comes from the recording.
    """
    from armrig.cli import model_output

    recording = part.recordings(file)[0]
    data, described = recording.dataset(), recording.description
    if not described.arm and (settings or not model):
        raise InputError(
            f"{command_line_name(file)} is of the rig '{described.title}', and the physical "
            "model with its "
            "--set is the arm's: give --model JSON, a model that `armrig identify --save` wrote"
        )
    physics = physics_beside(settings) if described.arm else {}
    saved = map(armrig.load_fit, model or ())
    fits: list[Fit] = [fit if (fit.ny, fit.nu) == (1, 1) else fit[data.output] for fit in saved]
    fits += [armrig.physics.physical_model(p, data) for p in physics.values()]
    labels = [*(path.stem for path in model or ()), *physics]
    with spinner("simulating"):
        table = armrig.compare(data, *fits, labels=labels)
    where = f"on {command_line_name(file)}" + (f"; {table.note}" if out.verbose else "")
    out.show(
        facts=lambda: {
            "recording": data.source,
            "models": [*map(model_output.row_facts, table.models)],
        },
        say=lambda: model_output.print_comparison(table, where, verbose=out.verbose),
        figures=lambda: {"compare": table.plot},
        say_next=lambda: say_next("check", file=command_line_name(file), given=part.options(data)),
    )


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
    settings: Given = None,
    *,
    out: Annotated[OutputOptions, output_group("verbose", "plot", "json")],
) -> None:
    """Show what the physical model predicts (handout 2.1 to 2.3).

    The command prints A, B, poles, zeros, steady speed and initial slope. With --set, it compares
    the handout's parameters, each change alone and, if there are several changes, all changes
    together.
    """
    compared = cases(settings)
    predictions = {name: armrig.physics.characteristics(p) for name, p in compared.items()}
    out.show(
        facts=lambda: {"models": {name: _model_facts(one) for name, one in predictions.items()}},
        say=lambda: _say_model(predictions, settings, verbose=out.verbose),
        figures=lambda: _model_figures(compared),
        say_next=lambda: say_next("lab" if settings else "model"),
    )


def _say_model(
    predictions: dict[str, Characteristics], texts: list[str] | None, *, verbose: bool
) -> None:
    last = [*predictions.values()][-1]
    simulated, changed = _simulate_step(last.parameters), changes(texts)
    say(f"A and B with {changed or 'the parameters of the handout'}:")
    echo(f"{_state_space(last.parameters)}\n\n{_model_table(predictions)}\n")
    say(
        f"A step of 1 V, simulated{f' with {changed}' * bool(texts)}: the speed begins to rise by "
        f"{simulated['slope']:.2f} rad/s² and is {simulated['speed']:.4f} rad/s after "
        f"{simulated['seconds']:g} s. At t = 0 the chassis rests, so there is no back-EMF, and the "
        "spring has no tension: the torque accelerates J_1."
    )
    _say_later_rises(predictions, texts)
    if verbose:
        say(f"\n{last.explain()}")


def _simulate_step(p: armrig.physics.ArmParameters) -> dict[str, float]:
    """Return the slope at t = 0 in rad/s², the last speed in rad/s and its time after a step."""
    from armrig.physics.step_response import step_response

    speed = step_response(p, np.linspace(0.0, _SECONDS, _STEPS + 1))
    slope = float(step_response(p, [0.0, _SLOPE_S])[-1]) / _SLOPE_S
    return {"slope": slope, "speed": float(speed[-1]), "seconds": _SECONDS}


def _say_later_rises(predictions: dict[str, Characteristics], settings: list[str] | None) -> None:
    """Print the models whose speed crosses 63 % of its steady value only after the first rise."""
    from armrig.physics.step_response import step_response

    for name, p in predictions.items():
        t = np.linspace(0.0, p.rise_time if isfinite(p.rise_time) else 0.0, 1001)
        if np.diff(step_response(p.parameters, t)).min() < 0:
            label = changes(settings) if name in _TOGETHER else name
            rises = "the first rise of the speed ends below 63 %, a later rise crosses 63 %"
            say(f"63 % time of {label}: {rises}.")


def _state_space(p: armrig.physics.ArmParameters) -> str:
    """Return x' = A x + B u, with a line for each state."""
    from armrig_core.rig.arm import arm_matrices

    A, B, _ = arm_matrices(p)
    lines = [f"x' = A x + B u  {''.join(f'{name:>10}' for name in _STATES)}       u [V]"]
    for name, row, (b,) in zip(_STATES, A + 0.0, B + 0.0, strict=True):
        by = "".join(f"{a:10.4g}" for a in row)
        lines.append(f"{name + _PRIME:>13} = {by}{b:12.4g}")
    return "\n".join(lines)


def _model_table(predictions: dict[str, Characteristics]) -> str:
    """Return a table with a column for each model; five columns fit into 80 characters."""
    from armrig.physics.step_response import root_texts

    of_models = [["", "steady [rad/s/V]", "slope [rad/s²/V]", *_TIMES.values()]]
    of_models[0] += ["poles [1/s]", "", "", "zeros [1/s]"]
    for name, p in predictions.items():
        poles = root_texts(p.poles, 2)
        poles += [""] * (3 - len(poles))
        times = [f"{getattr(p, time):.4f}" for time in _TIMES]
        figures = [f"{p.steady_speed:.4f}", f"{p.initial_slope:.2f}", *times, *poles]
        of_models.append([_TOGETHER.get(name, name), *figures, *root_texts(p.zeros, 2)])
    return columns([*zip(*of_models, strict=True)], gap=" ")


def _model_facts(p: Characteristics) -> dict[str, Any]:
    from armrig_core.rig.arm import arm_matrices

    A, B, _ = arm_matrices(p.parameters)
    return {
        "parameters": asdict(p.parameters),
        "states": _STATES,
        "A": A,
        "B": B,
        **fields_of(p, "steady_speed initial_slope rigid_slope poles zeros"),
        **{time: getattr(p, time) for time in _TIMES},
        "simulated": _simulate_step(p.parameters),
    }


def _model_figures(compared: dict[str, armrig.physics.ArmParameters]) -> dict[str, Draw]:
    from armrig.physics.figures import plot_physical_step, plot_sensitivities

    return {"step": partial(plot_physical_step, compared), "sensitivities": plot_sensitivities}
