"""Answer of an estimation: sentences on the fit of a model and on its residuals."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING

import numpy as np

from armrig.data.finding import FEW_SAMPLES
from armrig.data.step import TWO_STAGE, codes_of
from armrig.models.equation import whiteness_sentence
from armrig.models.fit import Fit
from armrig.numerics.quantities import join_names
from armrig.numerics.whiteness import WHITE_LEVEL
from armrig.validation.advice import COLOURED
from armrig.validation.comparison import Comparison, ComparisonTable
from armrig.validation.residual_test import ResidualTest, results

if TYPE_CHECKING:
    from collections.abc import Sequence

    from armrig.data.finding import Finding

_DATA_FIRST = "correct the data first, see below"
OF_DATA = frozenset({"outliers", "level"})
"""Names of the findings about the data; the estimation and the advice use the same names."""
_CORRECTABLE = OF_DATA | {"drift", "missing", "rails", "trend"}
LEVEL = f"a p below {WHITE_LEVEL:g} rejects"
_MORE_TESTS = f"{LEVEL.capitalize()}; --validate F2 tests the residuals against the input, too."
_ON_OWN_DATA = " on its estimation data"


def answer(
    fit: Fit,
    validation: ComparisonTable | None,
    tests: ResidualTest | None,
    doubts: Sequence[Finding],
) -> str:
    """Return lines on the fit and the residuals of a model.

    If `doubts` or the findings of the fit name a fault that the data can lose, the text advises the
    user to correct the data before the orders. If there are few samples, it advises to record more.
    """
    doubted = any(f.about in _CORRECTABLE for f in (*doubts, *fit.findings))
    fits = [
        f"{name} to {q.fit_percent:.2f} %" for name, q in zip(fit.outputs, fit.quality, strict=True)
    ]
    sentences = (
        f"{fit.heading} fits {join_names(fits)} one step ahead; "
        f"{whiteness_sentence(fit, 'σ', 'σ robust')}"
    )
    remedy = _DATA_FIRST if doubted else COLOURED
    if any(f.about == "samples" for f in doubts):
        remedy = f"record {FEW_SAMPLES} samples or more first"
    if TWO_STAGE in codes_of(fit.history):
        remedy = "the deviations of two stages are valid for any colour"
    sentences += f"; {remedy}." if fit.trusts_robust else "."
    feedback = [f for f in (*fit.findings, *doubts) if f.about == "feedback"]
    if laws := [f.text for f in feedback if f.remedy == "noise"]:
        sentences = f"{laws[0][0].upper()}{laws[0][1:]}.\n{sentences}"
    elif feedback:
        sentences += " But the data show feedback, or a direct term: see below."
    if validation is None or tests is None:
        untested = all(isnan(q.white.p_value) for q in fit.quality)
        return sentences if untested else f"{sentences}\n{_MORE_TESTS}"
    sentences += f"\nSimulated on the validation data it fits {simulation(validation.rows)}."
    return f"{sentences}\n{tests_sentence(tests)}."


def simulation(rows: Sequence[Comparison]) -> str:
    """Return the fits of a model as text, such as: T1 to 99.9 % (rms 0.03 degC) and T2 ….

    The text is the end of a sentence whose subject is the model.
    """
    texts = [f"{row.output} to {_errors(row)}" for row in rows]
    return join_names(texts) + _ON_OWN_DATA * rows[0].on_estimation_data


def closest(table: ComparisonTable) -> str:
    """Return a sentence on each output's best model; for a single model, on its fits."""
    how = "Simulated" if table.horizon is None else f"Predicted {table.horizon} ahead"
    if len(table.models) == 1:
        return f"{how}, {table[0].name} fits {simulation(table.models[0])}."
    groups: dict[str, list[str]] = {}
    for output in table.outputs:
        rows = table.of(output).rows
        best = int(np.nanargmin([row.rms_error for row in rows]))
        groups.setdefault(rows[best].name, []).append(output)
    texts = [
        f"{name} has the least error of {join_names(outputs)}" for name, outputs in groups.items()
    ]
    return f"{how}, {join_names(texts)}."


def _errors(row: Comparison) -> str:
    velocity = row.velocity_fit_percent
    text = f"{row.fit_percent:.2f} % (rms {row.rms_error:.4g} {row.unit}".rstrip()
    return text + (f", velocity {velocity:.2f} %)" if velocity is not None else ")")


def tests_sentence(tests: ResidualTest) -> str:
    """Return the results of the tests of the residuals, with p values and the level."""
    texts: dict[str, list[str]] = {"unusable": [], "warning": [], "good": []}
    for finding in results(tests):
        texts[finding.level].append(finding.text)
    failed, doubts, passed = texts.values()
    passing = [f"passed: {', '.join(passed)}"] if passed else []
    if failed:
        return f"Its residuals do not pass: {'; '.join([*failed, *doubts, *passing, LEVEL])}"
    if tests.powerless:
        return f"The tests of its residuals have no power: {tests.powerless}"
    if doubts:
        return f"It is not clear that its residuals pass: {'; '.join([*doubts, *passing, LEVEL])}"
    return f"Its residuals pass: {', '.join(passed)}; {LEVEL}"
