"""The commands that compare a recording with the physics: greybox, split, simulate."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from armrig_core.errors import InputError
from armrig_core.telemetry.telemetry import THETA_1, ChannelName

from armrig.cli.columns import chosen_outputs
from armrig.cli.next_step import say_next, typed
from armrig.cli.options import argument, chosen, group, option
from armrig.cli.parameters import PARAMETERS, Given, cases, parameters, physics_beside
from armrig.cli.printing import echo, fields_of, say, say_answer, say_more
from armrig.cli.reading_options import File, recording_path
from armrig.cli.recorded_data import Part
from armrig.cli.results import Output, Shown
from armrig.cli.spinner import spinner
from armrig.cli.validation import print_comparison, row_facts

if TYPE_CHECKING:
    from armrig_core.rig.arm import ArmParameters

    from armrig.data.dataset import Dataset
    from armrig.models.fit import Fit
    from armrig.physics.grey_box.fit import GreyFit
    from armrig.physics.grey_box.split_study import SplitStudy
    from armrig.recordings.recording import Recording

Rig = Literal["chassis", "arm"]
Model = Annotated[
    Rig | None,
    option(
        "--model", "Rig without its rotating part (chassis) or complete rig (arm).", "from alpha"
    ),
]
_FREE = f"Parameter to estimate ({PARAMETERS}); repeatable"


def greybox(
    *,
    file: File,
    model: Model = None,
    free: list[str] | None = chosen(None, "--free NAME", f"{_FREE}.", "J_1"),
    friction: Literal["viscous", "coulomb", "both"] | None = chosen(
        None, "--friction", "Friction to estimate in addition; the handout neglects friction."
    ),
    given: Given = None,
    signal: list[str] | None = chosen(
        None,
        "--signal NAME",
        "Output to fit, theta_1 or alpha; repeatable, for both outputs together.",
        "theta_1",
    ),
    part: Part,
    out: Shown,
) -> None:
    """Estimate J_1 or other physical parameters (handout 3.5).

    To record the data for J_1, remove the rotating part and run `armrig collect greybox`.
    """
    from armrig.physics.grey_box.estimate import greybox as estimate
    from armrig.recordings.usability import emulation

    out.check(file)
    fixed = parameters(given)
    [recording] = part.recordings(file)
    model, rig = _rig(recording, model)
    outputs = chosen_outputs(signal)
    shown = THETA_1 if THETA_1 in outputs else outputs[0]
    data = recording.dataset(shown)
    signals: Any = data if len(outputs) == 1 else recording.signals(outputs)
    with spinner("estimating"):
        fit = estimate(signals, rig, tuple(free or ("J_1",)), fixed, shown, friction=friction)
    fit.require_result()

    def say_fit() -> None:
        say_answer(fit.explain())
        say(repr(fit) if out.verbose else repr(fit).partition("\n")[0])
        for text in emulation([recording]):
            say(text, dim=True)

    out.show(
        facts=lambda: {"recording": data.source, "model": model} | _grey_facts(fit),
        say=say_fit,
        figures=lambda: {"greybox": partial(fit.plot, data)},
        say_next=lambda: say_next("greybox", file=typed(file), given=part.options(data)),
        height=4.5,
    )


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
        **fields_of(fit, "whiteness_test N Ts converged warnings"),
    }


def split(
    *,
    file: File,
    parts: str = chosen(
        "1,2,4", "--parts K,…", "Numbers of parts into which the recording is cut."
    ),
    model: Model = None,
    free: list[str] | None = chosen(
        None, "--free NAME", f"{_FREE}; estimates of the first parameter are compared.", "J_1"
    ),
    given: Given = None,
    signal: ChannelName = chosen(THETA_1, "--signal", "Output to fit."),
    part: Part,
    out: Shown,
) -> None:
    """Estimate a parameter from parts of a recording (handout 3.6).

    The command shows whether the estimates from halves and quarters agree within their standard
    deviations.
    """
    from armrig.physics.grey_box.estimate import greybox
    from armrig.physics.grey_box.split_study import split_study

    out.check(file)
    cuts, fixed = _cuts(parts), parameters(given)
    [recording] = part.recordings(file)
    data = recording.dataset(signal)
    _, rig = _rig(recording, model)

    def estimate(part: Dataset) -> Any:
        return greybox(part, rig, tuple(free or ("J_1",)), fixed, signal)

    with spinner("estimating") as progress:
        study = split_study(data, cuts, estimate, progress=progress)

    def say_study() -> None:
        say_answer(study.explain() if out.verbose else study.verdict)
        echo(repr(study))

    out.show(
        facts=lambda: {"recording": data.source} | _split_facts(study),
        say=say_study,
        figures=lambda: {"split": study.plot},
        say_next=lambda: say_next("split"),
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
    file: Annotated[
        Path | None,
        argument("F", "Recording with the input of the simulation.", parser=recording_path),
    ] = None,
    model: list[Path] | None = chosen(
        None, "--model JSON", "Additional model file to simulate; repeatable."
    ),
    given: Given = None,
    part: Part,
    out: Annotated[Output, group(Output, ("json", "plot", "verbose"))],
) -> None:
    """Simulate the physical model and saved models (handout 3.4).

    The input comes from a recording. Without a recording, the command shows the response of the
    physical model to a step of 1 V (handout 2.2).
    """
    physics = physics_beside(given)
    out.check(file, *(model or ()))
    if file is None:
        for given_option in ["--model"] * bool(model) + part.given():
            option = given_option.partition(" ")[0]
            raise typer.BadParameter(
                f"{option} needs a recording F: armrig simulate F simulates the response to its "
                "input"
            )
        _simulate_step(cases(given), out)
        return
    from armrig.models.model_file import load_fit
    from armrig.physics.systems import physical_model
    from armrig.validation.comparison import compare, plot_compare

    data = part.recordings(file)[0].dataset()
    saved = map(load_fit, model or ())
    fits: list[Fit] = [fit if (fit.ny, fit.nu) == (1, 1) else fit[data.output] for fit in saved]
    fits += [physical_model(p, data) for p in physics.values()]
    labels = [*(path.stem for path in model or ()), *physics]
    with spinner("simulating"):
        table = compare(data, *fits, labels=labels)
    draw = partial(plot_compare, data, *fits, labels=labels, table=table)
    where = f"on {typed(file)}" + (f"; {table.note}" if out.verbose else "")
    out.show(
        facts=lambda: {"recording": data.source, "models": [*map(row_facts, table.models)]},
        say=lambda: print_comparison(table, where, verbose=out.verbose),
        figures=lambda: {"compare": draw},
        say_next=lambda: say_next("simulate F", file=typed(file), given=part.options(data)),
    )


def _simulate_step(compared: dict[str, ArmParameters], out: Output) -> None:
    """Show the response of the last of some physical models to a step of 1 V."""
    from armrig.physics.figures import plot_physical_step
    from armrig.physics.step_response import characteristics

    found = characteristics([*compared.values()][-1])

    def say_step() -> None:
        say_answer(found.explain() if out.verbose else found.brief())
        if not out.verbose:
            say_more("the meaning of each number")

    out.show(
        facts=lambda: fields_of(found, "steady_speed initial_slope rigid_slope poles zeros"),
        say=say_step,
        figures=lambda: {"step": partial(plot_physical_step, compared)},
        say_next=lambda: say_next("simulate"),
    )


def _rig(recording: Recording, model: Rig | None) -> tuple[Rig, Any]:
    """Return "arm" or "chassis", as the recorded alpha shows, and its model.

    Another --model is refused.
    """
    from armrig.physics.systems import arm, chassis
    from armrig.recordings.findings import alpha_moves

    moves = alpha_moves(recording)
    seen: Rig = "arm" if moves else "chassis"
    if model is not None and model != seen:
        what = "alpha moves: the arm was attached" if moves else "alpha rests: the arm was removed"
        raise InputError(
            f"{recording.path}: --model {model}, but {what}; leave --model out, or record the "
            f"{model} (`armrig collect greybox` is for the chassis alone)"
        )
    return seen, arm if moves else chassis


def _cuts(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(k) for k in text.split(","))
    except ValueError as err:
        raise typer.BadParameter(
            f"--parts {text!r}: give whole numbers with commas, such as 1,2,4"
        ) from err
