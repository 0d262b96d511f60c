"""Lines, facts and figures of a model of several signals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from armrig.cli.model_output import RTOL, coefficients, equally_well, root_lines
from armrig.models.structure_table import named
from armrig.numerics.quantities import listed
from armrig.plots.captions import signature
from armrig.validation.answer import ON_OWN_DATA, simulated_to, tests_sentence
from armrig.validation.comparison import misfit_line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.dataset import Signals
    from armrig.models.fit import Fit
    from armrig.validation.comparison import Comparison, ComparisonTable
    from armrig.validation.residual_test import ResidualTest


def answer(fit: Fit) -> str:
    """Return a sentence on the fit and the residuals of each output."""
    fits = [
        f"{name} to {q.fit_percent:.2f} %" for name, q in zip(fit.outputs, fit.quality, strict=True)
    ]
    coloured = [name for name, q in zip(fit.outputs, fit.quality, strict=True) if q.white.coloured]
    said = f"{fit.label} fits {listed(fits)} one step ahead"
    if coloured:
        return f"{said}; the residuals of {listed(coloured)} are coloured: σ robust applies."
    return f"{said}; the residuals are white."


def simulated(rows: Sequence[Comparison]) -> str:
    """Return the fits as text, such as: theta_1 to 99.9 % (rms 0.0035 rad) and alpha to ….

    The text is the end of a sentence whose subject is the model.
    """
    texts = [f"{row.output} to {simulated_to(row).removesuffix(ON_OWN_DATA)}" for row in rows]
    return listed(texts) + ON_OWN_DATA * rows[0].on_estimation_data


def validated(
    table: ComparisonTable, tests: ResidualTest, file: Path, *, verbose: bool
) -> Iterator[str]:
    """Yield a sentence on simulation and tests, then each pair of signals that fails a test."""
    yield (
        f"Simulated on {file}, {table[0].name} fits {simulated(table.models[0])}.\n"
        f"{tests_sentence(tests)}."
    )
    yield from tests.pair_lines(every=verbose)


def closest(table: ComparisonTable) -> str:
    """Return a sentence on each output's best model; for a single model, on its fits."""
    how = "Simulated" if table.horizon is None else f"Predicted {table.horizon} ahead"
    if len(table.models) == 1:
        return f"{how}, {table[0].name} fits {simulated(table.models[0])}."
    of: dict[str, list[str]] = {}
    for output in table.outputs:
        rows = table.of(output).rows
        best = int(np.nanargmin([row.rms_error for row in rows]))
        of.setdefault(rows[best].name, []).append(output)
    said = [f"{name} has the least error of {listed(outputs)}" for name, outputs in of.items()]
    return f"{how}, {listed(said)}."


def validation_lines(
    tables: Sequence[ComparisonTable],
    tests: ResidualTest,
    file: Path,
    *,
    verbose: bool,
) -> Iterator[str]:
    """Yield a summary sentence, the fits at each horizon, and the tests of the residuals.

    Without `verbose`, only pairs of input and output that fail a test are shown.
    """
    rows, data = tables[0].rows, tables[0].data
    yield f"Simulated, {rows[0].name} fits {simulated(rows)}.\n{tests_sentence(tests)}."
    yield f"validated on {data.N} samples of {file} ({signature(data.source)})"
    width = max(len(row.output) for row in rows)
    errors = [[row.rms_error for row in table] for table in tables]
    same = [
        table.horizon
        for table, of_table in zip(tables[1:], errors[1:], strict=True)
        if np.allclose(of_table, errors[0], RTOL, 0)
    ]
    if same:
        yield equally_well(same)
    for table in tables[1:]:
        if table.horizon in same:
            continue
        ahead = f"{table.horizon} ahead"
        for row in table:
            yield misfit_line(f"{ahead:10}  {row.output:{width}}", row)
            ahead = ""
    yield f"  {tables[0].note}"
    for name, white in zip(tests.outputs, tests.white_by_output, strict=True):
        yield f"  residuals of {name}: {white}"
    yield from tests.pair_lines(every=verbose)


def lines(fit: Fit, *, verbose: bool) -> Iterator[str]:
    """Yield a summary of the model; with `verbose`, also the coefficients of each channel."""
    yield repr(fit)
    if verbose:
        for i, j, channel in fit.channels():
            yield f"{fit.inputs[j]} to {fit.outputs[i]}, delay {channel.nk} Ts"
            yield from coefficients(channel)
            yield from root_lines(channel)


def model_facts(fit: Fit) -> dict[str, Any]:
    """Return the results of the estimation as JSON fields."""
    poles = fit.poles()
    return {
        "structure": fit.structure,
        "orders": fit.specification or named(fit.orders),
        "shared": fit.shared,
        "inputs": list(fit.inputs),
        "Ts": fit.Ts,
        "outputs": {
            name: {
                "fit_percent": q.fit_percent,
                "loss": q.loss,
                "N": q.N,
                "p_white": q.white.p_value,
                "whiteness_test": q.white.test,
            }
            for name, q in zip(fit.outputs, fit.quality, strict=True)
        },
        "noise_covariance": fit.noise_covariance.tolist(),
        "poles": [
            {"real": z.real, "imag": z.imag, "std": float(std)}
            for z, std in zip(poles.values.tolist(), poles.std, strict=True)
        ],
        "channels": [
            {
                "input": fit.inputs[j],
                "output": fit.outputs[i],
                "nk": channel.nk,
                "parameters": {
                    name: {"value": float(v), "std": float(s), "std_robust": float(r)}
                    for name, v, s, r in zip(
                        channel.names, channel.theta, channel.std, channel.std_robust, strict=True
                    )
                },
            }
            for i, j, channel in fit.channels()
        ],
        "converged": fit.converged,
        "warnings": list(fit.warnings),
    }


def test_facts(tests: ResidualTest) -> dict[str, Any]:
    """Return the tests of the residuals as JSON fields."""
    return {
        "p_white": tests.white.p_value,
        "p_no_dynamics_missing": tests.missing_dynamics,
        "p_no_feedback": tests.feedback,
        "outputs": {
            name: {"p_white": white.p_value, "whiteness_test": white.test}
            for name, white in zip(tests.outputs, tests.white_by_output, strict=True)
        },
        "pairs": [
            {
                "input": input,
                "output": output,
                "p_no_dynamics_missing": float(tests.missing_dynamics_by_pair[i, j]),
                "p_no_feedback": float(tests.feedback_by_pair[i, j]),
            }
            for i, output in enumerate(tests.outputs)
            for j, input in enumerate(tests.inputs)
        ],
    }


def figures(fit: Fit, data: Signals) -> dict[str, Callable[[Axes], Axes]]:
    """Return the functions that draw the simulated outputs, and each channel's Bode diagram."""
    from armrig.plots import plot_compare
    from armrig.validation.comparison import compare

    table = compare(data, fit)
    drawn: dict[str, Callable[[Axes], Axes]] = {
        "compare": lambda ax: plot_compare(data, table=table, ax=ax)
    }
    for i, j, channel in fit.channels():
        label = f"{fit.inputs[j]} to {fit.outputs[i]}"
        drawn[f"bode_{label.replace(' ', '_')}"] = partial(_bode, channel, label)
    return drawn


def _bode(channel: Fit, label: str, ax: Axes) -> Axes:
    from armrig.plots import plot_bode

    return plot_bode(channel, labels=[label], ax=ax)
