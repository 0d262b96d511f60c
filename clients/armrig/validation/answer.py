"""Answer of an estimation: sentences on the fit of a model and on its residuals."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING

from armrig.models.equation import whiteness_sentence
from armrig.models.fit import Fit
from armrig.numerics.quantities import p_relation
from armrig.numerics.whiteness import WHITE_LEVEL
from armrig.validation.advice.model_advice import COLOURED
from armrig.validation.comparison import Comparison, ComparisonTable
from armrig.validation.residual_test import ResidualTest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from armrig.data.finding import Finding
    from armrig.validation.residual_test import ResidualTest

_DATA_FIRST = "correct the data first, see below"
OF_DATA = frozenset({"outliers", "level"})
"""Names of the findings about the data; the estimation and the advice use the same names."""
NOISE = "look at the noise model or the orders"
DYNAMICS = "look at the orders or the delay"
FEEDBACK = "look at the experiment, or the delay is too large"
LEVEL = f"a p below {WHITE_LEVEL:g} rejects"
_MORE_TESTS = f"{LEVEL.capitalize()}; --validate F2 tests the residuals against the input, too."
ON_OWN_DATA = " on its estimation data"
UNTESTED = "too few samples or residuals for the test"


def answer(
    fit: Fit,
    validation: ComparisonTable | None,
    tests: ResidualTest | None,
    doubts: Sequence[Finding],
) -> str:
    """Return lines on the fit and the residuals of a model.

    If `doubts` or the findings of the fit make the data doubtful, the text advises the user to
    correct the data before the orders.
    """
    doubted = bool(doubts) or any(f.about in OF_DATA for f in fit.findings)
    said = (
        f"{fit.heading} fits {fit.output} to {fit.fit_percent:.2f} % one step ahead; "
        f"{whiteness_sentence(fit, 'σ', 'σ robust')}"
    )
    said += f"; {_DATA_FIRST if doubted else COLOURED}." if fit.trusts_robust else "."
    if validation is None or tests is None:
        return said if isnan(fit.whiteness) else f"{said}\n{_MORE_TESTS}"
    simulated = simulated_to(validation[0])
    return (
        f"{said}\nSimulated on the validation data it fits to {simulated}.\n"
        f"{tests_sentence(tests)}."
    )


def simulated_to(row: Comparison) -> str:
    """Return the fit of a simulation as text, such as 99.9 % (rms 0.0035 rad, velocity 83.6 %)."""
    velocity = row.velocity_fit_percent
    said = f"{row.fit_percent:.2f} % (rms {row.rms_error:.4g} {row.unit}".rstrip()
    said += f", velocity {velocity:.2f} %)" if velocity is not None else ")"
    return said + ON_OWN_DATA * row.on_estimation_data


def tests_sentence(tests: ResidualTest) -> str:
    """Return the result of the tests of the residuals, with p values and the level."""
    failed, passed = [], []
    if tests.white.coloured:
        failed.append(f"they are {tests.white}: {NOISE}")
    else:
        passed.append(str(tests.white))
    # If u is not white, missing dynamics also affect the lags at which feedback is tested.
    feedback = f"there is feedback ({{}}): {FEEDBACK}"
    if tests.missing_dynamics < WHITE_LEVEL:
        feedback = "until the dynamics are modelled, the test of feedback ({}) is not valid"
    for p, bad, good in (
        (
            tests.missing_dynamics,
            f"dynamics are missing ({{}}): {DYNAMICS}",
            "no dynamics missing",
        ),
        (tests.feedback, feedback, "no feedback seen"),
    ):
        said = f"p {p_relation(p)}"
        if p < WHITE_LEVEL:
            failed.append(bad.format(said))
        else:
            passed.append(f"{good} ({said})" if p >= 0 else f"{good}: {UNTESTED}")
    if failed:
        rest = [f"passed: {', '.join(passed)}"] if passed else []
        return f"Its residuals do not pass: {'; '.join([*failed, *rest, LEVEL])}"
    if tests.powerless:
        return f"The tests of its residuals have no power: {tests.powerless}"
    if not all(p >= WHITE_LEVEL for p in (tests.missing_dynamics, tests.feedback)):
        return f"Residuals {tests.white}; {UNTESTED}"
    return f"Its residuals pass: {', '.join(passed)}; {LEVEL}"
