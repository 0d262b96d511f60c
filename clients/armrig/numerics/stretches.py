"""Stretches of samples in which a condition holds or a signal is constant."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.polynomial import Array

Mask = NDArray[np.bool_]
"""One truth value for each sample, (N,)."""


def stretches(mask: Mask) -> list[slice]:
    """Return the maximal slices in which the mask (N,) is true, in order."""
    padded = np.concatenate([[False], mask, [False]]).astype(np.int8)
    edges = np.flatnonzero(np.diff(padded)).tolist()
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def longest(mask: Mask) -> int:
    """Return the length of the longest stretch in which the mask is true, or 0 if there is none."""
    return max((s.stop - s.start for s in stretches(mask)), default=0)


def constant(x: Array) -> list[slice]:
    """Return the maximal slices in which x (N,) is constant; each NaN is a separate slice."""
    return pieces(np.diff(x) != 0) if x.size else []


def pieces(cuts: Mask) -> list[slice]:
    """Return the slices of N samples between cuts.

    `cuts` has the shape (N - 1,); a cut at index k is after sample k.
    """
    edges = [0, *(np.flatnonzero(cuts) + 1).tolist(), cuts.size + 1]
    return [slice(a, b) for a, b in pairwise(edges)]
