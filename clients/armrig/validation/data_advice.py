"""Advice on data."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from armrig.data.dataset import Dataset, Signals
from armrig.data.files.column_faults import rails_of
from armrig.data.finding import Finding, good, warning
from armrig.data.step import LINE, codes_of
from armrig.data.treatment import INTEGRATING_OUTPUTS, drift
from armrig.data.treatment.integrating import Integration, integration
from armrig.estimation.data_faults import (
    CONSTANT_INPUT,
    NO_OPTION,
    OFFSET_OF_TRANSIENT,
    constant_input,
    level_without_input,
    looking_wrong,
)
from armrig.excitation.input_description import excitation_order
from armrig.models.fit import Fit
from armrig.models.transfer_function import TransferFunction
from armrig.numerics.quantities import p_relation, percent
from armrig.validation.feedback_and_delay.delay import delay
from armrig.validation.feedback_and_delay.delay_result import Delay
from armrig.validation.feedback_and_delay.open_loop import CHANCE_LEVEL, OpenLoop, open_loop
from armrig.validation.linearity import in_open_loop

ORDER = 4
"""Number of poles, and number of numerator coefficients, of the model for which u must be exciting;
the arm has 4 poles."""
_MAX_MISSING_SHARE = 0.2
_RICHER = "play a u that switches often (telegraph, PRBS)"
_MIN_POLE_SIGMAS = 10.0  # least distance from 1, in σ, of a pole that is not 1; σ may be too small


@dataclass(frozen=True, slots=True, kw_only=True)
class Tested:
    """Tests of the data before a model is chosen."""

    integration: Integration
    """Decision whether y integrates."""
    loop: OpenLoop | None
    """Result of the test for feedback; None if there are too few samples."""
    late: Delay | str
    """Result of the test for a delay, or the reason why the test is not possible."""

    @property
    def closed(self) -> bool:
        """True if feedback is found with p < 0.1 %, and a direct term cannot be the cause."""
        return self.together and not (self.loop is not None and self.loop.may_be_direct_term)

    @property
    def together(self) -> bool:
        """True if feedback or a direct term is found with p < 0.1 %."""
        return self.loop is not None and self.loop.p_value < CHANCE_LEVEL


def tested(data: Dataset, integrator: bool | None) -> Tested:
    """Test data for an integrator, feedback and a delay."""
    decided = integration(data, integrator)
    late: Delay | str
    try:
        late = delay(data, integrator=decided.integrates)
    except ValueError as err:
        late = str(err)
    return Tested(integration=decided, loop=_loop(data), late=late)


def _loop(data: Dataset) -> OpenLoop | None:
    with suppress(ValueError):
        return open_loop(data)
    return None


def examine_data(data: Dataset) -> Iterator[Finding]:
    """Yield the findings about the data; a possible cause precedes its effects."""
    yield from examine_experiment(data, tested(data, None))
    for test in in_open_loop(data):
        yield (good if test.linear else warning)("linearity", test.line)


def doubts(data: Dataset, known: Tested) -> list[Finding]:
    """Return the findings that need action; feedback is included only if p < 0.1 %."""
    found = [f for f in examine_experiment(data, known) if f.level != "good"]
    return [f for f in found if f.about != "feedback" or known.together]


def doubts_of_channels(data: Signals) -> Iterator[Finding]:
    """Yield the doubts about each input, and about the feedback in each channel."""
    for input in data.inputs:
        found = _about_input(data.dataset(data.outputs[0], input))
        if found.level != "good":
            yield replace(found, text=f"{input}: {found.text}")
        for output in data.outputs:
            loop = _loop(data.dataset(output, input))
            known = Tested(integration=Integration(integrates=False), loop=loop, late="")
            for found in about_feedback(known) if known.together else ():
                yield replace(found, text=f"{input} to {output}: {found.text}")


def examine_experiment(data: Dataset, known: Tested) -> Iterator[Finding]:
    """Yield the findings that need no model."""
    yield _about_input(data)
    yield _about_integrator(known.integration)
    yield from _about_rails(data)
    if data.missing:
        share = data.missing / data.N
        text = f"{percent(100 * share)} of the samples: no estimator replaces them by a value"
        yield (good if share < _MAX_MISSING_SHARE else warning)("missing", text)
    if not known.together:  # in closed loop a step of the set point makes y and u jump
        yield _about_outliers(data)
    if not known.integration.integrates and not known.integration.unstable:
        if level := level_without_input(data):
            remedy = OFFSET_OF_TRANSIENT if data.trends else NO_OPTION
            yield replace(level, text=f"{level.text}: {remedy}")
        yield from _about_drift(data)
    if data.output in INTEGRATING_OUTPUTS and LINE in codes_of(data.history):
        text = "a line was removed from an output that integrates: it was the response to the mean "
        yield warning("trend", text + "of u, not a drift; begin again from the recording")
    yield from about_feedback(known)
    yield _about_delay(known)


def examine_fit_of(
    data: Dataset | Signals, fit: Fit, integrator: bool | None = None
) -> Iterator[Finding]:
    """Yield the findings on excitation, integrator, feedback and delay that concern the model.

    The findings of several signals are those on the excitation and feedback of each channel.
    """
    if (fit.ny, fit.nu) != (1, 1):
        yield from doubts_of_channels(data.signals())
        return
    data = data.signals().dataset()
    known = tested(data, fit.integrator or integrator)
    free = isinstance(fit.form, TransferFunction) and fit.form.delay_estimated
    in_s, fit = fit.Ts == 0, fit.to_discrete() if fit.Ts == 0 else fit
    order, needed = excitation_order(data), sum(s.stop - s.start for s in map(fit.slice_of, "bfa"))
    if order < needed and not constant_input(data):
        many = f"{needed} parameters of the model describe the response to u"
        yield warning("excitation", f"{poor_input(order, many)}, or lower the orders")
    yield from _about_rails(data)
    poles = fit.poles()
    apart = np.all(np.abs(poles.values - 1) > _MIN_POLE_SIGMAS * np.asarray(poles.std))
    if known.integration.notes and not fit.integrator and not (fit.converged and apart):
        found = _about_integrator(known.integration)
        yield replace(found, level="warning", remedy=found.remedy or "integrator")
    if known.together:
        yield from about_feedback(known)
    late = known.late
    if isinstance(late, str):
        yield _about_delay(known)
    elif not (free or late.interval[0] <= fit.nk <= late.interval[1]):
        way_out = 'estimate the delay (delay "estimate")' if in_s else f"use nk={late.nk}"
        text = f"u acts from lag {late.nk} on, and the model begins at lag {fit.nk}: {way_out}"
        yield warning("delay", text, "check")


def _about_input(data: Dataset) -> Finding:
    order = excitation_order(data)
    if order >= 2 * ORDER:
        text = f"u is exciting of order {order} at least: enough for {order} parameters of B and F "
        return good("excitation", text + "(or B and A) together")
    if constant_input(data):
        return warning("excitation", CONSTANT_INPUT)
    many = f"a model of order {ORDER} has {2 * ORDER} parameters of B and F (or B and A)"
    return warning("excitation", poor_input(order, many))


def poor_input(order: int, parameters: str) -> str:
    """Return a text about an input that does not determine so many parameters."""
    return f"u is exciting of order {order} only, and {parameters}: {_RICHER}"


def _about_rails(data: Dataset) -> Iterator[Finding]:
    """Yield a warning if y stays exactly at its largest or smallest value."""
    at, rails = rails_of(data.y) if data.valid.any() else (data.valid, [])
    if rails:
        text = f"{np.count_nonzero(at)} of {data.N} samples of {data.output} equal its "
        text += "largest or smallest value, as at the rail of a converter: mark them missing"
        yield warning("rails", text + " (--mask-rails)", "rails")


def _about_integrator(decided: Integration) -> Finding:
    if decided.unstable:
        text = "y grows without u: a pole is outside the unit circle, and OE and BJ cannot model "
        return warning("unstable", f"{text}it; take ARMAX or ARX, and predict", "check")
    if not decided.integrates:
        hidden = "not shown, because a slow pole looks the same"
        return good("integrator", hidden if decided.undecided else "none is seen")
    text = decided.reason or "the output is an angle"
    text += ": fix its pole (OE with the option integrator), and remove no linear trend"
    text += "; --assume settling, if it settles" * bool(decided.reason)
    return good("integrator", text)


def _about_outliers(data: Dataset) -> Finding:
    try:
        count, text = looking_wrong(data)
    except ValueError as err:
        return good("outliers", f"not looked for: {err}")
    if not count:
        return good("outliers", "none")
    text += ", and a model follows them: mark them missing (hampel)"
    return warning("outliers", text, "outliers")


def _about_drift(data: Dataset) -> Iterator[Finding]:
    try:
        found = drift(data, integrator=False)
    except ValueError:
        return
    for i, line in enumerate(found, 1):
        name = "drift" if len(found) == 1 else f"drift {i}"
        drifts = abs(line.z) > 2.58
        remedy = "; remove it, detrend(data, order=1)"
        yield warning(name, f"{line}{remedy}") if drifts else good(name, str(line))


def about_feedback(known: Tested) -> Iterator[Finding]:
    """Yield the result of the test for feedback."""
    loop = known.loop
    if loop is None:
        return
    if loop.feedback is None:
        yield good("feedback", f"not tested: {'; '.join(loop.remarks)}")
        return
    p = f"p {p_relation(loop.p_value)}"
    if not loop.feedback:
        yield good("feedback", f"none is found ({p})")
        return
    able = "ARMAX or ARX" if known.integration.unstable else "ARMAX or BJ"
    text = f"u depends on {loop.output} ({p}): OE, spectra and correlations are biased; use {able} "
    text = "; ".join([f"{text}with nk >= 1, or record in open loop", *loop.remarks])
    if loop.p_value >= CHANCE_LEVEL:
        chance = f"one open-loop recording in {1 / loop.level:.0f} has p < {loop.level:g}"
        text += f". By chance {chance}"
    yield warning("feedback", text, "check")


def _about_delay(known: Tested) -> Finding:
    late = known.late
    if isinstance(late, str):
        return warning("delay", f"not found: {late}", "check")
    return good("delay", late.answer if late.told else f"{late.answer}; take nk = {late.nk}")
