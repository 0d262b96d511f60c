"""Advice on data or on a model: findings, each with its remedy."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from armrig.data.argument import HasDataset, takes_recordings
from armrig.data.columns import constancy
from armrig.data.dataset import Dataset, Signals
from armrig.data.files.column_faults import rails_of
from armrig.data.finding import Finding, few_samples, good, lines_of, warning
from armrig.data.step import LINE, MEAN, codes_of, laws_text
from armrig.data.treatment import drift, hampel, integrates_by_name
from armrig.data.treatment.integrating import Integration, integration, may_be_one
from armrig.estimation.data_faults import (
    CONSTANT_INPUT,
    NO_OPTION,
    OFFSET_OF_TRANSIENT,
    constant_input,
    level_without_input,
    looking_wrong,
)
from armrig.excitation.input_description import excitation_order
from armrig.models.characteristics import overlapping
from armrig.models.equation import explains_nothing, whiteness_sentence
from armrig.models.fit import Fit
from armrig.models.structure_table import CHANNEL, DESCRIBED, RegisteredStructure
from armrig.models.transfer_function import TransferFunction
from armrig.numerics.quantities import digits, join_names, near_one, p_relation, percent, plural
from armrig.numerics.whiteness import BAND_99_PERCENT
from armrig.validation.feedback_and_delay.by_channel import ByChannel, Name, each_channel
from armrig.validation.feedback_and_delay.delay import delay
from armrig.validation.feedback_and_delay.delay_result import Delay
from armrig.validation.feedback_and_delay.open_loop import CHANCE_LEVEL, OpenLoop, open_loop
from armrig.validation.linearity import in_open_loop

COLOURED = "raise the orders, look at the delay, or add a noise model"
"""Remedy for residuals that are not white."""
_FIX_POLE = "fix it (OE with the option integrator)"
_FIX_POLE_IN_S = "fix it (TF with the option integrator, or a process with the letter I)"
_MAX_IMAGINARY = 1e-9  # imaginary part below which a pole counts as real
_MAX_DISTANCE_FROM_ONE = 0.01  # distance in the z plane below which a pole or zero is near 1
_SAME_POLE = 1e-6  # distance in the z plane of equal poles of two channels
_Pair = tuple[complex, complex, float]
"""A pole, a zero, and the p value of their difference."""
ORDER = 4
"""Order of the model for which u must be exciting; the arm has 4 poles."""
_MAX_MISSING_SHARE = 0.2
_RICHER = "play a u that switches often (telegraph, PRBS)"
_MIN_POLE_SIGMAS = 10.0  # least distance from 1, in σ, of a pole that is not 1; σ may be too small


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Advice:
    """Findings of `advice`; its repr prints them."""

    of: str
    """Subject of the advice."""
    findings: tuple[Finding, ...]
    """All findings, also those of level "good"."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Texts of the findings that need action."""
        return tuple(f.text for f in self.findings if f.level != "good")

    def explain(self) -> str:
        """Return a line for each finding; the findings that need action are first."""
        return lines_of(sorted(self.findings, key=lambda f: f.level == "good"))

    def __repr__(self) -> str:
        """Return a count and the findings."""
        count = len(self.warnings)
        summary = f"{count} to act on" if count else "nothing to act on"
        return f"advice on {self.of}: {summary}\n{self.explain()}"


def advice(data_or_fit: Dataset | HasDataset | Fit) -> Advice:
    """Examine data or a model, and return the findings with their remedies.

    For data, the advice covers excitation, integrator, missing samples, outliers, drift, feedback,
    delay and linearity. For a model, it contains the findings of the estimation. It also covers the
    residuals, superfluous orders, an integrator that is not fixed, and a delay.

    Parameters
    ----------
    data_or_fit : Dataset, Signals, Recording or Fit
        Data or model to examine. Each channel of several signals is examined separately. In the
        data of a channel the other inputs are part of the noise, but outliers and a level are
        sought with all inputs.

    Returns
    -------
    Advice
        Its fields are .findings and .warnings; its repr prints the findings. For several signals,
        the result is `ByChannel`: `found["y", "u"]` is the advice on one channel.

    Raises
    ------
    TypeError
        The argument is neither data nor a model.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, chapters 14 and 16.

    Examples
    --------
    >>> data = armrig.example_recording().dataset("alpha")
    >>> print(armrig.advice(armrig.oe(data, nb=3, nf=3)))
    advice on OE[3 3 1] of alpha: nothing to act on
      search     one minimum
      residuals  residuals white (p = 0.10..., portmanteau test): trust the ordinary deviations
      order      no pole is cancelled by a zero
    """
    if not isinstance(data_or_fit, Fit):
        return _advice_on_data(data_or_fit)
    fit = data_or_fit
    each = dict(_examine_channels(fit))
    if (fit.ny, fit.nu) == (1, 1):
        return each[fit.outputs[0], fit.inputs[0]]
    together = Advice(of=fit.label, findings=fit.findings).explain()
    return ByChannel(results=each, refused={}, together=together)  # type: ignore[return-value]


