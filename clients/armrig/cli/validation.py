"""The command validate, which tests a model on data."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armrig.cli.chosen_recording import DataFile
from armrig.cli.figures import WIDTH, Draw, Plot, check_plot, write_plot
from armrig.cli.next_estimation import after_validate
from armrig.cli.next_step import typed
from armrig.cli.options import (
    Json,
    Verbose,
    print_json,
    say,
    say_answer,
)
from armrig.cli.recorded_data import (
    SignalChoice,
    reads_data,
    spectral_beside,
    warn_of_estimation_data,
)
from armrig.numerics.quantities import listed

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals
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


@reads_data("assume")
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
    data = signals.of(file, fit)
    validated = _validated(fit, data, horizon or _HORIZONS, lags)
    _plot_validation(validated, plot)
    if json:
        _print_validation_json(validated, model)
    else:
        _print_validation(validated, file, verbose=verbose, drawn=plot is not None)
        after_validate(fit, validated.tests, data, file, model, signals)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Validated:
    """Results of one model on the validation data."""

    fit: Fit
    data: Dataset | Signals
    simulated: ComparisonTable
    predicted: list[ComparisonTable]
    """Comparison for each horizon."""
    tests: ResidualTest


def _validated(
    fit: Fit, data: Dataset | Signals, horizons: Sequence[int], lags: int | None
) -> _Validated:
    from armrig.cli.spinner import estimating
    from armrig.validation.comparison import compare as compared
    from armrig.validation.residuals import residuals

    with estimating("the orders"):
        simulated = compared(data, fit)
        predicted = [compared(data, fit, horizon=h) for h in horizons]
        tests = residuals(fit, data, lags)
    warn_of_estimation_data(simulated)
    return _Validated(fit=fit, data=data, simulated=simulated, predicted=predicted, tests=tests)


def _plot_validation(validated: _Validated, plot: Path | None) -> None:
    if plot is None:
        return
    from armrig.plots import plot_bode, plot_compare, plot_poles_zeros
    from armrig.validation.residual_figure import COLUMN_WIDTH, ROW_HEIGHT, plot_residual_test

    fit, data = validated.fit, validated.data
    drawn: dict[str, Draw] = {
        "compare": lambda ax: plot_compare(data, fit, table=validated.simulated, ax=ax),
        "residuals": lambda ax: plot_residual_test(validated.tests, ax=ax),
    }
    if (fit.ny, fit.nu) == (1, 1):
        beside = spectral_beside(data.signals().dataset())
        names = [fit.label, *("spectral analysis, 95 %" for _ in beside)]
        drawn["bode"] = lambda ax: plot_bode(fit, *beside, labels=names, ax=ax)
        drawn["poles"] = lambda ax: plot_poles_zeros(fit, ax=ax)
    write_plot(
        plot,
        max(WIDTH, COLUMN_WIDTH * (1 + fit.nu)),
        height=max(3.6, ROW_HEIGHT * fit.ny),
        **drawn,
    )


def _print_validation_json(validated: _Validated, model: Path) -> None:
    from armrig.cli.model_output import error_facts, residual_facts

    ahead = [
        {"horizon": t.horizon} | error_facts(t.rows, "fit_percent rms_error")
        for t in validated.predicted
    ]
    print_json(
        {"model": str(model), "identified_from": validated.fit.source}
        | residual_facts(validated.data, validated.simulated.rows, validated.tests)
        | {"ahead": ahead}
    )


def _print_validation(validated: _Validated, file: Path, *, verbose: bool, drawn: bool) -> None:
    import numpy as np

    from armrig.cli.model_output import (
        RTOL,
        equally_well,
        lags_outside,
        pair_lines,
        residual_lines,
    )
    from armrig.models.equation import input_and_output
    from armrig.plots.captions import signature
    from armrig.validation.answer import simulation, tests_sentence

    fit, table, tests = validated.fit, validated.simulated, validated.tests
    say_answer(f"Simulated, {fit.heading} fits {simulation(table.rows)}.\n{tests_sentence(tests)}.")
    rms = [row.rms_error for row in table]
    same = [
        t.horizon
        for t in validated.predicted
        if np.allclose([row.rms_error for row in t], rms, RTOL, 0)
    ]
    if same:
        say(equally_well(same))
    for one in validated.predicted:
        if one.horizon not in same:
            say("\n".join(_ahead_lines(one)))
    columns = validated.data.signals()
    counts = [str(q.N) for q in fit.quality]
    known = [str(n) for n in columns.valid.sum(axis=0)]
    say(
        f"{input_and_output(fit)}; estimated from {listed([*dict.fromkeys(counts)])} samples, "
        f"validated on {listed([*dict.fromkeys(known)])} samples of {typed(file)} "
        f"({signature(validated.data.source)}); {table.note}",
        dim=True,
    )
    lines = residual_lines(tests) if verbose else [*pair_lines(tests)]
    if lines:
        say("\n".join(lines))
    if (verbose or drawn) and (why := lags_outside(tests)):
        say(why)


def _ahead_lines(table: ComparisonTable) -> Iterator[str]:
    """Yield a line with the errors of each output; several outputs are named."""
    from armrig.validation.comparison import row_line

    ahead = f"{table.horizon} ahead"
    width = max(len(name) for name in table.outputs) if len(table.outputs) > 1 else 0
    for row in table:
        yield row_line(f"{ahead:9}" + (f" {row.output:{width}}" if width else ""), row)
        ahead = ""
