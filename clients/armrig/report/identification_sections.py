"""Section 3 of the handout: results from the recordings."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import zip_longest
from math import isfinite
from typing import Any

from armrig_core.rig.arm import ArmParameters

from armrig import plots
from armrig.estimation.nonparametric.sampling_time import SamplingTime
from armrig.models.equation import letters, typst_form
from armrig.models.fit import Fit
from armrig.numerics.quantities import (
    NBSP,
    digits,
    error,
    join_names,
    milliseconds,
    minus,
    number,
    p_relation,
    p_value,
    percent,
    places,
    plural,
    power,
    with_decimals,
    with_std,
    with_unit,
)
from armrig.physics.grey_box.fit import GreyFit
from armrig.physics.grey_box.split_study import SplitStudy
from armrig.report.handout_study import HandoutStudy
from armrig.report.model_facts import deviations, integrator_sentences, without_arm
from armrig.report.recording_facts import linearity_sentences, without_turns
from armrig.report.sections import ReportTable, Section, figure
from armrig.report.study import Study
from armrig.validation.comparison import compare
from armrig.validation.feedback_and_delay.delay_result import Delay
from armrig.validation.feedback_and_delay.open_loop import OpenLoop
from armrig.validation.structure_hints import StructureHints

_STEP = "armrig collect step"
_BLACKBOX = "armrig collect blackbox --validation"
_GREYBOX = "armrig collect greybox"


def identification_sections(study: HandoutStudy) -> dict[str, Section]:
    """Return sections 3.1 to 3.8 by number; a section without a result contains the reason."""
    assignments: dict[str, tuple[str, str, Callable[[HandoutStudy, Any], Section]]] = {
        "3.1": ("sampling", _STEP, _sampling),
        "3.2": ("hints", _BLACKBOX, _hints),
        "3.3": ("black", _BLACKBOX, _black_box),
        "3.4": ("black", _BLACKBOX, _comparison),
        "3.5": ("grey", _GREYBOX, _grey_box),
        "3.6": ("split", _GREYBOX, _split),
        "3.7": ("loop", _BLACKBOX, _loop),
        "3.8": ("delay", _BLACKBOX, _delay),
    }
    return {number_: _section(study, *row) for number_, row in assignments.items()}


def _section(
    study: HandoutStudy, name: str, command: str, answer: Callable[[HandoutStudy, Any], Section]
) -> Section:
    """Return the answer from a result, or the command that makes the missing recording."""
    if (result := getattr(study, name)) is not None:
        return answer(study, result)
    refused = study.refused.get(name, "")
    lack = f"No result: {refused}." if refused else "No recording for this assignment yet."
    if command == _GREYBOX:
        lack += " Remove the rotating part before recording (handout, figure 6)."
    return _lacking(lack, command)


def _lacking(reason: str, command: str) -> Section:
    return Section(lack=f"{reason} Record it with `{command}`, then make the report again.")


def _sampling(study: HandoutStudy, advice: SamplingTime) -> Section:
    low, high = advice.Ts_transient
    measured = f"the time to 63 % is {milliseconds(round(advice.tau, 5))}"
    if study.step is not None:
        tau, std = 1e3 * study.step.tau, 1e3 * study.step.tau_std
        measured = f"the time to 63 % is {with_std(tau, std)} ms (one standard deviation)"
    used = "" if study.black is None else milliseconds(study.black.estimation.Ts)
    other = f" The models below use {used}." if used not in ("", milliseconds(advice.Ts)) else ""
    how = "a step response" if advice.from_step else "an impulse response (no step was recorded)"
    return Section(
        paragraphs=(
            f"The recommended sampling time is {milliseconds(advice.Ts)}. From {how}, {measured}. "
            f"$omega_s = 20 slash tau$ then gives {number(1e3 * advice.Ts_step)} ms. The spectrum "
            f"is at −3 dB at {number(advice.omega_spectrum)} rad/s, which gives "
            f"{number(1e3 * advice.Ts_spectrum)} ms. 7 to 10 samples in the transient of "
            f"{number(1e3 * advice.settling)} ms give $T_s$ = {number(1e3 * low)} to "
            f"{number(1e3 * high)} ms.{other}",
        ),
        figures=figure(
            "sampling",
            "(a) Rate of θ₁ after a step, divided by its final value, at the recommended "
            "instants; (b) frequency response and power of the output.",
            2.6,
            advice.plot,
        ),
    )


def _hints(_: HandoutStudy, hints: StructureHints) -> Section:
    integrator = "one of them an integrator, " if hints.integrator else ""
    peaks, dips = (
        f"{', '.join(number(w) for w in marks)} rad/s" if marks else "none"
        for marks in (hints.resonances, hints.antiresonances)
    )
    slope = ""
    if hints.low_slope is not None:
        slope = f"At low frequency $abs(G)$ falls by {minus(f'{-hints.low_slope:.1f}')} dB per "
        slope += "decade (an integrator: 20 dB). "
    return Section(
        paragraphs=(
            f"{plural(hints.nf, 'pole')}, {integrator}nb = {hints.nb} and nk = {hints.nk}. The "
            "structure is output error, because the noise arises in the potentiometer.",
            f"{slope}Resonances, two poles each: {peaks}; antiresonances, two zeros each: {dips}. "
            f"The order: {next(f.text for f in hints.findings if f.about == 'order')}.",
        ),
        figures=figure(
            "structure",
            "(a) Spectral analysis with slopes and resonances; (b) description lengths.",
            2.6,
            hints.plot,
        ),
    )


def _black_box(study: HandoutStudy, black: Study) -> Section:
    best = black.best
    halves = " (the second half of the recording)" if black.halves else ""
    nb, nf = (best.model.orders.get(name) for name in ("nb", "nf"))
    hints = study.hints
    roots = "".join(f"{text} " for text in integrator_sentences(black))
    other = ""
    if hints is not None and nf is not None and (nb, nf) != (hints.nb, hints.nf):
        other = (
            f" It has nb = {nb} and nf = {nf}, not the orders of 3.2; `--nb` and `--nf` set the "
        )
        other += "orders."
    return Section(
        paragraphs=(
            f"The {best.name} model simulates the validation data{halves} with an rms error of "
            f"{error(best.comparison.rms_error, black.validation.unit)}. It is estimated from "
            f"{best.model.N} of {black.estimation.N} samples at "
            f"{milliseconds(black.estimation.Ts)}: for these samples the angle and its past are "
            f"known.{other}",
            f"$ {', quad '.join([typst_form(best.model), *_polynomials(best.model)])} $",
            f"The equation contains the delay $q^(-1)$ and white noise $e(t)$. {roots}The rms "
            "error is the error of the simulated angle on the validation data. p white and p "
            "dynamics are the p values of two hypotheses: the residuals are white, and past input "
            "does not explain the residuals. A value below 0.01 speaks against the model.",
            *linearity_sentences(black.validation),
        ),
        tables=(_coefficients(black), _validation(black)),
        figures=figure(
            "residuals",
            f"Residuals of the {best.name} model on validation data: correlation "
            "with themselves (a) and with the input (b).",
            1.85,
            best.tests.plot,
        ),
    )


def _polynomials(model: Fit) -> list[str]:
    """Return the definition of each polynomial of a model, in Typst's mathematics."""
    defined = []
    for letter in letters(model):
        part = model.slice_of(letter.lower())
        n, first = part.stop - part.start, model.nk if letter == "B" else 1
        terms = [f"{letter.lower()}_{k} q^(-{first + k - 1})" for k in sorted({1, n})]
        lead, between = "" if letter == "B" else "1 + ", " + dots.c + " if n > 2 else " + "
        defined.append(f"{letter}(q) = {lead}{between.join(terms)}")
    return defined


