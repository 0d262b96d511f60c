"""The commands on the rig's equations: model, simulate, greybox, split, integrate."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import numpy as np
import typer
from armrig_core.errors import InputError
from armrig_core.process.options import option, preset
from armrig_core.rig.calibration import ALPHA, THETA_1, ChannelName

import armrig
from armrig.cli import recorded_data
from armrig.cli.next_step import command_line_name, say_handout, say_next
from armrig.cli.printing import columns, echo, fields_of, say, say_answer, say_more, spinner, tell
from armrig.cli.results import Draw, OutputOptions, Shown, output_group
from armrig.numerics.quantities import digits, error, join_names

if TYPE_CHECKING:
    from armrig.models.fit import Fit
    from armrig.physics.grey_box.split_study import SplitStudy
    from armrig.physics.integrators.accuracy import MethodAccuracy, Recommendation, Sinusoid
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


def _check_amplitude(volts: float) -> float:
    """Return the amplitude unchanged; print a note if it exceeds the rig's largest input."""
    if not abs(volts) <= AMPLITUDE_V:
        tell(
            f"--amplitude {volts:g}: the sinusoid is only simulated, never played; the rig takes "
            f"0 to 5 V, an amplitude of at most {AMPLITUDE_V:g} V"
        )
    return volts


PARAMETERS = "J_1, J_2, N, K_lin, R_m, K_m or b_1"
"""Names of the parameters of `ArmParameters` for the help, which must not import numpy."""
AMPLITUDE_V, OMEGA = 2.5, 10.0
"""Amplitude in V and frequency in rad/s of the sinusoid of handout part 4."""
OF_CHANGES = option(
    "--set NAME=VALUE", f"Value of {PARAMETERS}, in SI units; repeatable.", callback=_check_units
)
OF_AMPLITUDE = option(
    "--amplitude",
    "Amplitude of the simulated sinusoid, in V.",
    callback=_check_amplitude,
)
OF_OMEGA = option("--omega", "Angular frequency of the sinusoid, in rad/s.")
Given = Annotated[list[str] | None, OF_CHANGES]
Amplitude = Annotated[float, OF_AMPLITUDE]
Omega = Annotated[float, OF_OMEGA]
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


Rig = Literal["chassis", "arm"]


def _rig_or_equations(text: str) -> str:
    if text not in ("chassis", "arm") and not text.endswith(".py"):
        raise typer.BadParameter(
            f"{text}: give chassis, arm, or a Python file that defines `model`, an armrig.Ode"
        )
    return text


OwnModel = Annotated[
    str | None,
    option(
        "--model",
        "Rig without its rotating part (chassis), complete rig (arm), or a Python file with own "
        "equations, which is executed.",
        "chassis if alpha rests, otherwise arm",
        metavar="chassis|arm|FILE.py",
        parser=_rig_or_equations,
    ),
]
Model = Annotated[
    Rig | None,
    option(
        "--model",
        "Rig without its rotating part (chassis) or complete rig (arm).",
        "chassis if alpha rests, otherwise arm",
    ),
]
_FREE = f"Parameter to estimate ({PARAMETERS}); repeatable"


