"""Where a condition holds without a break, and where a signal stays the same."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.polynomial import Array

Mask = NDArray[np.bool_]
"""(N,): whether something is true of each sample."""


def stretches(mask: Mask) -> list[slice]:
    """Return the longest possible slices in which all of the mask (N,) is true, in order."""
    padded = np.concatenate([[False], mask, [False]]).astype(np.int8)
    edges = np.flatnonzero(np.diff(padded)).tolist()
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def longest(mask: Mask) -> int:
    """Return the number of samples in the longest stretch in which the mask is true, 0 for none."""
    return max((s.stop - s.start for s in stretches(mask)), default=0)


def constant(x: Array) -> list[slice]:
    """Return the longest possible slices in which x (N,) does not change; a NaN stands alone."""
    return pieces(np.diff(x) != 0) if x.size else []


def pieces(cuts: Mask) -> list[slice]:
    """Return the slices of N samples between cuts (N - 1,): cuts[k] parts sample k from k + 1."""
    edges = [0, *(np.flatnonzero(cuts) + 1).tolist(), cuts.size + 1]
    return [slice(a, b) for a, b in pairwise(edges)]
