"""What data are fit for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from armrig.data.dataset import Dataset
from armrig.data.finding import Finding
from armrig.data.step import LINE, codes_of
from armrig.data.treatment import INTEGRATING_OUTPUTS, drift, hampel
from armrig.estimation.arx import arx
from armrig.estimation.data_faults import NO_OPTION, level_without_input
from armrig.estimation.nonparametric.integrator import Integration, integration
from armrig.estimation.oe import oe
from armrig.excitation.input_description import describe_input
from armrig.models.fit import Fit
from armrig.numerics.quantities import NBSP, p_relation, percent, plural, times
from armrig.validation.advice.finding import finding
from armrig.validation.feedback_and_delay.delay import delay
from armrig.validation.feedback_and_delay.delay_result import Delay
from armrig.validation.feedback_and_delay.open_loop import OpenLoop, open_loop

ORDER = 4
"""Poles of the models that are compared, and coefficients of their numerators: those of the arm."""
_AGREE = 0.1  # median of |G_ARX - G_OE| / |G_OE|
_MOST_MISSING = 0.2
_SURELY = 10.0  # deviations of a pole from 1: where it is right, a few would do
_CHANCE = 1e-3  # p value from which one open-loop recording in twenty is called closed by chance


@dataclass(frozen=True, slots=True, kw_only=True)
class Tested:
    """What is tested before a model is chosen."""

    integration: Integration
    """Whether y is taken as integrating."""
    loop: OpenLoop | None
    """The test for feedback, None where there are too few samples."""
    late: Delay | str
    """The test for a delay, or why there is none."""

    @property
    def closed(self) -> bool:
        """There is feedback, beyond what chance makes of one open-loop recording in twenty.

        Not where a direct term looks the same.
        """
        return self.together and not (self.loop is not None and self.loop.may_be_direct_term)

    @property
    def together(self) -> bool:
        """There is feedback or a direct term, beyond what chance makes."""
        return self.loop is not None and self.loop.p_value < _CHANCE


def tested(data: Dataset, integrator: bool | None) -> Tested:
    """Test data for an integrator, feedback and a delay."""
    decided = integration(data, integrator)
    return Tested(
        integration=decided, loop=_loop(data), late=_late(data, integrates=decided.integrates)
    )


def _loop(data: Dataset) -> OpenLoop | None:
    try:
        return open_loop(data)
    except ValueError:
        return None


def _late(data: Dataset, *, integrates: bool) -> Delay | str:
    try:
        return delay(data, integrator=integrates)
    except ValueError as err:
        return str(err)


def examine_data(data: Dataset) -> Iterator[Finding]:
    """Iterate over the points, in the order in which one would look."""
    known = tested(data, None)
    findings = [*examine_experiment(data, known)]
    yield from findings
    if all(f.level == "good" for f in findings):  # else the cause of a difference is known
        yield from _about_structures(data, known)


def doubts(data: Dataset, known: Tested) -> list[Finding]:
    """Return what speaks against the data; of feedback only what chance hardly makes (0.1 %)."""
    found = [f for f in examine_experiment(data, known) if f.level != "good"]
    return [f for f in found if f.about != "feedback" or known.together]


def examine_experiment(data: Dataset, known: Tested) -> Iterator[Finding]:
    """Iterate over what is looked at before any model."""
    yield _about_input(data)
    yield _about_integrator(known.integration)
    if data.missing:
        yield _about_missing(data)
    if not known.together:  # where a set point steps, the controller makes y and u jump together
        yield _about_outliers(data)
    if not known.integration.integrates:
        yield from _about_level(data)
        yield from _about_drift(data)
    yield from _about_history(data)
    yield from _about_feedback(known)
    yield from _about_delay(known)


def examine_fit_of(data: Dataset, fit: Fit) -> Iterator[Finding]:
    """Iterate over what speaks against a model of these data: feedback, its nk, its size."""
    known = tested(data, fit.integrator or None)
    order, needed = _excitation(data), _parameters_from_u(fit)
    if order < needed:
        text = f"u is exciting of order {order} only, and {needed} parameters of the model "
        text += "answer to u: play a u that switches often (telegraph, PRBS), or lower the orders"
        yield finding("excitation", text, good=False)
    if known.integration.notes and not fit.integrator and not _all_within(fit):
        yield replace(_about_integrator(known.integration), level="warning")
    if known.together:
        yield from _about_feedback(known)
    late = known.late
    if isinstance(late, str):
        yield from _about_delay(known)
    elif not late.interval[0] <= fit.nk <= late.interval[1]:
        text = f"u acts from lag {late.nk} on, and the model begins at lag {fit.nk}: nk={late.nk}"
        yield finding("delay", text, good=False)


def _all_within(fit: Fit) -> bool:
    """Tell whether the model says itself that none of its poles is 1."""
    poles = fit.poles()
    apart = np.abs(poles.values - 1) > _SURELY * np.asarray(poles.std)
    return bool(fit.converged and np.all(apart))


def _parameters_from_u(fit: Fit) -> int:
    """Return how many parameters B and F, or B and A, have together."""
    free = fit.slice_of("b"), fit.slice_of("f"), fit.slice_of("a")
    return sum(s.stop - s.start for s in free)


def _excitation(data: Dataset) -> int:
    return max(describe_input(part.u, data.Ts).order for part in data.experiments())


def _about_input(data: Dataset) -> Finding:
    order = _excitation(data)
    needed = 2 * ORDER
    if order >= needed:
        text = f"u is exciting of order {order} at least: enough for {order} parameters of B and F "
        return finding("excitation", text + "(or B and A) together", good=True)
    text = f"u is exciting of order {order} only, and a model of order {ORDER} has {needed} "
    text += "parameters of B and F (or B and A): play a u that switches often (telegraph, PRBS)"
    return finding("excitation", text, good=False)


def _about_integrator(decided: Integration) -> Finding:
    if not decided.integrates:
        return finding("integrator", "none is seen", good=True)
    text = decided.reason or "the output is an angle"
    text += ": fix its pole, oe(…, integrator=True), and remove no linear trend"
    return finding("integrator", text, good=True)


def _about_missing(data: Dataset) -> Finding:
    share = data.missing / data.N
    text = f"{percent(100 * share)} of the samples: no estimate uses a value in their place"
    return finding("missing", text, good=share < _MOST_MISSING)


def _about_outliers(data: Dataset) -> Finding:
    try:
        cleaned = hampel(data)
    except ValueError as err:
        return finding("outliers", f"not looked for: {err}", good=True)
    found = cleaned.missing - data.missing
    if not found:
        return finding("outliers", "none", good=True)
    where = ", ".join(map(str, np.flatnonzero(data.valid & ~cleaned.valid)[:5]))
    text = f"{plural(found, 'sample')} of {data.output} look wrong (first {where}), and a model "
    text += "follows them: estimate from armrig.hampel(data), which marks them missing"
    return finding("outliers", text, good=False)


def _about_level(data: Dataset) -> Iterator[Finding]:
    if level := level_without_input(data):
        yield finding("level", f"{level.text}: {NO_OPTION}", good=False)


def _about_drift(data: Dataset) -> Iterator[Finding]:
    try:
        found = drift(data)
    except ValueError:
        return
    for i, line in enumerate(found, 1):
        name = "drift" if len(found) == 1 else f"drift {i}"
        drifts = abs(line.z) > 2.58
        text = f"{line}" + ("; remove it, detrend(data, order=1)" if drifts else "")
        yield finding(name, text, good=not drifts)


def _about_history(data: Dataset) -> Iterator[Finding]:
    if data.output in INTEGRATING_OUTPUTS and LINE in codes_of(data.history):
        text = "a line was removed from an output that integrates: it was the answer to the mean "
        yield finding(
            "trend", text + "of u, not a drift; begin again from the recording", good=False
        )


def _about_feedback(known: Tested) -> Iterator[Finding]:
    loop = known.loop
    if loop is None:
        return
    if loop.feedback is None:
        yield finding("feedback", f"cannot tell: {'; '.join(loop.remarks)}", good=True)
        return
    p = f"p {p_relation(loop.p_value)}"
    if not loop.feedback:
        yield finding("feedback", f"none is found ({p})", good=True)
        return
    text = f"u answers to {loop.output} ({p}): OE, spectra and correlations are biased; use "
    text += "ARMAX or BJ with nk >= 1, or record in open loop"
    if loop.may_be_direct_term:
        text += ". A rig whose y is read after u is applied looks the same, and has nk=0; else "
        text += "take nk=1"
    if loop.p_value >= _CHANCE:
        text += f". By chance one open-loop recording in {1 / loop.level:.0f} looks so"
    yield finding("feedback", text, good=False)


def _about_delay(known: Tested) -> Iterator[Finding]:
    late = known.late
    if isinstance(late, str):
        yield finding("delay", f"cannot be told: {late}", good=False)
    elif late.delay > 0:
        late_by = times(late.delay * late.Ts).replace(" ", NBSP)
        text = (
            f"u acts from lag {late.nk} on, {plural(late.delay, 'sample')} ({late_by}) after the "
        )
        yield finding("delay", text + f"hold's one: estimate with nk={late.nk}", good=True)
    else:
        yield finding("delay", f"none is seen: estimate with nk={late.nk}", good=True)


def _about_structures(data: Dataset, known: Tested) -> Iterator[Finding]:
    """Compare ARX and OE, which tell the same where the noise is ARX's, or small."""
    nk = known.late.nk if isinstance(known.late, Delay) else 1
    integrator = known.integration.integrates
    try:
        models = (
            arx(data, na=ORDER, nb=ORDER, nk=nk),
            oe(data, nb=ORDER, nf=ORDER, nk=nk, integrator=integrator),
        )
    except (ValueError, np.linalg.LinAlgError):
        return
    highest = min(100.0, np.pi / data.Ts)
    omega = np.geomspace(min(0.5, highest / 10), highest, 100)
    G = [fit.frequency_response(omega).G for fit in models]
    apart = float(np.median(np.abs(G[0] - G[1]) / np.abs(G[1])))
    text = f"their frequency responses differ by a median of {percent(100 * apart)}"
    if apart < _AGREE:
        yield finding("ARX and OE", text, good=True)
        return
    text += ": the noise is added to the output, which ARX does not assume, so its transfer "
    yield finding("ARX and OE", text + "function is biased; take OE", good=False)