@each_channel(lambda data, y, u: (data.dataset(y, u), {"whole": data.channels([y])}))
@takes_recordings
def _advice_on_data(data: Dataset, whole: Signals | None = None) -> Advice:
    if text := constancy(data.output, data.y):
        faults = (_about_input(data), warning("output", text))
        return Advice(of=f"{plural(data.N, 'sample')} of {data.output}", findings=faults)
    preliminary = preliminary_tests(data, None, whole)
    each = in_open_loop(data, preliminary.loop)
    tests = [(warning if t.sure else good)("linearity", t.line) for t in each]
    findings = (*few_samples(data.N), *examine_experiment(data, preliminary, whole), *tests)
    return Advice(of=f"{plural(data.N, 'sample')} of {data.output}", findings=findings)


def _examine_channels(model: Fit) -> Iterator[tuple[Name, Advice]]:
    """Yield the names of each channel and the advice on it, with the findings of the estimation."""
    kind = DESCRIBED.get(model.structure, CHANNEL)
    # A model in continuous time is examined as sampled.
    fit = model if model.Ts else model.to_discrete()
    channels = {(fit.outputs[i], fit.inputs[j]): estimate for i, j, estimate in fit.channels()}
    pairs = {name: overlapping(estimate) for name, estimate in channels.items()}
    # Of channels with the same poles, a pole is superfluous only if a zero cancels it in each.
    everywhere = [*pairs.values()] if fit.shared or fit.form.coupled else []
    # The findings of the estimation of several signals are not about a single channel.
    fit_findings = fit.findings if (fit.ny, fit.nu) == (1, 1) else ()
    topics = {f.about for f in fit_findings}
    for name, estimate in channels.items():
        superfluous = [p for p in pairs[name] if all(_cancels(p[0], peers) for peers in everywhere)]
        search = replace(estimate.search, starts=fit.search.starts)
        channel = replace(estimate, search=search, findings=fit_findings)
        advised = _findings_of_channel(channel, pairs[name], superfluous, kind)
        findings = [*fit_findings, *(f for f in advised if f.about not in topics)]
        # A model of a constant level has a pole near 1, too.
        level = any(f.about == "level" for f in findings)
        findings = [f for f in findings if not (level and f.about == "integrator")]
        yield name, Advice(of=f"{model[name].label} of {name[0]}", findings=tuple(findings))


def _cancels(pole: complex, pairs: list[_Pair]) -> bool:
    return any(abs(pole - other) < _SAME_POLE for other, *_ in pairs)


def _findings_of_channel(
    fit: Fit, pairs: list[_Pair], superfluous: list[_Pair], kind: RegisteredStructure
) -> Iterator[Finding]:
    if fit.search.converged and fit.search.agreed:
        yield good(
            "search", "one minimum" if fit.search.starts or kind.continuous else "closed form"
        )
    text = whiteness_sentence(fit, "the ordinary deviations", "the robust deviations")
    if fit.trusts_robust:
        yield warning("residuals", f"{text}; {COLOURED}", "search")
    else:
        yield (warning if explains_nothing(fit) else good)("residuals", text)
    apart = [p for p in superfluous if not _at_one(p)]
    if pairs and not superfluous:
        yield good("order", "each pole is needed in a channel")
    elif apart or not superfluous:
        yield _about_overlap(apart, kind)
    yield from _about_pair_at_one(fit, [p for p in superfluous if _at_one(p)])
    yield from _about_negative_poles(fit)
    if not any(map(_at_one, pairs)):
        yield from _about_pole_at_1(fit, kind)
    if not kind.continuous:
        yield from _about_first_coefficient(fit)


def _at_one(pair: _Pair) -> bool:
    """Return whether a pole and a zero are near 1: they model a constant."""
    return max(abs(pair[0] - 1), abs(pair[1] - 1)) < _MAX_DISTANCE_FROM_ONE


