"""The command validate, which tests a model on data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isclose
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

import typer

from armrig.cli.chosen_recording import DataFile
from armrig.cli.figures import Plot, check_plot, write_plot
from armrig.cli.next_step import estimation_of, say_next, typed
from armrig.cli.options import (
    Json,
    Verbose,
    print_json,
    say,
    say_answer,
)
from armrig.cli.recorded_data import (
    SignalChoice,
    from_recording,
    reads_data,
    spectral_beside,
    warn_of_estimation_data,
)
from armrig.cli.several_signals import Outputs
from armrig.cli.several_signals import validate as validate_several

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.models.fit import Fit
    from armrig.validation.comparison import ComparisonTable
    from armrig.validation.residual_test import ResidualTest

ModelFile = Annotated[
    Path, typer.Option("--model", metavar="JSON", help="Model file written by identify --save.")
]
Horizons = Annotated[
    list[int] | None,
    typer.Option(
        "--horizon",
        min=1,
        help="Prediction horizon, in samples; repeatable.",
        show_default="1 and 10",
    ),
]
Lags = Annotated[
    int | None,
    typer.Option(
        "--lags", min=1, help="Number of lags in the tests of the residuals.", show_default="25"
    ),
]
_HORIZONS = (1, 10)


@reads_data("assume", several=True)
def validate(
    file: DataFile,
    model: ModelFile,
    signals: SignalChoice,
    horizon: Horizons = None,
    lags: Lags = None,
    plot: Plot = None,
    json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Validate a model on a recording or other data.

    The command simulates the model, predicts the output, and tests the residuals.
    """
    from armrig.models.model_file import load_fit

    check_plot(plot, [file, model])
    fit = load_fit(model)
    if (fit.ny, fit.nu) != (1, 1):
        to = Outputs(figure=plot, json=json, verbose=verbose)
        validate_several(fit, file, signals, horizon or _HORIZONS, lags, model, to)
        return
    data = signals.of(file, fit)
    validated = _validated(fit, data, horizon or _HORIZONS, lags)
    _plot_validation(validated, lags, plot)
    if json:
        _print_validation_json(validated, model)
    else:
        _print_validation(validated, file, verbose=verbose, drawn=plot is not None)
        estimation = estimation_of(file) if from_recording(data) else ""
        say_next(
            "validate" if estimation else "validate alone",
            file=typed(file),
            given=signals.options(data),
            estimation=estimation,
            model=quote(str(model)),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Validated:
    """Results of one model on the validation data."""

    fit: Fit
    data: Dataset
    simulated: ComparisonTable
    predicted: list[ComparisonTable]
    """Comparison for each horizon."""
    tests: ResidualTest


def _validated(fit: Fit, data: Dataset, horizons: Sequence[int], lags: int | None) -> _Validated:
    from armrig.cli.spinner import estimating
    from armrig.validation.comparison import compare as compared
    from armrig.validation.residuals import residuals

    with estimating("the orders"):
        simulated = compared(data, fit)
        predicted = [compared(data, fit, horizon=h) for h in horizons]
        tests = residuals(fit, data, lags)
    warn_of_estimation_data(simulated)
    return _Validated(fit=fit, data=data, simulated=simulated, predicted=predicted, tests=tests)


def _plot_validation(validated: _Validated, lags: int | None, plot: Path | None) -> None:
    if plot is None:
        return
    from armrig.plots import plot_bode, plot_compare, plot_poles_zeros, plot_residuals

    fit, data = validated.fit, validated.data
    beside = spectral_beside(data)
    names = [fit.label, *("spectral analysis, 95 %" for _ in beside)]
    write_plot(
        plot,
        compare=lambda ax: plot_compare(data, fit, table=validated.simulated, ax=ax),
        residuals=lambda ax: plot_residuals(fit, data, lags=lags, ax=ax),
        bode=lambda ax: plot_bode(fit, *beside, labels=names, ax=ax),
        poles=lambda ax: plot_poles_zeros(fit, ax=ax),
    )


def _print_validation_json(validated: _Validated, model: Path) -> None:
    from armrig.cli.model_output import residual_facts

    ahead = [
        {"horizon": t.horizon, "fit_percent": t[0].fit_percent, "rms_error": t[0].rms_error}
        for t in validated.predicted
    ]
    print_json(
        {"model": str(model), "identified_from": validated.fit.source}
        | residual_facts(validated.data, validated.simulated[0], validated.tests)
        | {"ahead": ahead}
    )


def _print_validation(validated: _Validated, file: Path, *, verbose: bool, drawn: bool) -> None:
    from armrig.cli.model_output import RTOL, equally_well, lags_outside, residual_lines
    from armrig.models.equation import input_and_output
    from armrig.plots.captions import signature
    from armrig.validation.answer import simulated_to, tests_sentence
    from armrig.validation.comparison import row_line

    fit, table, tests = validated.fit, validated.simulated, validated.tests
    simulated = simulated_to(table[0])
    say_answer(
        f"Simulated, {fit.heading} fits {fit.output} to {simulated}.\n{tests_sentence(tests)}."
    )
    rms = table[0].rms_error
    same = [t.horizon for t in validated.predicted if isclose(t[0].rms_error, rms, rel_tol=RTOL)]
    if same:
        say(equally_well(same))
    for one in validated.predicted:
        if one.horizon not in same:
            say(row_line(f"{f'{one.horizon} ahead':9}", one[0]))
    N = validated.data.N - validated.data.missing
    say(
        f"{input_and_output(fit)}; estimated from {fit.N} samples, validated on {N} samples of "
        f"{typed(file)} ({signature(validated.data.source)}); {table.note}",
        dim=True,
    )
    if verbose:
        say("\n".join(residual_lines(tests)))
    if (verbose or drawn) and (why := lags_outside(tests)):
        say(why)
