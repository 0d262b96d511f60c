"""Warnings about a search and its parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from armrig.data.finding import Finding, warning
from armrig.data.step import laws_of, loop_notes
from armrig.models.estimate import Start
from armrig.models.fit import Fit
from armrig.models.structure_table import DESCRIBED
from armrig.numerics.levenberg_marquardt import Optimum
from armrig.numerics.polynomial import Array, roots
from armrig.numerics.quantities import digits, plural

_CIRCLE_TOLERANCE = 1e-6


def not_converged(steps: int, of_output: str = "") -> Finding:
    """Return the warning about a search that ended without a minimum."""
    text = (
        f"the search{of_output} did not converge in {plural(steps, 'step')}: lower the orders, or "
        "record more "
    )
    return warning("search", f"{text}data", "order", steps=steps)


def search_warnings(best: Optimum, starts: tuple[Start, ...], *, agreed: bool) -> Iterator[Finding]:
    """Yield warnings about a search that did not converge or that found several minima."""
    if not best.converged:
        yield not_converged(best.iterations)
    elif not agreed:
        text = (
            f"the search from {starts[-1].name!r} ended in a poorer minimum "
            f"(loss {digits(starts[-1].loss, 2)}): the best was taken, it may not be global"
        )
        yield warning("search", text, loss=starts[-1].loss)


def parameter_warnings(W: Array, C: Array) -> Iterator[Finding]:
    """Yield warnings about C, and about the rank of the data."""
    if C.size > 1 and np.max(np.abs(roots(C))) > 1 - _CIRCLE_TOLERANCE:
        yield warning(
            "root_on_circle",
            "C has a root on the unit circle, the limit of the search, so the standard deviation "
            "of the root has no meaning. Lower nc, or check whether the data were differenced or "
            "detrended",
        )
    d, rank = W.shape
    if rank < d:
        text = f"the data determine only {rank} of {d} parameters: lower the orders"
        yield warning("undetermined", text, rank=rank, parameters=d)


def with_doubts(fit: Fit) -> Fit:
    """Return the fit with warnings of a loop, and of standard deviations not to be trusted."""
    notes = [warning(name, text, curvature=fit.search.curvature) for name, text in fit.doubts]
    return replace(fit, findings=(*loop_warnings(fit), *fit.findings, *notes))


def loop_warnings(fit: Fit) -> Iterator[Finding]:
    """Yield a warning if a law controlled the run, and the structure has no noise model."""
    row = DESCRIBED[fit.structure]
    if not laws_of(fit.history) or row.closed_loop:
        return
    options = "ss"
    if (fit.ny, fit.nu) == (1, 1):
        n = fit.denominator.size - 1
        nb = fit.orders["nb"] if "nb" in row.orders else n
        options = f"bj --nb {nb} --nc 1 --nd 1 --nf {n}"
        options += " --integrator" * bool(fit.integrator)
    line = f"`armrig identify F --structure {options}`"
    yield from (warning("feedback", text, "noise") for text in loop_notes(fit.history, line))
