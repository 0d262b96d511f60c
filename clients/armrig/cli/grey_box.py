"""The commands that estimate physical parameters: greybox, split."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import numpy as np
import typer
from armrig_core.errors import InputError
from armrig_core.process.options import option, preset
from armrig_core.rig.calibration import THETA_1, ChannelName

import armrig
from armrig.cli import recorded_data
from armrig.cli.next_step import command_line_name, say_next
from armrig.cli.printing import echo, fields_of, say, say_answer, spinner, tell
from armrig.cli.results import Shown
from armrig.numerics.quantities import error, join_names

if TYPE_CHECKING:
    from armrig.physics.grey_box.split_study import SplitStudy
from armrig.cli.physics import PARAMETERS, Given, parameters

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