def _about_overlap(pairs: list[_Pair], kind: RegisteredStructure) -> Finding:
    if not pairs:
        return good("order", "no pole is cancelled by a zero")
    places = ", ".join(f"{_z(pole)} and {_z(zero)}" for pole, zero, _ in pairs)
    text = f"pole and zero {places} (z plane) cannot be distinguished: they cancel, and the order "
    each = [name for name in ("nb", kind.poles) if name in kind.orders]
    lower = " and ".join(each) or "the number of time constants"
    text += f"is too high by the number of pairs; lower {'the ' * (lower == 'order')}{lower}"
    return warning("order", text, "order", poles=sum(2 if pole.imag else 1 for pole, *_ in pairs))


def _about_pair_at_one(fit: Fit, pairs: list[_Pair]) -> Iterator[Finding]:
    """Yield the finding about a pole and a zero near 1: a constant level, or too high an order."""
    without = fit.offset or MEAN in codes_of(fit.history)
    for pole, zero, _ in pairs[:1]:
        if without:
            text = f"pole {_z(pole)} and zero {_z(zero)} cancel, although the level was removed or "
            yield warning("order", f"{text}estimated: lower the order", "order", poles=1)
            return
        text = f"pole {_z(pole)} and zero {_z(zero)} cancel: they model a constant of "
        text += f"{fit.output} that u does not explain; remove the means (detrend), or estimate "
        text += "an offset (option offset)"
        yield warning("level", text, "level")


def _about_negative_poles(fit: Fit) -> Iterator[Finding]:
    for z, std in _real_poles(fit):
        if z + BAND_99_PERCENT * std < 0:
            text = f"pole {_z(z)} is real and negative: no rig in continuous time has such a pole "
            text += "after sampling (exp(s Ts) > 0), so it models noise; lower the order"
            yield warning("poles", text, "order")


def _real_poles(fit: Fit) -> list[tuple[float, float]]:
    """Return the real poles, with their standard deviations."""
    poles = zip(fit.poles().values, fit.poles().std, strict=True)
    return [(z.real, std) for z, std in poles if abs(z.imag) < _MAX_IMAGINARY]


def _about_pole_at_1(fit: Fit, kind: RegisteredStructure) -> Iterator[Finding]:
    at_1 = [pole for pole in _real_poles(fit) if may_be_one(*pole, fit.N)]
    if not fit.integrator and (at_1 or integrates_by_name(fit.output)):
        text = f"{fit.output} integrates, and no pole of the model is 1"
        text = f"pole {near_one(*at_1[0])} is 1 within its accuracy" if at_1 else text
        has = kind.continuous or "integrator" in kind.takes
        fix = _FIX_POLE_IN_S if kind.continuous else _FIX_POLE
        yield warning("integrator", f"{text}: {fix}", "integrator" if has else "structure")


def _about_first_coefficient(fit: Fit) -> Iterator[Finding]:
    i = fit.slice_of("b").start
    b, std = float(fit.theta[i]), float(fit.std_robust[i])
    if std > 0 and abs(b) < BAND_99_PERCENT * std:
        text = (
            f"b1 = {digits(b, 2)} ± {digits(std, 2)} does not differ significantly from 0: a "
            "delay, or only "
        )
        text += "noise; a test decides (armrig.delay, `armrig check`)"
        yield warning("delay", text)


def _z(z: complex) -> str:
    return f"{z.real:.3f}" if abs(z.imag) < _MAX_IMAGINARY else f"{z.real:.3f} ± {abs(z.imag):.3f}i"


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
        """True if a law controlled the run, or feedback or a direct term has p < 0.1 %."""
        return self.loop is not None and self.loop.sure


def preliminary_tests(data: Dataset, integrator: bool | None, all_inputs: Signals | None) -> Tested:
    """Test for an integrator, feedback and a delay; `all_inputs` has all inputs of the output."""
    decided = integration(data, integrator, all_inputs)
    late: Delay | str
    try:
        late = delay(data, integrator=decided.integrates)
    except ValueError as err:
        late = str(err)
    return Tested(integration=decided, loop=_loop(data), late=late)


def _loop(data: Dataset) -> OpenLoop | None:
    """Return the test for feedback; None for too few samples, or if only one sample moves."""
    y = data.y[data.valid]
    if np.count_nonzero(y != np.median(y)) <= 1:
        return None
    with suppress(ValueError):
        return open_loop(data)
    return None


