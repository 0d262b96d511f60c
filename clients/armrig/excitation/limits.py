"""What the rig may be given, and how a value outside it is refused."""

from __future__ import annotations

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

from armrig.numerics.checks import column, require_integers, require_numbers

Vector = NDArray[np.float64]

# Handout, assignment 3.3: outside this interval the lab process is destroyed.
LOWEST_V, HIGHEST_V = 0.0, 5.0


def within(u: ArrayLike, *, low: float = LOWEST_V, high: float = HIGHEST_V) -> Vector:
    """Return a copy (N,) of an input in V, every value of which is inside [low, high].

    Raises
    ------
    ValueError
        A value is outside, or no number; the first one is named by its index.
    """
    require_levels(low=low, high=high)
    taken = column("u", u)
    outside = ~((taken >= low) & (taken <= high))  # also finds NaN
    if outside.any():
        first = int(np.argmax(outside))
        raise InputError(
            f"u[{first}]={taken[first]:g} V is outside {low:g} to {high:g} V, as are "
            f"{np.count_nonzero(outside)} of {taken.size} values; scale or shift the signal"
        )
    return taken


def require_levels(*, low: float, high: float) -> None:
    """Refuse an interval that is empty or leaves the rig's."""
    require_numbers(low=low, high=high)
    for name, level in (("low", low), ("high", high)):
        if not LOWEST_V <= level <= HIGHEST_V:  # also refuses NaN
            raise InputError(
                f"{name}={level!r} V is outside the rig's {LOWEST_V:g} to {HIGHEST_V:g} V"
            )
    if not low < high:
        raise InputError(f"low={low!r} V must lie below high={high!r} V")


def generator(seed: int | np.random.Generator) -> np.random.Generator:
    """Return the generator of a seed, an integer >= 0, or the one given."""
    if isinstance(seed, np.random.Generator):
        return seed
    require_integers(seed=(seed, 0))
    return np.random.default_rng(seed)
