"""Input signals with the names that commands use."""

from __future__ import annotations

from typing import Any

import numpy as np
from armrig_core.errors import InputError, ParameterError

from armrig.excitation.binary import prbs, telegraph, white_noise
from armrig.excitation.levels import Vector, staircase, step
from armrig.excitation.sines import chirp, multisine
from armrig.numerics.checks import require_integers, require_numbers

SEEDED = ("telegraph", "prbs", "white", "multisine")
"""Inputs that depend on a seed."""
NAMES = (*SEEDED, "chirp")


def signal_by_name(
    name: str, N: int, Ts: float, *, a: float, low: float, high: float, seed: int
) -> Vector:
    """Return the input (N,) with a given name, in V.

    A multisine has one period with all lines. A chirp is a logarithmic sweep over two decades, up
    to half of the Nyquist frequency. A telegraph signal switches at a sample with probability `a`.
    A prbs holds each value for 1/(2 a) samples, so that both have the same mean switching rate.

    Raises ValueError if no input has this name, or a setting is not allowed.
    """
    if name == "telegraph":
        return telegraph(N, a, low, high, seed)
    if name == "prbs":
        return prbs(N, clock_of(a), low, high, seed)
    if name == "white":
        return white_noise(N, low, high, seed)
    if name == "multisine":
        return multisine(N, None, low, high, seed)
    if name == "chirp":
        to_hz = 0.25 / Ts
        return chirp(N, Ts, to_hz / 100, to_hz, low, high, sweep="logarithmic")
    raise InputError(f"input {name!r} is not one of {', '.join(NAMES)}")


def details_of(name: str, *, a: float, low: float, high: float, seed: int) -> dict[str, Any]:
    """Return the settings of an input of `signal_by_name`, to be stored in the recording."""
    details: dict[str, Any] = {"input": name}
    details |= {"a": a} if name in ("telegraph", "prbs") else {}
    details |= {"low": low, "high": high}
    return details | ({"seed": seed} if name in SEEDED else {})


def clock_of(a: float) -> int:
    """Return the clock, in samples, of a prbs that switches as often as a telegraph signal."""
    require_numbers(a=a)
    if not 0 < a <= 0.5:
        raise InputError(f"a={a!r}: a prbs switches with a probability of more than 0, at most 0.5")
    return max(1, round(1 / (2 * a)))


def step_at(N: int, Ts: float, *, low: float, high: float, at: float) -> Vector:
    """Return the input (N,) that steps from low to high (in V) at the time `at` (in s)."""
    # A time just before the end may be rounded to N. The input would then contain no step.
    return step(N, low=low, high=high, at=min(round(at / Ts), N - 1))


def check_step_time(at: float, seconds: float) -> None:
    """Refuse a time of the step that is not inside the run; both times are in s."""
    if not at >= 0:  # also refuses NaN
        raise ParameterError("at", f"{at:g}", "must be a number of seconds, 0 or more")
    if at >= seconds:
        where = "at" if at == seconds else "after"
        reason = f"{where} the end, {seconds:g} s; step earlier or record longer"
        raise ParameterError("at", f"{at:g} s", reason)


def up_and_down(N: int, *, low: float, high: float, levels: int) -> Vector:
    """Return the input (N,) that rises from low to high in `levels` levels, then falls to low."""
    up = np.linspace(low, high, levels)
    return staircase(N, [*up, *up[-2::-1]], low, high)


def realisations(
    N: int, R: int, low: float, high: float, seed: int, *, periods: int
) -> tuple[Vector, ...]:
    """Return R multisines (N,) with different phases and the same power, for `armrig.bla`.

    The lines are all harmonics up to half of the Nyquist frequency. The effective value is the
    largest value with which all multisines fit into the interval. Their seeds are seed, seed + 1, …

    Raises ValueError if a setting is outside the range that `multisine` allows.
    """
    require_integers(N=(N, 1), R=(R, 1), periods=(periods, 1))
    require_integers(2**128, seed=(seed, 0))
    lines = range(1, max(1, N // periods // 4) + 1)
    alone = [multisine(N, lines, low, high, seed + r, periods=periods) for r in range(R)]
    middle = (low + high) / 2
    sizes = [float(np.sqrt(np.mean((u - middle) ** 2))) for u in alone]
    return tuple(
        np.clip(middle + (u - middle) * min(sizes) / size, low, high)
        for u, size in zip(alone, sizes, strict=True)
    )
