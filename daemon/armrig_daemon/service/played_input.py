"""Input of a run: check of the voltages, and their text for the recording."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig_daemon.config import Limits


def one_a_line(volts: NDArray[np.float64]) -> bytes:
    """Return the input (N,) as text for the recording: a heading, then a voltage per line."""
    # msgspec takes a tenth of the time of repr. For millions of samples, repr would take so long
    # that the loop would consider the service frozen.
    text = msgspec.json.encode(volts.tolist())
    return b"u_v\n" + text[1:-1].replace(b",", b"\n") + b"\n"


def checked(u: Sequence[float], limits: Limits) -> NDArray[np.float64]:
    """Return the voltages of an experiment, (N,) in V.

    Raises ValueError if a voltage is outside the limits, or a step is too large; the message names
    the first index.
    """
    volts = np.asarray(u, dtype=np.float64)
    low, high, slew = limits.u_min_v, limits.u_max_v, limits.slew_v
    outside = ~((volts >= low) & (volts <= high))
    if outside.any():
        i = int(np.argmax(outside))
        raise InputError(f"u[{i}]={volts[i]:.4g} V is outside {low:.4g} … {high:.4g} V")
    steps = np.abs(np.diff(volts, prepend=0.0))
    # The tolerance allows for the rounding error in the difference of two decimal numbers.
    far = steps > slew * (1 + 1e-9)
    if slew and far.any():
        i = int(np.argmax(far))
        raise InputError(f"u[{i}] steps by {steps[i]:.4g} V: at most {slew:.4g} V in a sample")
    return volts
