"""Next commands after a command with a model of several signals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from armrig_core.telemetry import THETA_1

from armrig.cli.channels import names
from armrig.cli.column_notes import far_from_zero
from armrig.cli.next_step import say_next, typed, validation_beside
from armrig.cli.recorded_data import SignalChoice, from_recording

if TYPE_CHECKING:
    from armrig.data.dataset import Signals
    from armrig.estimation.request import Request
    from armrig.models.fit import Fit
    from armrig.validation.residual_test import ResidualTest


def after_identify(
    fit: Fit,
    request: Request,
    data: Signals,
    file: Path,
    signals: SignalChoice,
    *,
    tests: ResidualTest | None,
    validate: Path | None,
    save: Path | None,
    searched: bool,
) -> None:
    """Print the next command, which tries a better structure, or saves or validates the model.

    `tests` are the tests of the residuals on validation data.
    """
    validation = typed(validate) if validate else ""
    if not validation and signals.read:
        validation = validation_beside(file)
    model = quote(str(save or "model.json"))
    asked = options_of(request)
    accepted = _fits(fit) and (tests is None or not tests.rejects)
    options = asked if searched or accepted else better_options(request, data)
    if options != asked and _at_operating_point(data):
        options = f"{asked} --detrend"  # after the means are subtracted, the orders may fit
    given = signals.options()
    if save is None or options != asked:
        options += given + (f" --validate {validation}" if validation else "")
        say_next("identify", file=typed(file), options=options, model=model)
    elif tests is not None and validate is not None and signals.read:
        after_validate(fit, tests, data, validate, save, signals)
    elif validation:
        say_next("identify --save", validation=validation, model=model, given=given)
    elif signals.read:
        say_next("identify alone", Ts=fit.Ts)
    else:
        say_next("identify check", file=typed(file), given=_one_channel(signals, data))


def _fits(fit: Fit) -> bool:
    """Return True if the search converged and the residuals of each output are white."""
    return fit.converged and not any(q.white.coloured for q in fit.quality)


def _at_operating_point(data: Signals) -> bool:
    """Return True if the data are not from a rig and have means far from 0."""
    if from_recording(data):
        return False
    outputs = [y[known] for y, known in zip(data.y.T, data.valid.T, strict=True)]
    return far_from_zero([*outputs, *data.u.T])


def better_options(request: Request, data: Signals) -> str:
    """Return the options of `identify` for the next estimation after coloured residuals.

    If an output is the rig's angle theta_1 and the request has no integrator, the options request
    an OE model with an integrator. Otherwise the options request a search.
    """
    from armrig.data.treatment import INTEGRATING_OUTPUTS

    integrates = from_recording(data) and not INTEGRATING_OUTPUTS.isdisjoint(data.outputs)
    if integrates and not request.integrating:
        return "--structure oe --integrator"
    return "--search"


def options_of(request: Request) -> str:
    """Return the options of `identify` that result in this request."""
    orders = [f"--{name} {n}" for name, n in request.orders.items() if n is not None]
    weights = f"--weights {request.weights}" if request.weights else ""
    flags = ["--integrator" * bool(request.integrating), "--shared" * bool(request.shared), weights]
    flags += [f"--{name}" for name in ("offset", "stable") if getattr(request, name)]
    each = [f"--structure {request.structure}", *orders, f"--nk {request.nk}", *flags]
    return " ".join(x for x in each if x)


def after_validate(
    fit: Fit,
    tests: ResidualTest,
    data: Signals,
    file: Path,
    model: Path,
    signals: SignalChoice,
) -> None:
    """Print the next command: a comparison with the physical model, or a test of one channel."""
    if from_recording(data) and THETA_1 in fit.outputs:
        part = SignalChoice(calibration=signals.calibration, start=signals.start, stop=signals.stop)
        say_next("validate several", file=typed(file), model=quote(str(model)), part=part.options())
    else:
        output, input = tests.poorest_pair
        channel = replace(signals, signal=output, input=None if from_recording(data) else input)
        say_next("validate alone", file=typed(file), given=channel.options())


def after_compare(data: Signals, file: Path, signals: SignalChoice) -> None:
    """Print the next command: a test of one channel."""
    say_next("compare", file=typed(file), given=_one_channel(signals, data))


def _one_channel(signals: SignalChoice, data: Signals) -> str:
    """Return the options with which a command reads the first output and the first input."""
    output = (*names("--signal", signals.signal), *data.outputs)[0]
    # The input of a recording is always u.
    input = None if from_recording(data) else (*names("--input", signals.input), *data.inputs)[0]
    named = None if from_recording(data) and output == THETA_1 else output
    return replace(signals, signal=named, input=input).options()
