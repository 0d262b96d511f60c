"""Inputs as a command asks for them: by name, with the few figures that each needs."""

from __future__ import annotations

from typing import Any

import numpy as np
from armrig_core.errors import InputError

from armrig.excitation.binary import prbs, telegraph, white_noise
from armrig.excitation.levels import Vector, staircase, step
from armrig.excitation.sines import chirp, multisine
from armrig.numerics.checks import require_integers, require_numbers

SEEDED = ("telegraph", "prbs", "white", "multisine")
"""Inputs that another seed makes anew."""
NAMES = (*SEEDED, "chirp")


def named_signal(
    name: str, N: int, Ts: float, *, a: float, low: float, high: float, seed: int
) -> Vector:
    """Return the input (N,) of a name, in V.

    Parameters
    ----------
    name : {"telegraph", "prbs", "white", "multisine", "chirp"}
        A multisine has one period, with all its lines; a chirp moves logarithmically through two
        decades up to half of Nyquist's frequency.
    N : int
        Number of samples.
    Ts : float
        Sampling time, in s.
    a : float
        Probability of a switch at each sample, of the telegraph; a prbs holds each value for
        1/(2 a) samples, so that it switches as often.
    low, high : float
        The interval in V, 0 <= low < high <= 5.
    seed : int
        Of all but the chirp.

    Raises
    ------
    ValueError
        There is no such input, or a figure is not possible.
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
    raise InputError(f"input {name!r}: there are {', '.join(NAMES)}")


def details_of(name: str, *, a: float, low: float, high: float, seed: int) -> dict[str, Any]:
    """Return what makes an input of `named_signal` again, to be kept with the recording."""
    details: dict[str, Any] = {"input": name}
    details |= {"a": a} if name in ("telegraph", "prbs") else {}
    details |= {"low": low, "high": high}
    return details | ({"seed": seed} if name in SEEDED else {})


def clock_of(a: float) -> int:
    """Return the samples for which a prbs holds, if it is to switch as often as a telegraph."""
    require_numbers(a=a)
    if not 0 < a <= 0.5:
        raise InputError(f"a={a!r}: a prbs switches with a probability of more than 0, at most 0.5")
    return max(1, round(1 / (2 * a)))


def step_at(N: int, Ts: float, *, low: float, high: float, at: float) -> Vector:
    """Return the input (N,) that steps from low to high, in V, at a time in s."""
    # A time just before the end may round to the end, where there would be no step.
    return step(N, low=low, high=high, at=min(round(at / Ts), N - 1))


def check_step_time(at: float, seconds: float) -> None:
    """Refuse a time of a step that is not inside its length, both in s."""
    if not at >= 0:  # NaN neither
        raise InputError(f"--at {at:g}: must be a number of seconds, 0 or more")
    if at >= seconds:
        where = "at" if at == seconds else "after"
        raise InputError(
            f"--at {at:g} s is {where} the end, {seconds:g} s; give an earlier --at or more "
            "--seconds"
        )


def up_and_down(N: int, *, low: float, high: float, levels: int) -> Vector:
    """Return the input (N,) that goes up from low to high in so many levels, and down again."""
    up = np.linspace(low, high, levels)
    return staircase(N, [*up, *up[-2::-1]], low, high)


def realisations(
    N: int, R: int, low: float, high: float, seed: int, *, periods: int
) -> tuple[Vector, ...]:
    """Return R multisines (N,) with other phases and the same power, for `armrig.bla`.

    Their lines are all up to half of Nyquist's frequency; the effective value is the largest with
    which all of them fit.

    Parameters
    ----------
    N : int
        Samples of each, a whole multiple of `periods`.
    R : int
        How many, with the seeds seed, seed + 1, …
    low, high : float
        The interval in V, 0 <= low < high <= 5.
    seed : int
        Of the first.
    periods : int
        Whole periods in each.

    Raises
    ------
    ValueError
        As of `multisine`.
    """
    require_integers(N=(N, 1), R=(R, 1), seed=(seed, 0), periods=(periods, 1))
    lines = range(1, max(1, N // periods // 4) + 1)
    alone = [multisine(N, lines, low, high, seed + r, periods=periods) for r in range(R)]
    middle = (low + high) / 2
    sizes = [float(np.sqrt(np.mean((u - middle) ** 2))) for u in alone]
    return tuple(
        np.clip(middle + (u - middle) * min(sizes) / size, low, high)
        for u, size in zip(alone, sizes, strict=True)
    )
