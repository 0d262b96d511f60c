"""The commands that test models on data: validate, compare."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armrig.cli.next_estimation import after_validate
from armrig.cli.next_step import say_next, typed
from armrig.cli.options import ModelOrders, chosen, option
from armrig.cli.parameters import Given, physics_beside
from armrig.cli.printing import echo, inform, say, say_answer, say_more
from armrig.cli.reading_options import DataFile, File, OtherFile
from armrig.cli.recorded_data import (
    Part,
    SignalChoice,
    data_group,
    spectral_beside,
    warn_of_estimation_data,
)
from armrig.cli.results import HEIGHT, WIDTH, Draw, ShownFigure
from armrig.cli.spinner import estimating
from armrig.numerics.quantities import listed, plural

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals
    from armrig.models.fit import Fit
    from armrig.recordings.recording import Recording
    from armrig.validation.comparison import Comparison, ComparisonTable

ModelFile = Annotated[Path, option("--model JSON", "Model file written by identify --save.")]
_HORIZONS = (1, 10)
_SAME_RTOL = 1e-6
_MAX_DIFFERENCES = 4
"""Largest number of differences without --verbose."""


def validate(
    *,
    file: DataFile,
    model: ModelFile,
    signals: Annotated[SignalChoice, data_group(without="assume")],
    horizon: list[int] | None = chosen(
        None, "--horizon", "Prediction horizon, in samples; repeatable.", "1 and 10", min=1
    ),
    lags: int | None = chosen(
        None, "--lags", "Number of lags in the tests of the residuals.", "25", min=1
    ),
    out: ShownFigure,
) -> None:
    """Validate a model on a recording or other data.

    The command simulates the model, predicts the output, and tests the residuals.
    """
    from armrig.cli.model_output import (
        error_facts,
        lags_outside,
        pair_lines,
        residual_facts,
        residual_lines,
    )
    from armrig.models.equation import input_and_output
    from armrig.models.model_file import load_fit
    from armrig.plots.captions import signature
    from armrig.validation.answer import simulation, tests_sentence
    from armrig.validation.comparison import compare as compared
    from armrig.validation.figures import COLUMN_WIDTH, ROW_HEIGHT, plot_residual_test
    from armrig.validation.linearity import in_open_loop
    from armrig.validation.residuals import residuals

    out.check(file, model)
    fit = load_fit(model)
    data = signals.of(file, fit)
    with estimating("the orders"):
        simulated = compared(data, fit)
        predicted = [compared(data, fit, horizon=h) for h in horizon or _HORIZONS]
        tests = residuals(fit, data, lags)
    warn_of_estimation_data(simulated)

    def facts() -> dict[str, Any]:
        errors = "fit_percent rms_error"
        ahead = [{"horizon": t.horizon} | error_facts(t.rows, errors) for t in predicted]
        of = {"model": str(model), "identified_from": fit.source}
        return of | residual_facts(data, simulated.rows, tests) | {"ahead": ahead}

    def say_validation() -> None:
        first = f"Simulated, {fit.heading} fits {simulation(simulated.rows)}."
        say_answer(f"{first}\n{tests_sentence(tests)}.")
        for found in in_open_loop(data):
            if not found.linear:
                say(f"Linearity of {found.input} to {found.output}: NONLINEAR: {found.line}.")
        _say_predictions(simulated, predicted)
        counts = [str(q.N) for q in fit.quality]
        known = [str(n) for n in data.signals().valid.sum(axis=0)]
        say(
            f"{input_and_output(fit)}; estimated from {listed([*dict.fromkeys(counts)])} samples, "
            f"validated on {listed([*dict.fromkeys(known)])} samples of {typed(file)} "
            f"({signature(data.source)}); {simulated.note}",
            dim=True,
        )
        if lines := residual_lines(tests) if out.verbose else pair_lines(tests):
            say("\n".join(lines))
        if (out.verbose or out.plot is not None) and (why := lags_outside(tests)):
            say(why)

    def figures() -> dict[str, Draw]:
        from armrig.plots import plot_compare

        return {
            "compare": partial(plot_compare, data, fit, table=simulated),
            "residuals": partial(plot_residual_test, tests),
            **_responses(data, [fit], [fit.label]),
        }

    out.show(
        facts=facts,
        say=say_validation,
        figures=figures,
        say_next=lambda: after_validate(fit, tests, data, file, model, signals),
        width=max(WIDTH, COLUMN_WIDTH * (1 + fit.nu)),
        height=max(HEIGHT, ROW_HEIGHT * fit.ny),
    )


def _say_predictions(simulated: ComparisonTable, predicted: Sequence[ComparisonTable]) -> None:
    """Print the predictions; those equal to the simulation are in one sentence."""
    import numpy as np

    from armrig.cli.model_output import RTOL, equally_well

    rms = [row.rms_error for row in simulated]
    same = [t.horizon for t in predicted if np.allclose([row.rms_error for row in t], rms, RTOL, 0)]
    if same:
        say(equally_well(same))
    for one in predicted:
        if one.horizon not in same:
            say("\n".join(_ahead_lines(one)))


def _ahead_lines(table: ComparisonTable) -> Iterator[str]:
    """Yield a line with the errors of each output; several outputs are named."""
    from armrig.validation.comparison import row_line

    ahead = f"{table.horizon} ahead"
    width = max(len(name) for name in table.outputs) if len(table.outputs) > 1 else 0
    for row in table:
        yield row_line(f"{ahead:9}" + (f" {row.output:{width}}" if width else ""), row)
        ahead = ""


def _responses(
    data: Dataset | Signals, fits: Sequence[Fit], names: Sequence[str], **more: Draw
) -> dict[str, Draw]:
    """Return the Bode diagram of models of one channel, `more` diagrams, and the poles.

    For models of several signals, the result is empty.
    """
    from armrig.plots import plot_bode, plot_poles_zeros

    if any((fit.ny, fit.nu) != (1, 1) for fit in fits):
        return {}
    beside = spectral_beside(data.signals().dataset())
    labels = [*names, *("spectral analysis, 95 %" for _ in beside)]
    bode = partial(plot_bode, *fits, *beside, labels=labels)
    return {"bode": bode, **more, "poles": partial(plot_poles_zeros, *fits, labels=names)}


def compare(
    *,
    file: File,
    other: OtherFile = None,
    orders: ModelOrders,
    model: list[Path] | None = chosen(
        None, "--model JSON", "Model file written by identify --save; repeatable."
    ),
    horizon: int | None = chosen(
        None,
        "--horizon",
        "Prediction horizon, in samples.",
        "none: the models are simulated",
        min=1,
    ),
    given: Given = None,
    part: Part,
    out: ShownFigure,
) -> None:
    """Compare models on data that they were not estimated from.

    With F2, the command estimates an ARX and an OE model from F. On F2, it compares these two
    models, the physical model and the models of --model. Without F2, it compares the models of
    --model on F. --set adds a physical model with the given parameters.
    """
    from armrig.models.model_file import load_fit
    from armrig.physics.systems import physical_model
    from armrig.recordings.usability import emulation
    from armrig.validation.comparison import compare as comparison_of

    changed = physics_beside(given) if given else {}
    if other is None and not model:
        raise typer.BadParameter(
            "give a second recording to validate with, or the models to compare, --model FILE "
            "(from `armrig identify --save FILE`)"
        )
    files = [file] if other is None else [file, other]
    out.check(*files, *(model or []))
    saved = [(path.stem, load_fit(path)) for path in model or []]
    _check_signals(saved, alone=other is None and not given)
    if other is None:
        models, data, where = saved, part.recorded(file, saved[0][1]), typed(file)
        recordings = part.read
    else:
        from armrig.physics.systems import HANDOUT

        recordings = part.recordings(*files)
        models, data, where = _studied(recordings, saved, orders)
        changed.pop(HANDOUT, None)  # the handout's model is in the comparison already
    if changed:
        of_one = data.signals().dataset()
        models = [*models, *((name, physical_model(p, of_one)) for name, p in changed.items())]
    names, fits = [name for name, _ in models], [fit for _, fit in models]
    table = comparison_of(data, *fits, horizon=horizon, labels=names)
    warn_of_estimation_data(table)

    def say_comparison() -> None:
        print_comparison(table, f"on {where}", verbose=out.verbose)
        for text in emulation(recordings):
            say(text, dim=True)

    def figures() -> dict[str, Draw]:
        from armrig.plots import plot_compare, plot_step

        drawn = {"compare": partial(plot_compare, data, *fits, labels=names, table=table)}
        step = partial(plot_step, *fits, labels=names)
        return drawn | _responses(data, fits, names, step=step)

    def say_after() -> None:
        columns = data.signals()
        channel = part.of_channel(columns.outputs[0], columns.inputs[0], data)
        say_next("compare", file=typed(file), given=channel.options(data))

    out.show(
        facts=lambda: {"validation": data.source, "models": [*map(row_facts, table.models)]},
        say=say_comparison,
        figures=figures,
        say_next=say_after,
        height=4.2,
    )


def _check_signals(saved: Sequence[tuple[str, Fit]], *, alone: bool) -> None:
    """Refuse models of several signals with models of other signals; `alone`: only saved models."""
    shapes = {(fit.outputs, fit.inputs) for _, fit in saved}
    several = any((fit.ny, fit.nu) != (1, 1) for _, fit in saved)
    if several and (len(shapes) > 1 or not alone):
        raise typer.BadParameter(
            "--model: models of several signals are compared with models of the same signals only, "
            "on one recording F"
        )


def _studied(
    recordings: list[Recording], saved: list[tuple[str, Fit]], orders: dict[str, Any]
) -> tuple[list[tuple[str, Fit]], Dataset | Signals, str]:
    """Estimate ARX and OE models; return all models, the validation data and their name."""
    from armrig.report.study import Orders, study

    with estimating("na, nb and nf"):
        done = study(recordings, orders=Orders(**orders))
    where = typed(done.recording_of(done.validation.source).path)
    if done.halves:
        where += ", its second half (the models are estimated from its first half)"
    models = [(assessed.name, assessed.model) for assessed in done.models]
    more = []
    for name, fit in saved:
        same = next((n for n, m in models if _same(m, fit)), None)
        if same is None:
            more.append((name, fit))
        else:
            inform(f"the model {name} equals the {same} model estimated here; it is shown once")
    return models + more, done.validation, where


def _same(a: Fit, b: Fit) -> bool:
    """Return True if two models have the same polynomials, within 1e-6."""
    import numpy as np

    pairs = [(getattr(a, letter), getattr(b, letter)) for letter in "ABCDF"]
    return a.Ts == b.Ts and all(
        x.size == y.size and np.allclose(x, y, rtol=_SAME_RTOL, atol=0) for x, y in pairs
    )


def print_comparison(table: ComparisonTable, where: str, *, verbose: bool) -> None:
    """Print the closest model, the fit of each model, and the differences between the models.

    For several signals, print the best model of each output, and the fits.

    With `verbose`, also print the characteristics of the models, and the causes of the differences.
    """
    if any((row.model.ny, row.model.nu) != (1, 1) for row in table):
        from armrig.validation.answer import closest

        say(closest(table), bold=True)
        say(repr(table))
        return
    best, *differences = table.explain(brief=not verbose).splitlines()
    say(best, bold=True)
    how = "simulated" if table.horizon is None else f"predicted {table.horizon} samples ahead"
    say(f"{how} {where}", dim=True)
    say("\n".join(repr(table).splitlines()[1:]))
    if verbose:
        echo(table.table())
    left = [] if verbose else differences[_MAX_DIFFERENCES:]
    for text in differences[: len(differences) - len(left)]:
        say(text)
    if verbose:
        return
    more = [plural(len(left), "more difference")] if left else []
    say_more(", ".join([*more, "characteristics of the models, causes of the differences"]))


def row_facts(rows: Sequence[Comparison]) -> dict[str, Any]:
    """Return the errors of a model, and its characteristic numbers, as JSON fields."""
    from armrig.cli.model_output import error_facts

    facts = {"model": rows[0].name} | error_facts(rows)
    facts["on_estimation_data"] = rows[0].on_estimation_data
    if (rows[0].model.ny, rows[0].model.nu) != (1, 1):
        return facts
    t = rows[0].characteristics
    return facts | {
        "of_rate": t.integrating,
        "figures": {name: {"value": getattr(t, name), "std": std} for name, std in t.std.items()},
        "poles": t.poles,
    }
