"""Whether the dead band hides the rise of a recorded step, and when to step instead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from armrig.numerics.step_times import ramp_lag
from armrig.numerics.stretches import stretches

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording

_BEYOND = 1.5  # rad between the dead band and where the next step is to begin
_EARLIEST_S = 0.5
_FEWEST = 8  # samples of a line
_MOVES = 0.05  # rad/s from which on the chassis turns before the step


@dataclass(frozen=True, slots=True, kw_only=True)
class HiddenStep:
    """Where the rise of a step is not seen."""

    begins_s: float
    """Last sample before the gap, in s from the step."""
    ends_s: float
    """First sample after it, in s from the step."""
    at_s: float
    """When the next run is to step, if nobody turns the chassis meanwhile; NaN where it rests
    before the step, so that no time is better than another."""
    seconds: float
    """Length of that run with as long a time after the step."""


def hidden_step(r: Recording) -> HiddenStep | None:
    """Return what is hidden of the rise, None where all of it is seen, or there is no step.

    The rise is taken to last for the equivalent time (`armrig.numerics.step_times`), by which the
    angle lags the straight line that it ends up on: it needs no sample of the rise.
    """
    edges = np.flatnonzero(np.diff(r.u) != 0)
    if edges.size != 1:
        return None
    at = int(edges[0]) + 1
    k, known = np.arange(r.N) - at, r.valid
    before, after = known & (k < 0) & (k > -at // 2 - 2), known & (k > (r.N - at) // 2)
    if min(np.count_nonzero(before), np.count_nonzero(after)) < _FEWEST:
        return None
    v0, y0 = np.polyfit(r.Ts * k[before], r.theta_1[before], 1)
    since = r.theta_1 - y0 - v0 * r.Ts * k
    v1 = v0 + float(np.polyfit(r.Ts * k[after], since[after], 1)[0])
    behind = ramp_lag(np.asarray(r.Ts * k[after], np.float64), since[after])
    if np.isnan(behind):
        return None
    gaps = [g for g in stretches(~known) if g.stop > at + 1 and (g.start - at) * r.Ts < behind]
    gap = max(gaps, key=lambda g: g.stop - g.start, default=None)
    if gap is None or gap.stop - gap.start < 2 or gap.stop >= r.N:
        return None
    # From where the chassis came to rest, about, on to well beyond the dead band.
    begin = r.theta_1[gap.stop] + np.copysign(_BEYOND, v0)
    way = (begin - r.theta_1[known][-1] - v1 * behind) % (2 * np.pi)
    turns = abs(v0) > _MOVES
    later = way / v0 if v0 > 0 else (way - 2 * np.pi) / v0 if turns else float("nan")
    later = later + 2 * np.pi / abs(v0) if later < _EARLIEST_S else later
    moment = float(np.ceil(10 * later) / 10) if turns else float("nan")
    return HiddenStep(
        begins_s=float((gap.start - 1 - at) * r.Ts),
        ends_s=float((gap.stop - at) * r.Ts),
        at_s=moment,
        seconds=float(np.ceil(moment + (r.N - at) * r.Ts)) if turns else float("nan"),
    )
