"""Overview of a recording (handout, 3.1.4): missing samples, outliers, drift."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from math import tau
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.rig.channels import Channel

from armrig.data.columns import Vector
from armrig.data.treatment import Drift, drift, hampel
from armrig.numerics.quantities import plural
from armrig.recordings.findings import second_moves
from armrig.recordings.recording import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from armrig.data.dataset import Dataset

_MIN_INPUT_CHANGES = 20  # as many as the coefficients of u in the model that finds outliers

_RATE_INTERVAL_S = 0.1
"""Interval, in s, over which the rate of a turning shaft is computed.

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
    """Drift of each rate, and of each channel without a rate, by output.

    If samples with unknown u divide the recording into experiments, the names end in " 1", " 2" …
    """
    reasons: Mapping[str, str]
    """Reasons why outputs were not searched, by output; the name "outliers" means all outputs."""

    def rows(self) -> list[tuple[str, str]]:
        """Return the rows of a table: the name of a quantity and its value as text."""
        rec = self.recording
        first = rec.description.channels[0]
        hidden = "dead band" if first.turns else "out of range"
        return [
            ("u", f"{_range(rec.u)} V, {np.nanmean(rec.u):.3g} V on average"),
            *((channel.name, _motion(rec, channel)) for channel in rec.description.channels),
            ("missing", f"{rec.missing} of {plural(rec.N, 'sample')}"),
            (hidden, f"{plural(rec.hidden, 'sample')} without {first.name}"),
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
        """Return a figure of u, the channels and their rates, with the outliers marked."""
        from armrig.plots.layout import figure_of
        from armrig.recordings.figures import plot_overview

        return figure_of(plot_overview(self.recording, self.outliers, ax=ax))


def overview(recording: Recording) -> Overview:
    """Search the channels for outliers, and the channels without a rate and the rates for a drift.

    The angle of a turning shaft is not searched for a drift: its slope is the response to the mean
    of u.
    """
    known, channels = np.isfinite(recording.u), recording.description.channels
    reasons = _reasons(recording)

    def each(names: Iterable[str], search: Callable[[Dataset], Any]) -> Iterator[tuple[str, Any]]:
        for name in names:
            if name not in reasons:
                try:
                    yield name, search(recording.dataset(name))
                except ValueError as err:
                    reasons[name] = str(err)

    searched = () if "outliers" in reasons else tuple(recording.channels)
    outliers = {
        name: recording.t[known][wrong]
        for name, wrong in each(searched, lambda data: data.valid & ~hampel(data).valid)
    }
    # No such signal integrates: springs hold an arm, and the back-EMF limits the rate. In a
    # recording as short as the swing after a step, a test for an integrator is unreliable.
    drifting = (channel.rate or channel.name for channel in channels)
    drifts = {
        f"{name} {i}" if len(found) > 1 else name: line
        for name, found in each(drifting, partial(drift, integrator=False))
        for i, line in enumerate(found, 1)
    }
    return Overview(
        recording=recording,
        outliers=MappingProxyType(outliers),
        drift=MappingProxyType(drifts),
        reasons=MappingProxyType(reasons),
    )


def _reasons(recording: Recording) -> dict[str, str]:
    """Return the reasons why outputs cannot be searched, by output; "outliers" means all."""
    channels, reasons = recording.description.channels, {}
    if len(channels) > 1 and not second_moves(recording):
        second = channels[1]  # each step of a reading at rest looks like an outlier
        held = f": the {second.body} was removed or held" if second.body else ""
        reasons[second.name] = f"{second.name} is constant{held}"
    changes = int(np.count_nonzero(np.diff(recording.u[np.isfinite(recording.u)])))
    if changes < _MIN_INPUT_CHANGES:
        reasons["outliers"] = (
            f"u changes {plural(changes, 'time')}; with fewer than {_MIN_INPUT_CHANGES} changes a "
            "model cannot distinguish an outlier from the swing after a change: look at the figure"
        )
        # In 13 of 40 emulated steps without a drift, the search found a positive drift of the rate.
        text = "u changes too rarely: the errors of the model would look like a drift"
        reasons |= {channel.rate: text for channel in channels if channel.rate}
    return reasons


def _motion(rec: Recording, channel: Channel) -> str:
    """Return the range of a channel, or the turns and the speed of a turning shaft."""
    y, valid = rec.channel(channel.name)
    if not channel.turns:
        return f"{_range(y)} {channel.unit}"
    turned = np.ptp(y[valid]) / tau if valid.any() else 0.0
    n = max(1, round(_RATE_INTERVAL_S / rec.Ts))
    speed = f"{_range((y[n:] - y[:-n]) / (n * rec.Ts))} rad/s over {_RATE_INTERVAL_S:g} s"
    return f"the {channel.body or 'shaft'} turned {turned:.1f} times, at {speed}"


def _range(x: Vector) -> str:
    x = x[np.isfinite(x)]
    return f"{x.min():.3g} to {x.max():.3g}" if x.size else "not known"


def _outliers(times: Vector) -> str:
    if not times.size:
        return "none"
    first = ", ".join(f"{t:g} s" for t in times[:5])
    return f"{times.size}, at {first}" + (" …" if times.size > 5 else "")
