"""Tables and lines about a model and its tests, for a person at the terminal."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

import armrig
from armrig.cli.printing import echo, fields_of, say, say_more
from armrig.cli.recorded_data import source_facts
from armrig.numerics.quantities import join_names, plural
from armrig.numerics.whiteness import BAND_99_PERCENT, WHITE_LEVEL
from armrig.validation.advice import advice
from armrig.validation.answer import closest
from armrig.validation.comparison import Comparison
from armrig.validation.feedback_and_delay.by_channel import ByChannel
from armrig.validation.residual_test import ResidualTest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from armrig.data.finding import Finding
    from armrig.validation.comparison import ComparisonTable

_MAX_DIFFERENCES = 4
"""Largest number of differences without --verbose."""


def advice_lines(fit: armrig.Fit, doubts: Sequence[Finding]) -> list[str]:
    """Return lines with doubts about the data and with the advice on the model."""
    # The first sentence of the output already reports the residuals.
    reported_topics = {"residuals"} | {f.about for f in doubts}
    if "integrator" in reported_topics:  # explains a pole and a zero at 1, too
        reported_topics.add("level")
    problems = [f for f in advice_on(fit) if f.level != "good"]
    advised = [f for f in problems if f.about not in reported_topics]
    # The command reported the number of samples when it read the data.
    findings = [f for f in (*doubts, *advised) if f.about != "samples"]
    lines = [f"! {f.about.replace('_', ' ')}: {f.text}" for f in findings]
    return lines or [f"nothing {'else ' if problems or doubts else ''}to act on"]


def advice_on(fit: armrig.Fit) -> tuple[Finding, ...]:
    """Return the findings about a model; those about several signals name their channels."""
    fit_advice: Any = advice(fit)
    if not isinstance(fit_advice, ByChannel):
        return tuple(fit_advice.findings)
    channels: dict[Finding, list[str]] = {}
    for (output, input), of_channel in fit_advice.results.items():
        for f in of_channel.findings:
            channels.setdefault(f, []).append(f"{input} to {output}")
    of_channels = [
        replace(f, text=f"{join_names(names)}: {f.text}") for f, names in channels.items()
    ]
    return (*fit.findings, *of_channels)


def lags_outside(tests: ResidualTest) -> str:
    """Return a note on single lags outside their bands if the joint test accepts; otherwise ""."""
    if tests.missing_dynamics_by_pair.size > 1:
        return ""
    beyond = np.abs(tests.cross_correlation) > BAND_99_PERCENT * tests.cross_std
    lags = [
        outside
        for p, outside in (
            (tests.white.p_value, np.abs(tests.autocorrelation[1:]) > tests.autocorrelation_band),
            (tests.missing_dynamics, beyond[tests.cross_lags >= 0]),
            (tests.feedback, beyond[tests.cross_lags < 0]),
        )
        if p >= WHITE_LEVEL
    ]
    n, N = (sum(f(outside) for outside in lags) for f in (np.count_nonzero, np.size))
    if not n:
        return ""
    return (
        f"{n} of {N} lags {'is' if n == 1 else 'are'} outside the 99 % band although their joint "
        "test accepts. The joint test decides, because its p is for all lags together. The band is "
        "for a single lag: by chance one lag in a hundred is outside, often with its neighbours."
    )


def error_facts(
    rows: Sequence[Comparison], names: str = "fit_percent rms_error velocity_fit_percent"
) -> dict[str, Any]:
    """Return the errors of a model as JSON fields; several outputs have lists."""
    each = [fields_of(row, names) for row in rows]
    if len(rows) == 1:
        return each[0]
    return {"outputs": [row.output for row in rows]} | {
        name: [errors[name] for errors in each] for name in each[0]
    }


def residual_facts(
    data: armrig.Dataset | armrig.Signals, rows: Sequence[Comparison], tests: ResidualTest
) -> dict[str, Any]:
    """Return the results on validation data as JSON fields."""
    facts = (
        source_facts(data)
        | {"on_estimation_data": rows[0].on_estimation_data}
        | error_facts(rows)
        | {
            "p_white": tests.white.p_value,
            "whiteness_test": tests.white.test,
            "p_no_dynamics_missing": tests.missing_dynamics,
            "p_no_feedback": tests.feedback,
            "no_power": tests.powerless or tests.blind,
            "error_ratio": tests.error_ratio,
            "p_no_larger_errors": tests.larger_errors,
        }
    )
    if tests.missing_dynamics_by_pair.size == 1:
        return facts
    return facts | {
        "p_white_by_output": [white.p_value for white in tests.white_by_output],
        "whiteness_test_by_output": [white.test for white in tests.white_by_output],
        "channels": [
            {
                "input": input,
                "output": output,
                "p_no_dynamics_missing": tests.missing_dynamics_by_pair[i, j],
                "p_no_feedback": tests.feedback_by_pair[i, j],
            }
            for i, output in enumerate(tests.outputs)
            for j, input in enumerate(tests.inputs)
        ],
    }


def print_comparison(table: ComparisonTable, where: str, *, verbose: bool) -> None:
    """Print the closest model, the fit of each model, and the differences between the models.

    For several signals, print the best model of each output, and the fits.

    With `verbose`, also print the characteristics of the models, and the causes of the differences.
    """
    if any((row.model.ny, row.model.nu) != (1, 1) for row in table):
        say(closest(table), bold=True)
        say(repr(table))
        return
    best, *differences = table.explain(brief=not verbose).splitlines()
    say(best, bold=True)
    how = (
        "simulated"
        if table.horizon is None
        else f"predicted {plural(table.horizon, 'sample')} ahead"
    )
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
