"""The commands identify, validate and compare, for models of several signals."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from armrig.cli import several_next
from armrig.cli.figures import write_plot
from armrig.cli.model_structures import Given, requested_of_several
from armrig.cli.options import fields_of, print_json, say, say_answer, tell
from armrig.cli.recorded_data import (
    SignalChoice,
    from_recording,
    source_facts,
    warn_of_estimation_data,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from armrig.data.dataset import Signals
    from armrig.estimation.request import Request
    from armrig.models.fit import Fit
    from armrig.validation.comparison import ComparisonTable
    from armrig.validation.search_result import SearchResult


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs:
    """Files that `identify` or `validate` reads and writes, and the form of its output."""

    validate: Path | None = None
    save: Path | None = None
    figure: Path | None
    json: bool
    verbose: bool


def identify(
    file: Path,
    given: Given,
    signals: SignalChoice,
    to: Outputs,
    *,
    most: int | None,
    shared: bool,
) -> None:
    """Estimate a model of several signals, or search for one with up to `most` poles; print it."""
    from armrig.cli import several_output
    from armrig.cli.spinner import estimating
    from armrig.recordings.usability import doubts_of_estimation
    from armrig.validation.residuals import residuals

    data = signals.signals_of(file)
    for recording in signals.read:
        for text in doubts_of_estimation(recording):
            tell(text)
    other = None if to.validate is None else signals.signals_of(to.validate)
    if most is None:
        request = _request(given, data, shared=shared)
        with estimating(", ".join(request.orders)):
            fit = request.estimated(data)
    else:
        found = _searched(given, data, other, most)
        request, fit = found.chosen.candidate.request_for(data), found.fit
        if not to.json:
            say(repr(found))
    table = None if other is None else compared(other, [fit])
    tests = None if other is None else residuals(fit, other)
    if to.json:
        facts = several_output.model_facts(fit) | source_facts(data)
        if table is not None and tests is not None:
            facts |= {"validation": _rows(table), "tests": several_output.test_facts(tests)}
        print_json(facts)
    else:
        say(several_output.answer(fit), bold=True)
        say("\n".join(several_output.lines(fit, verbose=to.verbose)))
        if table is not None and tests is not None and to.validate is not None:
            said = several_output.validated(table, tests, to.validate, verbose=to.verbose)
            say("\n".join(said))
    if to.save is not None:
        fit.save(to.save)
    write_plot(
        to.figure, height=3.6, **several_output.figures(fit, data if other is None else other)
    )
    if not to.json:
        several_next.after_identify(
            fit,
            request,
            data,
            file,
            signals,
            tests=tests,
            validate=to.validate,
            save=to.save,
            searched=most is not None,
        )


def _searched(given: Given, data: Signals, other: Signals | None, most: int) -> SearchResult:
    """Search the structures that the options allow, with 1 to `most` poles."""
    from armrig.cli.spinner import estimating
    from armrig.validation.model_search import SEARCHED_OF_SEVERAL, search

    asked = {name: x for name, x in given.items() if x not in (None, False)}
    if extra := asked.keys() - {"structure", "nk", "integrator"}:
        name = sorted(extra)[0]
        raise typer.BadParameter(
            f"--{name} does not go with --search of several signals, which tries the orders"
        )
    structure = asked.get("structure")
    if structure is not None and structure not in SEARCHED_OF_SEVERAL:
        raise typer.BadParameter(
            f"--structure {structure}: --search of several signals tries "
            f"{', '.join(SEARCHED_OF_SEVERAL)}"
        )
    integrating = _integrating(data) if given["integrator"] or from_recording(data) else ()
    with estimating("--max-order") as progress:
        return search(
            data,
            other,
            families=None if structure is None else (structure,),
            orders=range(1, most + 1),
            nk=asked.get("nk", 1),
            integrator=integrating,
            progress=progress,
        )


def _integrating(data: Signals) -> tuple[str, ...]:
    """Return the outputs that may integrate: theta_1 of a rig, or all outputs of other data."""
    from armrig.data.treatment import INTEGRATING_OUTPUTS

    if not from_recording(data):
        return data.outputs
    return tuple(name for name in data.outputs if name in INTEGRATING_OUTPUTS)


def _request(given: Given, data: Signals, *, shared: bool) -> Request:
    """Return the request; a rig's outputs share one denominator, and only theta_1 may integrate."""
    from armrig.models.structure_table import OF_SEVERAL

    integrating = _integrating(data)
    if from_recording(data):
        row = OF_SEVERAL.get(given["structure"])
        shared = shared or (row is not None and "shared" in (row.takes_several or ()))
    if given["integrator"] and not integrating:
        raise typer.BadParameter(
            f"--integrator: the rig has no pole at 1 for {' and '.join(data.outputs)}"
        )
    return requested_of_several(given, integrating=integrating, shared=shared)