def _coefficients(black: Study) -> ReportTable:
    columns: dict[str, list[str]] = {}
    for m in black.estimated:
        fit = m.model
        for name, *estimate in zip(fit.names, fit.theta, fit.std, strict=True):
            decimals = places(float(estimate[1]))
            cell = " ± ".join(with_decimals(float(x), decimals) for x in estimate)
            columns.setdefault(f"{m.name}, {name[0]}_k", []).append(cell)
    rows = zip_longest(*columns.values(), fillvalue="–")
    return ReportTable(
        caption="Coefficients of the models; ± is one standard deviation.",
        header=("k", *columns),
        rows=tuple((str(k), *row) for k, row in enumerate(rows, 1)),
    )


def _validation(black: Study) -> ReportTable:
    rows = []
    for m in black.estimated:
        p = map(p_value, (m.tests.white.p_value, m.tests.missing_dynamics))
        rows.append((m.name, error(m.comparison.rms_error, black.validation.unit), *p))
    return ReportTable(
        caption="Simulation of the validation data, and tests of the residuals.",
        header=("model", "rms error", "p white", "p dynamics"),
        rows=tuple(rows),
    )


_CHARACTERISTICS = (
    ("gain", "gain [rad/(s V)]", 1.0),
    ("antiresonance", "antires. [rad/s]", 1.0),
    ("rise_time", "63 % time [ms]", 1e3),
    ("equivalent_time", "equivalent [ms]", 1e3),
    ("overshoot", "overshoot [%]", 1.0),
)
"""Characteristics of a model, with their headings and scales in a table."""