def greybox(
    *,
    file: recorded_data.File,
    model: OwnModel = None,
    free: list[str] | None = preset(None, f"{_FREE}.", "J_1", metavar="NAME"),
    friction: Literal["viscous", "coulomb", "both"] | None = preset(
        None, "Friction to estimate in addition; the handout neglects friction."
    ),
    validate: Path | None = preset(
        None,
        "Data to simulate with the estimates.",
        metavar="F",
        parser=recorded_data.recording_path,
    ),
    settings: Given = None,
    part: Annotated[recorded_data.SignalChoice, recorded_data.data_group(without="assume")],
    out: Shown,
) -> None:
    """Estimate J_1 or other physical parameters (handout 3.5).

    To record the data for J_1, remove the rotating part and run `armrig collect greybox`. With own
    equations, --free names the parameters to estimate, by default all of them.
    """
    from armrig.recordings.usability import emulation

    data: Any
    from_file = model is not None and model.endswith(".py")
    after = replace(part, signal=None)
    if model is not None and from_file:
        for name, value in (("--set", settings), ("--friction", friction)):
            if value:
                raise typer.BadParameter(
                    f"{name} is for chassis and arm: write the value or the friction into the file"
                )
        # The equations contain the level: no hint at means.
        part = replace(part, offset=True)
        data = part.of(file)
        equations = own_equations(Path(model))
        returned = equations.simulate(np.zeros((2, len(data.signals().inputs))), Ts=1.0, steps=1)
        recorded = [*part.read[0].channels] if part.read else []
        if part.signal is None and returned.shape[1] == len(recorded) > 1:
            part = replace(part, signal=",".join(recorded), read=[])
            data = part.of(file)
        recordings = part.read
        other = None if validate is None else part.of(validate)
        for name in free or ():
            if name not in equations.parameters:
                choices = ", ".join(equations.parameters)
                raise typer.BadParameter(f"--free {name}: {model} has the parameters {choices}")
        held = {k: v for k, v in equations.values.items() if k not in (free or equations.values)}
        with spinner("estimating"):
            fit = armrig.greybox(data, equations, fixed=held)
    else:
        fixed = parameters(settings)
        [recording] = recordings = part.recordings(file)
        recorded_data.require_arm(recording)
        model, rig = _rig(recording, cast("Rig | None", model))
        outputs = recorded_data.recording_outputs(recording, part.outputs)
        main_output = THETA_1 if THETA_1 in outputs else outputs[0]
        data = recording.dataset(main_output)
        signals: Any = data if len(outputs) == 1 else recording.signals(outputs)
        other = None
        if validate is not None:
            [second] = part.recordings(validate)
            other = second.dataset(main_output) if len(outputs) == 1 else second.signals(outputs)
        names = tuple(free or ("J_1",))
        with spinner("estimating"):
            fit = armrig.greybox(signals, rig, names, fixed, main_output, friction=friction)
    fit.require_result()
    validation = {} if other is None else _fits_of(fit, other)

    def say_fit() -> None:
        say_answer(fit.explain())
        if validation:
            fits = [
                f"{name} to {x['fit_percent']:.2f} % (rms {error(x['rms_error'], x['unit'])})"
                for name, x in validation.items()
            ]
            record = recorded_data.short_name(cast("Path", validate))
            say(f"Simulated on {record}, it fits {join_names(fits)}.")
        say(repr(fit) if out.verbose else repr(fit).partition("\n")[0])
        for text in emulation(recordings):
            say(text, dim=True)

    out.show(
        facts=lambda: (
            recorded_data.source_facts(data)
            | {"model": model}
            | _grey_facts(fit)
            | ({"validation": validation} if validation else {})
        ),
        say=say_fit,
        figures=lambda: {"greybox": partial(fit.plot, data)},
        say_next=lambda: (
            None
            if from_file
            else say_next("split", file=command_line_name(file), given=after.options(data))
        ),
        height=4.5,
    )


def _fits_of(fit: armrig.GreyFit, data: Any) -> dict[str, dict[str, Any]]:
    """Return fit, rms error and unit of each output, simulated on other data."""
    signals, fits = data.signals(), {}
    for name, unit, y, e in zip(
        signals.outputs, signals.units, signals.y.T, fit.errors(data).T, strict=True
    ):
        valid = np.isfinite(e)
        share = np.linalg.norm(e[valid]) / np.linalg.norm(y[valid] - y[valid].mean())
        rms = float(np.sqrt(np.mean(e[valid] ** 2)))
        fits[name] = {"fit_percent": 100 * float(1 - share), "rms_error": rms, "unit": unit}
    return fits


def own_equations(path: Path) -> armrig.Ode:
    """Execute a model file, and return its `model`."""
    from armrig_core.rig.equations_file import load_equations

    tell(f"executing {path}")
    return load_equations(path)