def compared(
    data: Signals,
    fits: Sequence[Fit],
    horizon: int | None = None,
    labels: Sequence[str] | None = None,
) -> ComparisonTable:
    """Return the comparison; print a warning if the data are a model's own estimation data."""
    from armrig.validation.comparison import compare

    table = compare(data, *fits, horizon=horizon, labels=labels)
    warn_of_estimation_data(table)
    return table


def _rows(table: ComparisonTable) -> list[dict[str, Any]]:
    """Return the rows of a comparison as JSON fields."""
    return [
        {
            "model": rows[0].name,
            "on_estimation_data": rows[0].on_estimation_data,
            "horizon": table.horizon,
            "outputs": {
                row.output: fields_of(row, "fit_percent rms_error velocity_fit_percent")
                for row in rows
            },
        }
        for rows in table.models
    ]


def validate(
    fit: Fit,
    file: Path,
    signals: SignalChoice,
    horizons: Sequence[int],
    lags: int | None,
    model: Path,
    to: Outputs,
) -> None:
    """Validate a model of several signals: simulate it, predict with it, test its residuals."""
    from armrig.cli import several_output
    from armrig.cli.spinner import estimating
    from armrig.plots import plot_compare
    from armrig.validation.comparison import compare as comparison_of
    from armrig.validation.residual_figure import (
        COLUMN_WIDTH,
        ROW_HEIGHT,
        plot_residual_test,
    )
    from armrig.validation.residuals import residuals

    data = signals.signals_of(file, fit)
    with estimating("the orders"):
        simulated = compared(data, [fit])
        tables = [simulated, *(comparison_of(data, fit, horizon=h) for h in horizons)]
        tests = residuals(fit, data, lags)
    write_plot(
        to.figure,
        max(6.3, COLUMN_WIDTH * (1 + fit.nu)),
        height=max(3.6, ROW_HEIGHT * fit.ny),
        compare=lambda ax: plot_compare(data, table=simulated, ax=ax),
        residuals=lambda ax: plot_residual_test(tests, ax=ax),
    )
    if to.json:
        facts: dict[str, Any] = {"model": fit.label, "identified_from": fit.source}
        facts |= source_facts(data) | several_output.test_facts(tests)
        print_json(facts | {"comparisons": [row for t in tables for row in _rows(t)]})
    else:
        say_answer(
            "\n".join(several_output.validation_lines(tables, tests, file, verbose=to.verbose))
        )
        several_next.after_validate(fit, tests, data, file, model, signals)


def compare(
    fits: Sequence[tuple[str, Fit]],
    file: Path,
    signals: SignalChoice,
    horizon: int | None,
    *,
    plot: Path | None,
    json: bool,
) -> None:
    """Compare models of the same signals."""
    from armrig.cli import several_output
    from armrig.plots import plot_compare

    data = signals.recorded_signals(file, fits[0][1])
    names = [name for name, _ in fits]
    table = compared(data, [fit for _, fit in fits], horizon, names)
    write_plot(plot, height=3.6, compare=lambda ax: plot_compare(data, table=table, ax=ax))
    if json:
        print_json({"validation": data.source, "models": _rows(table)})
    else:
        say(several_output.closest(table), bold=True)
        say(repr(table))
        several_next.after_compare(data, file, signals)
