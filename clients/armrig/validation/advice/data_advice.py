"""What data are fit for."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from armrig.data.dataset import Dataset
from armrig.data.treatment import INTEGRATING_OUTPUTS, drift, hampel
from armrig.data.treatment.integrating import integrating
from armrig.estimation.arx import arx
from armrig.estimation.oe import oe
from armrig.excitation.input_description import describe_input
from armrig.numerics.quantities import p_relation, percent
from armrig.recordings.usability import Finding
from armrig.validation.advice.finding import finding
from armrig.validation.feedback_and_delay.open_loop import open_loop

ORDER = 4
"""Poles of the arm, and coefficients of its numerator."""
_LEVEL = 0.01
_AGREE = 0.1  # median of |G_ARX - G_OE| / |G_OE|
_MOST_MISSING = 0.2


def examine_data(data: Dataset) -> Iterator[Finding]:
    """Iterate over the points, in the order in which one would look."""
    yield _about_input(data)
    reason = integrating(data)
    yield _about_integrator(reason)
    if data.missing:
        yield _about_missing(data)
    cleaned = None
    try:
        cleaned = hampel(data)
    except ValueError as err:
        yield finding("outliers", f"not looked for: {err}", good=True)
    if cleaned is not None:
        yield _about_outliers(data, cleaned)
    if not reason:
        yield from _about_drift(data)
    yield from _about_history(data)
    yield from _about_feedback(data)
    yield from _about_structures(data, integrator=bool(reason))


def _about_input(data: Dataset) -> Finding:
    order = min(describe_input(part.u, data.Ts).order for part in data.experiments())
    needed = 2 * ORDER
    if order >= needed:
        text = f"exciting of order {order} at least: enough for the {needed} parameters of the arm"
        return finding("excitation", text, good=True)
    text = f"exciting of order {order} only, the arm's {needed} parameters need {needed}: play one "
    return finding("excitation", text + "that switches often (telegraph, PRBS)", good=False)


def _about_integrator(reason: str) -> Finding:
    if not reason:
        return finding("integrator", "none is seen", good=True)
    text = f"{reason}: fix its pole, oe(…, integrator=True), and remove no linear trend"
    return finding("integrator", text, good=True)


def _about_missing(data: Dataset) -> Finding:
    share = data.missing / data.N
    text = f"{percent(100 * share)} of the samples: no estimate uses a value in their place"
    return finding("missing", text, good=share < _MOST_MISSING)


def _about_outliers(data: Dataset, cleaned: Dataset) -> Finding:
    found = cleaned.missing - data.missing
    if not found:
        return finding("outliers", "none", good=True)
    where = ", ".join(map(str, np.flatnonzero(data.valid & ~cleaned.valid)[:5]))
    text = f"{found} (first at samples {where}): identify from armrig.hampel(data), which marks "
    return finding("outliers", text + "them missing", good=False)


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
    if data.output in INTEGRATING_OUTPUTS and any("order 1)" in step for step in data.history):
        text = "a line was removed from an output that integrates: it was the answer to the mean "
        yield finding(
            "trend", text + "of u, not a drift; begin again from the recording", good=False
        )


def _about_feedback(data: Dataset) -> Iterator[Finding]:
    try:
        test = open_loop(data, _LEVEL)
    except ValueError:
        return
    if test.feedback is None:
        yield finding("feedback", f"cannot tell: {'; '.join(test.remarks)}", good=True)
        return
    if not test.feedback:
        yield finding("feedback", f"none is found (p {p_relation(test.p_value)})", good=True)
        return
    text = f"u answers to {data.output} (p {p_relation(test.p_value)}): OE, spectra and "
    text += "correlations are biased; use ARMAX or BJ, or record in open loop"
    yield finding("feedback", text, good=False)


def _about_structures(data: Dataset, *, integrator: bool) -> Iterator[Finding]:
    """Compare ARX and OE, which tell the same where the noise is ARX's, or small."""
    try:
        models = arx(data, na=ORDER, nb=ORDER), oe(data, nb=ORDER, nf=ORDER, integrator=integrator)
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