def _grey_facts(fit: armrig.GreyFit) -> dict[str, Any]:
    parameters = {
        name: {
            "value": fit.values[name],
            "std": fit.std[name],
            "std_robust": fit.std_robust[name],
            "unit": fit.physics.parameters[name].unit,
        }
        for name in fit.names
    }
    return {
        "parameters": parameters,
        "influence": fit.influence,
        "outputs": {name: q.fit_percent for name, q in fit.by_output.items()},
        **fields_of(fit, "fit_percent loss"),
        "p_white": fit.whiteness,
        **fields_of(fit, "whiteness_test N Ts converged warnings"),
    }


def split(
    *,
    file: recorded_data.File,
    parts: str = preset(
        "1,2,4", "Numbers of parts into which the recording is cut.", metavar="K,…"
    ),
    model: Model = None,
    free: list[str] | None = preset(
        None, f"{_FREE}; estimates of the first parameter are compared.", "J_1", metavar="NAME"
    ),
    settings: Given = None,
    signal: ChannelName = preset(THETA_1, "Output to fit."),
    part: recorded_data.Part,
    out: Shown,
) -> None:
    """Estimate a parameter from parts of a recording (handout 3.6).

    The command shows whether the estimates from halves and quarters agree within their standard
    deviations.
    """
    cuts, fixed = _cuts(parts), parameters(settings)
    [recording] = part.recordings(file)
    recorded_data.require_arm(recording)
    data = recording.dataset(signal)
    _, rig = _rig(recording, model)

    def estimate(part: armrig.Dataset) -> Any:
        return armrig.greybox(part, rig, tuple(free or ("J_1",)), fixed, signal)

    with spinner("estimating") as progress:
        study = armrig.split_study(data, cuts, estimate, progress=progress)

    def say_study() -> None:
        say_answer(study.explain() if out.verbose else study.verdict)
        echo(repr(study))

    out.show(
        facts=lambda: {"recording": data.source} | _split_facts(study),
        say=say_study,
        figures=lambda: {"split": study.plot},
        say_next=lambda: say_next("integrate"),
        height=5.0,
    )


def _split_facts(study: SplitStudy) -> dict[str, Any]:
    splits = [
        {"parts": s.k} | fields_of(s, "N values std pooled scaled_std chi2 p_value")
        for s in study.splits
    ]
    return {"parameter": study.parameter, "splits": splits, "exponent": study.exponent}


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


def _rig(recording: armrig.Recording, model: Rig | None) -> tuple[Rig, Any]:
    """Return "arm" or "chassis", as the recorded alpha shows, and its model; refuse another one."""
    from armrig.recordings.findings import second_moves

    moves = second_moves(recording)
    seen: Rig = "arm" if moves else "chassis"
    if model is not None and model != seen:
        evidence = (
            "alpha moves: the arm was attached" if moves else "alpha rests: the arm was removed"
        )
        raise InputError(
            f"{recording.path}: --model {model}, but {evidence}; leave --model out, or record the "
            f"{model} (`armrig collect greybox` is for the chassis alone)"
        )
    return seen, armrig.physics.arm if moves else armrig.physics.chassis


def _cuts(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(k) for k in text.split(","))
    except ValueError as err:
        raise typer.BadParameter(
            f"--parts {text!r}: give whole numbers with commas, such as 1,2,4"
        ) from err


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
_MAX_STEPS = 2_000_000
_STATE = 2  # the speed, which stays bounded while the angle grows


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
    import numpy as np

    from armrig.physics.step_response import step_response

    speed = step_response(p, np.linspace(0.0, _SECONDS, _STEPS + 1))
    slope = float(step_response(p, [0.0, _SLOPE_S])[-1]) / _SLOPE_S
    return {"slope": slope, "speed": float(speed[-1]), "seconds": _SECONDS}


def _say_later_rises(predictions: dict[str, Characteristics], settings: list[str] | None) -> None:
    """Print the models whose speed crosses 63 % of its steady value only after the first rise."""
    import numpy as np

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
