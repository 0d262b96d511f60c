"""Slices in which a condition holds, or in which a signal does not change."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from armrig.numerics.stretches import constant, longest, pieces, stretches
from hypothesis import given
from hypothesis import strategies as st

MASKS = st.lists(st.booleans(), max_size=40).map(lambda x: np.array(x, dtype=np.bool_))


@given(MASKS)
def test_stretches_cover_the_mask_and_do_not_touch(mask: np.ndarray) -> None:
    found = stretches(mask)

    marked = np.zeros(mask.size, dtype=np.bool_)
    for s in found:
        marked[s] = True
    np.testing.assert_array_equal(marked, mask)
    assert all(a.stop < b.start for a, b in pairwise(found))
    assert all(s.start < s.stop for s in found)


def test_the_longest_stretch_is_counted_in_samples() -> None:
    assert longest(np.array([True, False, True, True, False])) == 2
    assert longest(np.array([False, True, True, True])) == 3
    assert longest(np.zeros(3, dtype=np.bool_)) == 0
    assert longest(np.zeros(0, dtype=np.bool_)) == 0


def test_a_signal_is_divided_at_its_changes() -> None:
    assert constant(np.array([1.0, 1.0, 2.0, 1.0])) == [slice(0, 2), slice(2, 3), slice(3, 4)]
    assert constant(np.array([np.nan, np.nan])) == [slice(0, 1), slice(1, 2)]
    assert constant(np.array([3.0])) == [slice(0, 1)]
    assert constant(np.zeros(0)) == []


def test_cuts_lie_between_samples() -> None:
    indices = np.array([1, 2, 3, 9, 10, 30])

    groups = [indices[s].tolist() for s in pieces(np.diff(indices) > 2)]

    assert groups == [[1, 2, 3], [9, 10], [30]]
