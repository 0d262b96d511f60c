"""Figures of estimates without a structure show what they say and name their recording."""

from __future__ import annotations

import numpy as np
from armrig.estimation.figures import _with_gaps


def test_lines_of_a_figure_are_interrupted_by_gaps() -> None:
    t, y = _with_gaps(np.array([0.0, 1.0, 2.0, 5.0, 6.0, 9.0]), np.arange(6.0))

    assert np.flatnonzero(np.isnan(y)).tolist() == [3, 6]
    np.testing.assert_allclose(t, [0, 1, 2, 2, 5, 6, 6, 9], atol=1e-6)