def _comparison(_: HandoutStudy, black: Study) -> Section:
    rows, unit = [], black.validation.unit
    least = error(min(row.rms_error for row in black.models), unit)
    closest = []
    for row in black.models:
        traits, velocity = row.characteristics, row.velocity_fit_percent
        size = error(row.rms_error, unit)
        if size == least:
            closest.append("the physical model" if row is black.reference else row.name)
        rows.append(
            (
                row.name,
                size,
                "–" if velocity is None else percent(velocity),
                *(
                    _figure(getattr(traits, name), traits.std.get(name, float("nan")), k)
                    for name, _, k in _CHARACTERISTICS
                ),
            )
        )
    table = ReportTable(
        caption="Models on the validation data, and characteristics of their step responses.",
        header=("model", "rms error", "fit of the rate", *(h for _, h, _ in _CHARACTERISTICS)),
        rows=tuple(rows),
    )
    are = "is closest" if len(closest) == 1 else "are equally close"
    fitted = "Nothing in the physical model was fitted."
    compared = black.reference is not None
    difference = f"{deviations(black, black)} {fitted}" if compared else without_arm(black)
    fits, names = [m.model for m in black.models], [m.name for m in black.models]
    return Section(
        paragraphs=(
            f"On the validation data {join_names(closest)} {are}, with an rms error of "
            f"{least}. {difference}",
            "The fit of the rate is $100 (1 - norm(v - w) slash norm(v - macron(v)))$ %, $v$ "
            "measured with mean $macron(v)$, $w$ simulated. This fit is below 0 % if a constant "
            "fits better. It is below 100 % even for the true system, since $v$ contains the "
            "converter's noise twice. Gain, times and overshoot describe the rate after a step. "
            "The equivalent time is the area above the rate, divided by its final value.",
        ),
        tables=(table,),
        figures=figure(
            "compare",
            f"(a) Measured and simulated angle{without_turns(black.validation)}; (b) data "
            "(dots) and models, minus the best model.",
            2.95,
            compare(black.validation, *fits, labels=names).plot,
        ),
    )


def _figure(x: float, std: float, scale: float) -> str:
    if not isfinite(x):
        return "–"
    return minus(with_std(scale * x, scale * std if isfinite(std) else 0.0))


def _grey_box(study: HandoutStudy, fit: GreyFit) -> Section:
    assert study.alone is not None  # noqa: S101  # the data of the fit
    J, std = fit.values["J_1"], fit.std["J_1"]
    handout = ArmParameters().J_1
    influence = fit.influence.get("J_1", {})
    moved = ", ".join(f"{n} {minus(f'{x:+.2f}')}{NBSP}%" for n, x in influence.items())
    fixed_ones = f" An increase of a fixed parameter by 1 % changes $J$: {moved}." if moved else ""
    return Section(
        paragraphs=(
            f"$J$ = {with_unit(J, std, 'kg m²')} (one standard deviation), "
            f"{minus(f'{100 * (J / handout - 1):+.2f}')} % from the handout's $J_1$. The chassis "
            "alone obeys, without friction,",
            "$ J dot.double(theta)_1 = (N K_m)/R_m (u - N K_m dot(theta)_1) $",
            f"With this $J$ the simulated angle fits {plural(fit.N, 'sample')} best.{fixed_ones}",
        ),
        figures=figure(
            "greybox",
            "(a) Measured and simulated angle of the chassis alone"
            f"{without_turns(study.alone)}; (b) the error.",
            2.1,
            partial(plots.plot_greybox, fit, study.alone),
        ),
    )


