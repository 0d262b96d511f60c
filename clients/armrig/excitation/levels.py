"""Signals of constant levels: a step and a staircase."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.data.columns import Vector as Vector
from armrig.numerics.checks import column, require_integers, require_numbers
from armrig.numerics.quantities import plural

# According to assignment 3.3 of the handout, an input outside this interval destroys the rig.
LOWEST_V, HIGHEST_V = 0.0, 5.0


def step(N: int, *, low: float = 0.5, high: float = 4.5, at: int = 0) -> Vector:
    """Return a step (N,) from one voltage to a higher voltage.

    Parameters
    ----------
    at : int, default 0
        Number of the first sample at `high`, 0 to N; if it is N, the signal stays at `low`.
    N, low, high
        As for every signal, see `armrig.excitation`.

    Examples
    --------
    >>> import armrig
    >>> armrig.step(5, at=2)
    array([0.5, 0.5, 4.5, 4.5, 4.5])
    """
    require_integers(N=(N, 1), at=(at, 0))
    require_levels(low=low, high=high)
    if at > N:
        raise InputError(f"at={at!r} must be a sample number, 0 <= at <= N={N}")
    return np.where(np.arange(N) < at, low, high).astype(np.float64)


def staircase(
    N: int, levels: int | Sequence[float] = 6, low: float = 0.5, high: float = 4.5
) -> Vector:
    """Return a staircase (N,) of levels, each held for the same time, to a sample.

    The output at the levels shows whether the static gain is constant. A staircase up and down
    shows friction.

    Parameters
    ----------
    levels : int or sequence of float, default 6
        Number of levels, >= 2, equally spaced from low to high; or the voltages of the levels, in
        V, of which none is outside [low, high]. There must be a sample for each level.
    N, low, high
        As for every signal, see `armrig.excitation`.

    Examples
    --------
    >>> import armrig
    >>> armrig.staircase(6, [1, 2, 3])
    array([1., 1., 2., 2., 3., 3.])
    """
    require_integers(N=(N, 1))
    require_levels(low=low, high=high)
    if isinstance(levels, Integral):
        require_integers(levels=(levels, 2))
        stairs = np.linspace(low, high, int(levels))
    else:
        stairs = within(levels, low=low, high=high)
    if stairs.size > N:
        raise InputError(
            f"{plural(stairs.size, 'level needs', 'levels need')} at least as many samples, N={N}"
        )
    return stairs[np.arange(N) * stairs.size // N]


def within(u: ArrayLike, *, low: float = LOWEST_V, high: float = HIGHEST_V) -> Vector:
    """Return a copy (N,) of an input in V; all values must be inside [low, high].

    Raises ValueError if a value is outside the interval or is not a number. The message contains
    the index of the first such value.
    """
    require_levels(low=low, high=high)
    values = column("u", u)
    outside = ~((values >= low) & (values <= high))  # also finds NaN
    if outside.any():
        first = int(np.argmax(outside))
        raise InputError(
            f"{np.count_nonzero(outside)} of {values.size} values outside {low:g} to {high:g} V, "
            f"first u[{first}]={values[first]:g} V; scale or shift the signal"
        )
    return values


def require_levels(*, low: float, high: float) -> None:
    """Refuse an interval that is empty or not inside 0 to 5 V."""
    require_numbers(low=low, high=high)
    for name, level in (("low", low), ("high", high)):
        if not LOWEST_V <= level <= HIGHEST_V:  # also refuses NaN
            raise InputError(
                f"{name}={level!r} V is outside the rig's {LOWEST_V:g} to {HIGHEST_V:g} V"
            )
    if not low < high:
        raise InputError(f"low={low!r} V must be below high={high!r} V")


def generator(seed: int | np.random.Generator) -> np.random.Generator:
    """Return a new random generator for an integer seed >= 0, or the given generator itself."""
    if isinstance(seed, np.random.Generator):
        return seed
    require_integers(2**128, seed=(seed, 0))
    return np.random.default_rng(seed)
