"""The rate of an output: an angle's velocity."""

from __future__ import annotations

import numpy as np
from armrig_core import telemetry

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.trend import Trend


def rate_name(output: str) -> str:
    """Return the name of the rate of an output."""
    rates = {channel.name: channel.rate for channel in telemetry.CHANNELS}
    return rates.get(output) or f"rate of {output}"


@takes_recordings
def difference(data: Dataset) -> Dataset:
    """Return the velocity (y(t) - y(t-1)) / Ts as output, u unchanged.

    It is missing where either neighbour is, and at the first sample of each experiment. A model
    of it has the orders of the position's without the integrator, and the same nk.

    Parameters
    ----------
    data : Dataset
        N samples, Ts in s.

    Returns
    -------
    Dataset
        N samples whose output is in y's unit per s: `velocity` for theta_1.
    """
    y = np.full(data.N, np.nan)
    y[1:] = np.diff(data.y) / data.Ts
    y[list(data.starts)] = np.nan
    name = rate_name(data.output)
    return data.replaced(
        y=y,
        valid=np.isfinite(y),
        output=name,
        unit=f"{data.unit}/s" if data.unit else "",
        trends=tuple(
            Trend(u_level=t.u_level, u_slope=t.u_slope, y_level=t.y_slope) for t in data.trends
        ),
        step=f"took differences of {data.output} over Ts={data.Ts:g} s as the output {name!r}",
    )