def _split(_: HandoutStudy, split: SplitStudy) -> Section:
    rows = tuple(
        (
            plural(s.k, "part"),
            f"{s.N.mean():.0f}",
            "; ".join(
                with_unit(float(v), float(e), "") for v, e in zip(s.values, s.std, strict=True)
            ),
        )
        for s in split.splits
    )
    caption = "Estimates from parts of the data; ± is one standard deviation."
    table = ReportTable(caption=caption, header=("", "samples each", "J [kg m²]"), rows=rows)
    first, last = split.splits[0], split.splits[-1]
    crosses = ""
    if last.k > 2:
        scatter, low, high = map(power, (last.scatter, *last.scatter_interval))
        crosses = (
            f"; the {plural(last.k, 'part')} scatter by {scatter} kg{NBSP}m², 95 % "
            f"interval {low} to "
        )
        crosses += f"{high} (χ² with {last.k - 1} degrees of freedom)"
    return Section(
        paragraphs=(
            f"If the data are divided into {plural(last.k, 'part')}, the variance of $J$ grows by "
            f"a factor of {split.std_growth**2:.2f}. A variance proportional to $1 slash N$ would "
            f"grow by a factor of {first.N.mean() / last.N.mean():.2f}. Each sample adds to the "
            "information $sum psi psi^top slash lambda$, and the covariance is the inverse of the "
            "information.",
        ),
        tables=(table,),
        figures=figure(
            "split",
            "(a) Each estimate with ±2 σ; band: weighted mean of the parts ±2 σ. "
            f"(b) σ against N{crosses}.",
            1.75,
            split.plot,
        ),
    )


def _loop(_: HandoutStudy, test: OpenLoop) -> Section:
    if test.sims is None:
        return _lacking(test.explain(), _BLACKBOX)
    s = test.sims
    verdict = "the data show FEEDBACK" if test.feedback else "nothing speaks against open loop"
    verdict = test.verdict if test.laws else verdict
    return Section(
        paragraphs=(
            f"p {p_relation(test.p_value)} in Sims' F-test ($F$ = {digits(s.F, 3)} with {s.q} and "
            f"{s.degrees} degrees of freedom): {verdict}.",
            "$theta_1(t)$ is regressed on its own past, past $u$, and $u(t), dots, u(t + 4)$. "
            "$theta_1$ is read before $u$ is applied. In open loop $u(t)$ and later inputs "
            "therefore add nothing to the information of the past on $theta_1(t)$.",
        ),
        figures=figure(
            "loop",
            "Coefficients of u in the regression of θ₁(t). The band contains 99 % of the "
            "estimates of a coefficient that is 0. Coefficients of past input, lags from 1 on, may "
            "be outside the band.",
            1.6,
            test.plot,
        ),
    )


def _delay(_: HandoutStudy, test: Delay) -> Section:
    samples = "no delay: $u$ acts one sample later, as with every zero-order hold"
    if test.delay > 0:
        samples = f"a delay of {plural(test.delay, 'sample')} in addition to the zero-order hold"
    g, std = test.response.decaying
    lags = range(min(test.nk + 2, g.size))
    sizes = ", ".join(f"{minus(f'{g[k] / std[k]:+.1f}')} σ at lag {k}" for k in lags if std[k] > 0)
    ps = join_names([f"p {p_relation(p)} up to lag {k}" for k, p in test.p_values.items()])
    return Section(
        paragraphs=(
            f"{test.nk_range}, {samples}.",
            f"Joint tests of the first coefficients of $u$ in an ARX model: {ps}. The impulse "
            f"response of the rate of $theta_1$ is {sizes}.",
        ),
        figures=figure(
            "delay",
            "(a) Impulse response. The band contains 99.9 % of the estimates of a coefficient "
            "that is 0. (b) Loss of ARX models against nk. A model below the dotted line is not "
            "significantly worse than the best model (level 0.1 %).",
            1.75,
            test.plot,
        ),
    )
