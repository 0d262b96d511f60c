"""Next commands after a command that estimates, validates or compares models."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from armrig_core.telemetry.telemetry import THETA_1
from msgspec import structs

from armrig.cli.columns import far_from_zero
from armrig.cli.next_step import estimation_of, say_next, typed, validation_beside
from armrig.cli.recorded_data import SignalChoice, from_recording, measured
from armrig.estimation.request import OPTIONS, Request, flag
from armrig.models.structure_table import STRUCTURES

if TYPE_CHECKING:
    from armrig.cli.identification import Found
    from armrig.data.dataset import Dataset, Signals
    from armrig.models.fit import Fit
    from armrig.validation.residual_test import ResidualTest

CHECK = ""
"""Result of `options_after` if the next command must be `armrig check`, which tests the data."""
_REJECTED = {"residuals", "search", "feedback"}
"""Findings after which a model of several signals is estimated again."""
_LOWER = {"order", "poles"}
_CHECKED = {"feedback", "delay", "unstable"}


def after_identify(found: Found, about: Set[str]) -> None:
    """Print the next command, which acts on the findings, saves the model or validates it.

    `about` are the names of the findings to act on.
    """
    fit, request, data, signals = found.fit, found.request, found.data, found.signals
    tests = None if found.validation is None else found.validation.tests
    one = (fit.ny, fit.nu) == (1, 1)
    searched = found.search is not None
    if one:
        options = options_after(fit, request, about, searched=searched, detrended=signals.detrend)
    else:
        accepted = not (about & _REJECTED or (tests is not None and tests.rejects))
        options = options_of(request)
        if not (searched or accepted):
            options = _better_options(request, data, about)
    given, file = signals.options(), typed(found.file)
    if found.validate is not None:
        validation = typed(found.validate)
    else:
        validation = validation_beside(found.file) if signals.read else ""
    values: dict[str, str | float] = {"file": file, "Ts": fit.Ts, "validation": validation}
    values["model"] = quote(str(found.save or "model.json"))
    values["options"] = options + given + (f" --validate {validation}" if validation else "")
    channel = signals
    if not one:
        columns = data.signals()
        output = (*signals.outputs, *columns.outputs)[0]
        channel = signals.of_channel(output, (*signals.inputs, *columns.inputs)[0], data)
    # `armrig check` has no option --offset.
    checked = channel.options() + " --detrend" * (one and fit.offset and not signals.detrend)
    if options == CHECK:
        say_next("identify check", **values, given=checked)
    elif found.save is None or options != options_of(request):
        say_next("identify", **values)
    elif found.validate is not None and tests is not None and signals.read and _has_physics(fit):
        after_validate(fit, tests, data, found.validate, found.save, signals, estimation=file)
    elif validation:
        # `armrig validate` has no option --assume.
        say_next("identify --save", **values, given=replace(signals, assume=None).options())
    else:
        say_next("identify alone" if signals.read else "identify check", **values, given=checked)


def _has_physics(fit: Fit) -> bool:
    """Return True if the next step after a validation is known: one output must be theta_1."""
    return (fit.ny, fit.nu) != (1, 1) or fit.output == THETA_1


def _better_options(request: Request, data: Dataset | Signals, about: Set[str]) -> str:
    """Return the options of the next estimation of several signals after coloured residuals.

    If the data are not from a rig and have means far from 0, the means are subtracted, because the
    orders may fit then. If an output is the rig's angle theta_1 and the request has no integrator,
    the options request an OE model with an integrator. Otherwise the options request a search. If
    the data show feedback, the result is `CHECK`.
    """
    from armrig.data.treatment import INTEGRATING_OUTPUTS

    columns = data.signals()
    if not from_recording(data):
        outputs = [y for _, y in measured(columns)]
        if far_from_zero([*outputs, *columns.u.T]):
            return f"{options_of(request)} --detrend"
    elif not INTEGRATING_OUTPUTS.isdisjoint(columns.outputs) and not request.integrator:
        return "--structure oe --integrator"
    return CHECK if "feedback" in about else "--search"


def after_validate(
    fit: Fit,
    tests: ResidualTest,
    data: Dataset | Signals,
    file: Path,
    model: Path,
    signals: SignalChoice,
    estimation: str = "",
) -> None:
    """Print the next command: a comparison with other models, or a test of one channel.

    `estimation` is the name of the estimation data, if the user gave them.
    """
    channel, recorded = signals, from_recording(data)
    if (fit.ny, fit.nu) == (1, 1):
        estimation = estimation or (estimation_of(file) if recorded else "")
        after = "validate" if estimation else "validate alone"
    else:
        channel = signals.of_channel(*tests.poorest_pair, data)
        after = "validate several" if recorded and THETA_1 in fit.outputs else "validate alone"
    part = SignalChoice(calibration=signals.calibration, start=signals.start, stop=signals.stop)
    say_next(
        after,
        file=typed(file),
        estimation=estimation,
        model=quote(str(model)),
        given=channel.options(data),
        part=part.options(),
    )


def options_of(request: Request) -> str:
    """Return the options of `armrig identify` for a request."""
    orders = {**request.orders, "nk": request.nk}
    asked = {name: x for name, x in request.asked.items() if name in OPTIONS}
    values = {name: x for name, x in (orders | asked).items() if x is not None}
    given = [
        flag(name) if x is True or isinstance(x, tuple) else f"{flag(name)} {x}"
        for name, x in values.items()
    ]
    return " ".join([f"--structure {request.structure}", *given])


def options_after(
    fit: Fit, request: Request, about: Set[str], *, searched: bool, detrended: bool
) -> str:
    """Return the options with which `armrig identify` follows the advice about a channel's model.

    If no finding of `about` requires action, the result contains the options of the request. If the
    data must be tested first, the result is `CHECK`. If a search chose the model (`searched`),
    another search would not improve its residuals. `detrended` data are without their means.
    """
    kind = STRUCTURES[fit.structure]
    orders = fit.orders
    if "structure" in about:
        oe = request.of_structure("oe", {"nb": orders["nb"], "nf": orders[kind.poles]})
        return options_of(structs.replace(oe, integrator=True, offset=False))
    # A constant level of y looks like an integrator. Angles are not tested for a level.
    level = "level" in about and not fit.integrator
    asked = "integrator" in about and not level
    integrator = fit.integrator or (asked and "integrator" in kind.takes)
    offset = (fit.offset or level) and "offset" in kind.takes and not integrator
    detrend = level and not (offset or detrended)
    # If the level was removed or estimated and is found again, the order is too high.
    seen = level and not detrend and offset == fit.offset
    after = structs.replace(request, integrator=integrator, offset=offset)
    if about & _LOWER or seen or not fit.converged:
        after = structs.replace(after, orders=_lower(fit, integrator=integrator))
    options = options_of(after) + " --detrend" * detrend + " --hampel" * ("outliers" in about)
    if options != options_of(request):
        return options
    if about & _CHECKED:
        return CHECK
    if "residuals" in about and not searched and fit.structure != "pem":
        return f"--structure {fit.structure} --search"
    return options


def _lower(fit: Fit, *, integrator: bool) -> dict[str, int]:
    """Return the orders, lowered by the number of cancelling pairs; noise orders do not change."""
    from armrig.validation.advice import cancelling

    many = sum(2 if pole.imag else 1 for pole, _, _ in cancelling(fit)) or 1
    least = {"nb": 1, STRUCTURES[fit.structure].poles: 1 + integrator}
    return {
        name: max(n - many, min(n, least[name])) if name in least else n
        for name, n in fit.orders.items()
        if name != "nk"
    }
