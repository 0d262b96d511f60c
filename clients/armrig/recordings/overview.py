"""Overview of a recording (handout, 3.1.4): missing samples, outliers, drift."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import tau
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.telemetry.channels import ALPHA, THETA_1, VELOCITY, OutputName

from armrig.data.columns import Vector
from armrig.data.treatment import Drift, drift, hampel
from armrig.numerics.quantities import plural
from armrig.recordings.findings import alpha_moves
from armrig.recordings.recording import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SEARCHED_OUTPUTS: tuple[OutputName, ...] = (THETA_1, ALPHA)
_DRIFTING_OUTPUTS: tuple[OutputName, ...] = (VELOCITY, ALPHA)
_MIN_INPUT_CHANGES = 20  # as many as the coefficients of u in the model that finds outliers

_RATE_INTERVAL_S = 0.1
"""Interval, in s, over which the rate of theta_1 is computed.

One step of the converter changes this rate by 0.06 rad/s. Over an interval of 2 ms, one step would
change the rate by 3 rad/s.
"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Overview:
    """A recording, with its outliers and the drift of its signals."""

    recording: Recording
    """Recording of the overview."""
    outliers: Mapping[str, Vector]
    """Times of the outliers in s, by output; outputs that could not be searched are left out."""
    drift: Mapping[str, Drift]
    """Drift of the rate of theta_1 and drift of alpha, by output.

    If samples with unknown u divide the recording into experiments, the names are "alpha 1",
    "alpha 2" …
    """
    reasons: Mapping[str, str]
    """Reasons why outputs were not searched, by output; the name "outliers" means all outputs."""

    def rows(self) -> list[tuple[str, str]]:
        """Return the rows of a table: the name of a quantity and its value as text."""
        rec = self.recording
        speed = f"{_range(_rate(rec))} rad/s"
        turned = np.ptp(rec.theta_1[rec.valid]) / tau if rec.valid.any() else 0.0
        return [
            ("u", f"{_range(rec.u)} V, {np.nanmean(rec.u):.3g} V on average"),
            (
                THETA_1,
                f"the chassis turned {turned:.1f} times, at {speed} over {_RATE_INTERVAL_S:g} s",
            ),
            (ALPHA, f"{_range(rec.alpha)} rad"),
            ("missing", f"{rec.missing} of {plural(rec.N, 'sample')}"),
            ("dead band", f"{plural(rec.hidden, 'sample')} without theta_1"),
            *((f"outliers, {name}", _outliers(times)) for name, times in self.outliers.items()),
            *((f"drift, {name}", str(found)) for name, found in self.drift.items()),
            *((f"not looked at, {name}", why) for name, why in self.reasons.items()),
        ]

    def facts(self) -> dict[str, Any]:
        """Return the overview as a dict for JSON."""
        rec = self.recording
        return {
            "sha256": rec.sha256,
            "samples": rec.N,
            "missing": rec.missing,
            "invalid": rec.hidden,
            "outliers": {name: times.tolist() for name, times in self.outliers.items()},
            "drift": {
                name: {"rate": d.rate, "std": d.std, "unit": f"{d.unit}/s"}
                for name, d in self.drift.items()
            },
            "not_looked_at": dict(self.reasons),
        }

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of u, both angles and the rate of theta_1, with the outliers marked."""
        from armrig.plots.layout import figure_of
        from armrig.recordings.figures import plot_overview

        return figure_of(plot_overview(self.recording, self.outliers, ax=ax))


def overview(recording: Recording) -> Overview:
    """Search both angles for outliers, and search alpha and the rate of theta_1 for a drift.

    The angle theta_1 is not searched for a drift: its slope is the response to the mean of u.
    """
    outliers: dict[str, Vector] = {}
    drifts: dict[str, Drift] = {}
    reasons: dict[str, str] = {}
    if not alpha_moves(recording):  # each step of a reading at rest looks like an outlier
        reasons[ALPHA] = "alpha is constant: the arm was removed or held"
    known = np.isfinite(recording.u)
    changes = int(np.count_nonzero(np.diff(recording.u[known])))
    poor = changes < _MIN_INPUT_CHANGES
    if poor:
        reasons["outliers"] = (
            f"u changes {plural(changes, 'time')}; with fewer than {_MIN_INPUT_CHANGES} changes a "
            "model cannot distinguish an outlier from the swing after a change: look at the figure"
        )
        # In 13 of 40 emulated steps without a drift, the search found a positive drift of the rate.
        reasons[VELOCITY] = "u changes too rarely: the errors of the model would look like a drift"
    searched = () if poor else _SEARCHED_OUTPUTS
    for output in (name for name in searched if name not in reasons):
        try:
            data = recording.dataset(output)
            marked = data.valid & ~hampel(data).valid
        except ValueError as err:
            reasons[output] = str(err)
        else:
            outliers[output] = recording.t[known][marked]
    for output in (name for name in _DRIFTING_OUTPUTS if name not in reasons):
        try:
            # Neither signal integrates: springs hold alpha, and the back-EMF limits the rate. In a
            # recording as short as the swing after a step, a test for an integrator is unreliable.
            found = drift(recording.dataset(output), integrator=False)
        except ValueError as err:
            reasons.setdefault(output, str(err))
        else:
            several = len(found) > 1
            drifts |= {f"{output} {i}" if several else output: d for i, d in enumerate(found, 1)}
    return Overview(
        recording=recording,
        outliers=MappingProxyType(outliers),
        drift=MappingProxyType(drifts),
        reasons=MappingProxyType(reasons),
    )


def _rate(recording: Recording) -> Vector:
    """Return the rate of theta_1 over `_RATE_INTERVAL_S`, in rad/s; NaN without valid angles."""
    n = max(1, round(_RATE_INTERVAL_S / recording.Ts))
    angle = recording.theta_1
    return (angle[n:] - angle[:-n]) / (n * recording.Ts)


def _range(x: Vector) -> str:
    x = x[np.isfinite(x)]
    return f"{x.min():.3g} to {x.max():.3g}" if x.size else "not known"


def _outliers(times: Vector) -> str:
    if not times.size:
        return "none"
    first = ", ".join(f"{t:g} s" for t in times[:5])
    return f"{times.size}, at {first}" + (" …" if times.size > 5 else "")