def doubts_of_channels(data: Signals) -> Iterator[Finding]:
    """Yield the doubts about each input, and about the feedback in each channel."""
    for input in data.inputs:
        finding = _about_input(data.dataset(data.outputs[0], input))
        if finding.level != "good":
            yield replace(finding, text=f"{input}: {finding.text}")
        for output in data.outputs:
            loop = _loop(data.dataset(output, input))
            tests = Tested(integration=Integration(integrates=False), loop=loop, late="")
            for finding in about_feedback(tests) if tests.together else ():
                yield replace(finding, text=f"{input} to {output}: {finding.text}")


def examine_experiment(
    data: Dataset, tests: Tested, all_inputs: Signals | None = None
) -> Iterator[Finding]:
    """Yield the findings that need no model; `all_inputs` has all inputs of the output."""
    all_inputs = all_inputs or data.signals()
    yield _about_input(data)
    yield _about_integrator(tests.integration)
    yield from _about_rails(data)
    if data.missing:
        share = data.missing / data.N
        text = f"{percent(100 * share)} of the samples: no estimator replaces them by a value"
        yield (good if share < _MAX_MISSING_SHARE else warning)("missing", text)
    if not tests.together:  # in closed loop a step of the set point makes y and u jump
        yield _about_outliers(all_inputs)
    if not tests.integration.integrates and not tests.integration.unstable:
        if level := level_without_input(all_inputs):
            remedy = OFFSET_OF_TRANSIENT if data.trends else NO_OPTION
            yield replace(level, text=f"{level.text}: {remedy}")
        yield from _about_drift(data)
    if integrates_by_name(data.output) and LINE in codes_of(data.history):
        text = "a line was removed from an output that integrates: it was the response to the mean "
        yield warning("trend", text + "of u, not a drift; begin again from the recording")
    yield from about_feedback(tests)
    yield _about_delay(tests)


def examine_fit_of(
    data: Dataset | Signals, fit: Fit, integrator: bool | None = None
) -> Iterator[Finding]:
    """Yield the findings on length, excitation, integrator, feedback and delay for the model.

    The findings of several signals are those on the length, and on the excitation and feedback of
    each channel.
    """
    yield from few_samples(data.N)
    if (fit.ny, fit.nu) != (1, 1):
        yield from (f for f in doubts_of_channels(data.signals()) if f.remedy != "noise")
        return
    data = data.signals().dataset()
    tests = preliminary_tests(data, fit.integrator or integrator, None)
    free = isinstance(fit.form, TransferFunction) and fit.form.delay_estimated
    in_s, fit = fit.Ts == 0, fit.to_discrete() if fit.Ts == 0 else fit
    order, needed = excitation_order(data), sum(s.stop - s.start for s in map(fit.slice_of, "bfa"))
    if order < needed and not constant_input(data):
        singular, more = "parameter of the model describes", "parameters of the model describe"
        many = f"{plural(needed, singular, more)} the response to u"
        yield warning("excitation", f"{poor_input(order, many)}, or lower the orders")
    yield from _about_rails(data)
    poles = fit.poles()
    apart = np.all(np.abs(poles.values - 1) > _MIN_POLE_SIGMAS * np.asarray(poles.std))
    if tests.integration.notes and not fit.integrator and not (fit.search.converged and apart):
        finding = _about_integrator(tests.integration)
        yield replace(finding, level="warning", remedy=finding.remedy or "integrator")
    if tests.together and not (tests.loop and tests.loop.laws):  # the fit has a finding on laws
        yield from about_feedback(tests)
    late = tests.late
    if isinstance(late, str):
        yield _about_delay(tests)
    elif not (free or late.interval[0] <= fit.nk <= late.interval[1]):
        way_out = 'estimate the delay (delay "estimate")' if in_s else f"use nk={late.nk}"
        text = f"u acts from lag {late.nk} on, and the model begins at lag {fit.nk}: {way_out}"
        yield warning("delay", text, "nk", nk=late.nk)


def _about_input(data: Dataset) -> Finding:
    order = excitation_order(data)
    if order >= 2 * ORDER:
        text = (
            f"u is exciting of order {order} at least: enough for "
            f"{plural(order, 'parameter')} of B and F "
        )
        return good("excitation", text + "(or B and A) together")
    if constant_input(data):
        return warning("excitation", CONSTANT_INPUT)
    many = f"a model of order {ORDER} has {plural(2 * ORDER, 'parameter')} of B and F (or B and A)"
    return warning("excitation", poor_input(order, many))


