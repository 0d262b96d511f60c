"""The input of a run: checked, and as it is attached to the recording."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig_daemon.config import Limits


def one_a_line(volts: NDArray[np.float64]) -> bytes:
    """Return the input as it is attached: a heading, and each voltage (N,), to the last bit."""
    # A tenth of the time that repr takes, which for millions would be longer than a frozen service
    # may be silent.
    text = msgspec.json.encode(volts.tolist())
    return b"u_v\n" + text[1:-1].replace(b",", b"\n") + b"\n"


def checked(u: Sequence[float], limits: Limits) -> NDArray[np.float64]:
    """Return the voltages of an experiment, (N,) in V.

    Raises
    ------
    ValueError
        One is outside the limits, or steps too far; names the first index.
    """
    volts = np.asarray(u, dtype=np.float64)
    low, high, slew = limits.u_min_v, limits.u_max_v, limits.slew_v
    outside = ~((volts >= low) & (volts <= high))
    if outside.any():
        i = int(np.argmax(outside))
        raise InputError(f"u[{i}]={volts[i]:.4g} V is outside {low:.4g} … {high:.4g} V")
    steps = np.abs(np.diff(volts, prepend=0.0))
    # What is left over is what two numbers like 0.3 and 1.3 differ from 1 by.
    far = steps > slew * (1 + 1e-9)
    if slew and far.any():
        i = int(np.argmax(far))
        raise InputError(f"u[{i}] steps by {steps[i]:.4g} V: at most {slew:.4g} V in a sample")
    return volts
