"""What to look at first in a recording (handout, 3.1.4): missing samples, outliers, drift."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import tau
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.telemetry import ALPHA, THETA_1, VELOCITY, OutputName
from numpy.typing import NDArray

from armrig.data.treatment import Drift, drift, hampel
from armrig.numerics.quantities import plural
from armrig.recordings.findings import alpha_moves
from armrig.recordings.recording import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]
_SEARCHED: tuple[OutputName, ...] = (THETA_1, ALPHA)
_DRIFTING: tuple[OutputName, ...] = (VELOCITY, ALPHA)
_FEWEST_CHANGES = 20  # of u: the coefficients of u in the model that outliers are found by

_RATE_S = 0.1
"""Length over which the range of the rate is taken: one step of the converter is 0.06 rad/s then,
and 3 rad/s from one sample to the next at 2 ms."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Overview:
    """A recording, and what is wrong with single samples of it or with its level."""

    recording: Recording
    """What was looked at."""
    outliers: Mapping[str, Vector]
    """Times of the outliers in s, by output; an output that could not be searched is left out."""
    drift: Mapping[str, Drift]
    """By output: of the rate of theta_1, which integrates, and of alpha. A recording in several
    experiments, as after samples of unknown u, has "alpha 1", "alpha 2" …"""
    reasons: Mapping[str, str]
    """Why an output could not be searched, by output; "outliers" where no output could be."""

    def rows(self) -> list[tuple[str, str]]:
        """Return names and values for a person."""
        rec = self.recording
        speed = f"{_range(_rate(rec))} rad/s"
        turned = np.ptp(rec.theta_1[rec.valid]) / tau if rec.valid.any() else 0.0
        return [
            ("u", f"{_range(rec.u)} V, {np.nanmean(rec.u):.3g} V on average"),
            (THETA_1, f"the chassis turned {turned:.1f} times, at {speed} over {_RATE_S:g} s"),
            (ALPHA, f"{_range(rec.alpha)} rad"),
            ("missing", f"{rec.missing} of {plural(rec.N, 'sample')}"),
            ("dead band", f"{plural(rec.hidden, 'sample')} without theta_1"),
            *((f"outliers, {name}", _outliers(times)) for name, times in self.outliers.items()),
            *((f"drift, {name}", str(found)) for name, found in self.drift.items()),
            *((f"not looked at, {name}", why) for name, why in self.reasons.items()),
        ]

    def facts(self) -> dict[str, Any]:
        """Return it for a program."""
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
        """Return a figure of u, theta_1, its rate and alpha against time, with what was found."""
        from armrig.plots.layout import figure_of
        from armrig.recordings.figures import plot_overview

        return figure_of(plot_overview(self, ax=ax))


def overview(recording: Recording) -> Overview:
    """Look for outliers in both angles, and for a drift of the rate of theta_1 and of alpha.

    The angle itself does not drift: it integrates, and its line answers the mean of u.
    """
    outliers: dict[str, Vector] = {}
    drifts: dict[str, Drift] = {}
    reasons: dict[str, str] = {}
    if not alpha_moves(recording):  # of a reading that hardly changes each step looks like one
        reasons[ALPHA] = "it rests: the arm was off, or held"
    known = np.isfinite(recording.u)
    if poor := _poor_input(recording.u[known]):
        reasons["outliers"] = poor
        # Of 40 emulated steps without a drift 13 showed one of the rate, all of them a rising one.
        reasons[VELOCITY] = "of so few changes what the model lacks looks like a drift"
    searched = () if poor else _SEARCHED
    for output in (name for name in searched if name not in reasons):
        try:
            data = recording.dataset(output)
            marked = data.valid & ~hampel(data).valid
        except ValueError as err:
            reasons[output] = str(err)
        else:
            outliers[output] = recording.t[known][marked]
    for output in (name for name in _DRIFTING if name not in reasons):
        try:
            # Neither integrates: springs hold alpha, and the back-EMF the rate. A swing after a
            # step is too short a record for a test to see that.
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


def _poor_input(u: Vector) -> str:
    """Return why u teaches too little to tell an outlier from a swing, "" where it does not."""
    changes = int(np.count_nonzero(np.diff(u)))
    if changes >= _FEWEST_CHANGES:
        return ""
    return (
        f"u changes {plural(changes, 'time')}; fewer than {_FEWEST_CHANGES} teach no model that "
        "tells an outlier from the swing after a change: look at the figure"
    )


def _rate(recording: Recording) -> Vector:
    """Return the rate of theta_1 over `_RATE_S`, in rad/s; NaN where it is not known."""
    n = max(1, round(_RATE_S / recording.Ts))
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
