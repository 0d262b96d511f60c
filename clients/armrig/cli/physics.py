"""The commands that compare a recording with the physics: greybox, split, simulate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from armrig_core.errors import InputError
from armrig_core.telemetry import THETA_1, ChannelName

from armrig.cli.channels import names, recorded_outputs
from armrig.cli.chosen_recording import File, recording_path
from armrig.cli.comparison import print_comparison, row_facts
from armrig.cli.figures import Plot, check_plot, write_plot
from armrig.cli.next_step import say_next, typed
from armrig.cli.options import (
    Json,
    Verbose,
    echo,
    fields_of,
    print_json,
    say,
    say_answer,
    say_more,
)
from armrig.cli.parameters import PARAMETERS, Given, cases, parameters, physics_beside
from armrig.cli.recorded_data import SignalChoice, reads_part

if TYPE_CHECKING:
    from armrig_core.arm import ArmParameters

    from armrig.data.dataset import Dataset
    from armrig.models.fit import Fit
    from armrig.physics.grey_box.fit import GreyFit
    from armrig.physics.grey_box.split_study import SplitStudy
    from armrig.recordings.recording import Recording

GreySignal = Annotated[ChannelName, typer.Option("--signal", help="Output to fit.")]
GreySignals = Annotated[
    list[str] | None,
    typer.Option(
        "--signal",
        metavar="NAME",
        help="Output to fit, theta_1 or alpha; repeatable, for both outputs together.",
        show_default="theta_1",
    ),
]
Free = Annotated[
    list[str] | None,
    typer.Option(
        "--free",
        metavar="NAME",
        help=f"Parameter to estimate ({PARAMETERS}); repeatable.",
        show_default="J_1",
    ),
]
Studied = Annotated[
    list[str] | None,
    typer.Option(
        "--free",
        metavar="NAME",
        help=f"Parameter to estimate ({PARAMETERS}); repeatable; estimates of the first "
        "parameter are compared.",
        show_default="J_1",
    ),
]
Rig = Annotated[
    Literal["chassis", "arm"] | None,
    typer.Option(
        "--model",
        help="Rig without its rotating part (chassis) or complete rig (arm).",
        show_default="from alpha",
    ),
]
Friction = Annotated[
    Literal["viscous", "coulomb", "both"] | None,
    typer.Option(
        "--friction", help="Friction to estimate in addition; the handout neglects friction."
    ),
]


@reads_part
def greybox(
    *,
    file: File,
    model: Rig = None,
    free: Free = None,
    friction: Friction = None,
    given: Given = None,
    signal: GreySignals = None,
    part: SignalChoice,
    json: Json = False,
    verbose: Verbose = False,
    plot: Plot = None,
) -> None:
    """Estimate J_1 or other physical parameters (handout 3.5).

    To record the data for J_1, remove the rotating part and run `armrig collect greybox`.
    """
    from armrig.cli.spinner import spinner
    from armrig.physics.grey_box.estimate import greybox as estimate
    from armrig.recordings.usability import emulation

    check_plot(plot, [file])
    fixed = parameters(given)
    [recording] = part.recordings(file)
    model = _rig(recording, model)
    outputs = recorded_outputs(names("--signal", ",".join(signal or ())) or (THETA_1,))
    shown = THETA_1 if THETA_1 in outputs else outputs[0]
    data = recording.dataset(shown)
    signals: Any = data if len(outputs) == 1 else recording.signals(outputs)
    with spinner("estimating"):
        fit = estimate(
            signals, _model(model), tuple(free or ("J_1",)), fixed, shown, friction=friction
        )
    fit.require_result()
    write_plot(plot, greybox=lambda ax: fit.plot(data, ax=ax), height=4.5)
    if json:
        print_json({"recording": data.source, "model": model} | _grey_facts(fit))
        return
    say_answer(fit.explain())
    if verbose:
        say(repr(fit))
    else:
        say(repr(fit).partition("\n")[0])
    for text in emulation([recording]):
        say(text, dim=True)
    say_next("greybox", file=typed(file), given=part.options(data))


def _grey_facts(fit: GreyFit) -> dict[str, Any]:
    from armrig.physics.grey_box.sampled_model import UNITS

    parameters = {
        name: {
            "value": fit.values[name],
            "std": fit.std[name],
            "std_robust": fit.std_robust[name],
            "unit": UNITS.get(name, ""),
        }
        for name in fit.names
    }
    return {
        "parameters": parameters,
        "influence": fit.influence,
        "outputs": {name: q.fit_percent for name, q in fit.by_output.items()},
        **fields_of(fit, "fit_percent loss"),
        "p_white": fit.whiteness,
        "whiteness_test": fit.whiteness_test,
        **fields_of(fit, "N Ts converged warnings"),
    }


@reads_part
def split(
    *,
    file: File,
    parts: Annotated[
        str,
        typer.Option(
            "--parts", metavar="K,…", help="Numbers of parts into which the recording is cut."
        ),
    ] = "1,2,4",
    model: Rig = None,
    free: Studied = None,
    given: Given = None,
    signal: GreySignal = THETA_1,
    part: SignalChoice,
    json: Json = False,
    verbose: Verbose = False,
    plot: Plot = None,
) -> None:
    """Estimate a parameter from parts of a recording (handout 3.6).

    The command shows whether the estimates from halves and quarters agree within their standard
    deviations.
    """
    from armrig.cli.spinner import spinner
    from armrig.physics.grey_box.estimate import greybox
    from armrig.physics.grey_box.split_study import split_study

    check_plot(plot, [file])
    cuts, fixed = _cuts(parts), parameters(given)
    [recording] = part.recordings(file)
    model = _rig(recording, model)
    data = recording.dataset(signal)
    rig = _model(model)

    def estimate(part: Dataset) -> Any:
        return greybox(part, rig, tuple(free or ("J_1",)), fixed, signal)

    with spinner("estimating") as progress:
        study = split_study(data, cuts, estimate, progress=progress)
    write_plot(plot, split=lambda ax: study.plot(ax=ax), height=5.0)
    if json:
        print_json({"recording": data.source} | _split_facts(study))
        return
    say_answer(study.explain() if verbose else study.verdict)
    echo(repr(study))
    say_next("split")


def _split_facts(study: SplitStudy) -> dict[str, Any]:
    splits = [
        {
            "parts": s.k,
            "N": s.N.tolist(),
            "values": s.values.tolist(),
            "std": s.std.tolist(),
            "pooled": s.pooled,
            "scaled_std": s.scaled_std,
            "chi2": s.chi2,
            "p_value": s.p_value,
        }
        for s in study.splits
    ]
    return {"parameter": study.parameter, "splits": splits, "exponent": study.exponent}


@reads_part
def simulate(
    *,
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="F", parser=recording_path, help="Recording with the input of the simulation."
        ),
    ] = None,
    model: Annotated[
        list[Path] | None,
        typer.Option(
            "--model", metavar="JSON", help="Additional model file to simulate; repeatable."
        ),
    ] = None,
    given: Given = None,
    part: SignalChoice,
    json: Json = False,
    plot: Plot = None,
    verbose: Verbose = False,
) -> None:
    """Simulate the physical model and saved models (handout 3.4).

    The input comes from a recording. Without a recording, the command shows the response of the
    physical model to a step of 1 V (handout 2.2).
    """
    physics = physics_beside(given)
    check_plot(plot, [f for f in (file, *(model or ())) if f is not None])
    if file is None:
        for given_option in ["--model"] * bool(model) + part.given():
            option = given_option.partition(" ")[0]
            raise typer.BadParameter(
                f"{option} needs a recording F: armrig simulate F simulates the response to its "
                "input"
            )
        _step(cases(given), json=json, plot=plot, verbose=verbose)
        return
    from armrig.cli.spinner import spinner
    from armrig.models.model_file import load_fit
    from armrig.physics.systems import physical_model
    from armrig.validation.comparison import compare
    from armrig.validation.figures import plot_compare

    data = part.recordings(file)[0].dataset()
    saved = map(load_fit, model or ())
    fits: list[Fit] = [fit if (fit.ny, fit.nu) == (1, 1) else fit[data.output] for fit in saved]
    fits += [physical_model(p, data) for p in physics.values()]
    labels = [*(path.stem for path in model or ()), *physics]
    with spinner("simulating"):
        table = compare(data, *fits, labels=labels)
    write_plot(
        plot, compare=lambda ax: plot_compare(data, *fits, labels=labels, table=table, ax=ax)
    )
    if json:
        print_json({"recording": data.source, "models": [row_facts(rows) for rows in table.models]})
        return
    how = f"; {table.note}" if verbose else ""
    print_comparison(table, f"on {typed(file)}{how}", verbose=verbose)
    say_next("simulate F", file=typed(file), given=part.options(data))


def _step(
    compared: dict[str, ArmParameters], *, json: bool, plot: Path | None, verbose: bool
) -> None:
    from armrig.physics.figures import plot_physical_step
    from armrig.physics.step_response import characteristics

    found = characteristics(list(compared.values())[-1])
    write_plot(plot, step=lambda ax: plot_physical_step(compared, ax=ax))
    if json:
        roots = {
            name: [[z.real, z.imag] for z in getattr(found, name).tolist()]
            for name in ("poles", "zeros")
        }
        figures = ("steady_speed", "initial_slope", "rigid_slope")
        print_json({name: getattr(found, name) for name in figures} | roots)
        return
    say_answer(found.explain() if verbose else found.brief())
    if not verbose:
        say_more("the meaning of each number")
    say_next("simulate")


def _rig(
    recording: Recording, model: Literal["chassis", "arm"] | None
) -> Literal["chassis", "arm"]:
    """Return "arm" or "chassis", as the recorded alpha shows; refuse another --model."""
    from armrig.recordings.findings import alpha_moves

    seen: Literal["chassis", "arm"] = "arm" if alpha_moves(recording) else "chassis"
    if model is not None and model != seen:
        what = (
            "alpha moves: the arm was attached"
            if seen == "arm"
            else "alpha rests: the arm was removed"
        )
        raise InputError(
            f"{recording.path}: --model {model}, but {what}; leave --model out, or record the "
            f"{model} (`armrig collect greybox` is for the chassis alone)"
        )
    return seen


def _model(name: str) -> Any:
    from armrig.physics.systems import arm, chassis

    return {"chassis": chassis, "arm": arm}[name]


def _cuts(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(k) for k in text.split(","))
    except ValueError as err:
        raise typer.BadParameter(
            f"--parts {text!r}: give whole numbers with commas, such as 1,2,4"
        ) from err