def poor_input(order: int, parameters: str) -> str:
    """Return a text about an input that does not determine so many parameters."""
    return f"u is exciting of order {order} only, and {parameters}: {_RICHER}"


def _about_rails(data: Dataset) -> Iterator[Finding]:
    """Yield a warning if y stays exactly at its largest or smallest value."""
    at, rails = rails_of(data.y) if data.valid.any() else (data.valid, [])
    if rails:
        text = f"{np.count_nonzero(at)} of {data.N} samples of {data.output} are at its largest or "
        text += "smallest value, as at a converter's rail: mark them missing "
        text += "(`armrig import` with --mask-rails)"
        yield warning("rails", text, "rails")


def _about_integrator(decided: Integration) -> Finding:
    if decided.unstable:
        text = "y grows without u: a pole is outside the unit circle, and OE and BJ cannot model "
        return warning("unstable", f"{text}it; take ARMAX or ARX, and predict", "check")
    if not decided.integrates:
        hidden = "not shown, because a slow pole looks the same"
        none = f"none is seen{without_others(decided.others)}"
        return good("integrator", hidden if decided.undecided else none)
    text = decided.reason or "the output is an angle"
    text += ": fix its pole (OE with the option integrator), and remove no linear trend"
    text += "; --assume settling, if it settles" * bool(decided.reason)
    return good("integrator", text)


def without_others(others: tuple[str, ...]) -> str:
    """Return a text about inputs without which y would seem to integrate; "" without such."""
    return f"; without {join_names(others)}, y would seem to integrate" if others else ""


def _about_outliers(data: Signals) -> Finding:
    try:
        count, text = looking_wrong(data)
        if count and any(t.sure for t in in_open_loop(hampel(data))):
            # A nonlinear rig differs from a linear model in right samples, too.
            count, text = looking_wrong(data, instrument=True)
    except ValueError as err:
        return good("outliers", f"not looked for: {err}")
    if not count:
        return good("outliers", "none")
    text += ", and a model follows them: mark them missing (hampel)"
    return warning("outliers", text, "outliers")


def _about_drift(data: Dataset) -> Iterator[Finding]:
    with suppress(ValueError):
        lines = drift(data, integrator=False)
        for i, line in enumerate(lines, 1):
            name = "drift" if len(lines) == 1 else f"drift {i}"
            drifts, changes = abs(line.z) > BAND_99_PERCENT, line.change_s is not None
            remedy = "; remove it, detrend(data, order=1)" if drifts else ""
            if line.change_s is not None:
                at = data.starts[i - 1] + round(line.change_s / data.Ts)
                remedy = f"; a model of one part needs data[:{at}] or data[{at}:]"
            yield (warning if drifts or changes else good)(name, f"{line}{remedy}")


def about_feedback(tests: Tested) -> list[Finding]:
    """Return the result of the test for feedback; [] without a test."""
    if (loop := tests.loop) is None:
        return []
    able = "ARMAX or ARX" if tests.integration.unstable else "ARMAX or BJ"
    if loop.laws:
        text = f"controlled by {laws_text(loop.laws)}: coloured noise in the loop biases OE, "
        text += f"spectra and correlations; use {able} with nk >= 1, or armrig.two_stage"
        tested = f"Sims' test: p {p_relation(loop.p_value)}" if loop.sims else "no test"
        return [warning("feedback", f"{text} ({tested})", "noise")]
    if loop.feedback is None:
        return [good("feedback", f"not tested: {'; '.join(loop.remarks)}")]
    p = f"p {p_relation(loop.p_value)}"
    if not loop.feedback:
        return [good("feedback", f"none is found ({p})")]
    claim = f"the data look as if u depends on {loop.output}"
    if loop.may_be_direct_term:
        claim += f", or {loop.output} on u of the same sample"
    text = f"{claim} ({p}): with feedback, OE, spectra and correlations are biased; use {able} "
    text = "; ".join([f"{text}with nk >= 1, or record in open loop", *loop.remarks])
    if loop.p_value >= CHANCE_LEVEL:
        chance = f"one open-loop recording in {1 / loop.level:.0f} has p < {loop.level:g}"
        text += f". By chance {chance}"
    return [warning("feedback", text, "check")]


def _about_delay(tests: Tested) -> Finding:
    late = tests.late
    if isinstance(late, str):
        return warning("delay", f"not found: {late}")
    return good("delay", late.answer if late.told else f"{late.answer}; take nk = {late.nk}")
