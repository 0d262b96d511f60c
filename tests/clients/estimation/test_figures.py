"""Figures of estimates without a structure show what they say and name their recording."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from armrig.estimation.figures import (
    _with_gaps,
    gain_unit,
)


@pytest.mark.parametrize(
    ("unit", "input_unit", "rate", "text"),
    [
        ("rad", "V", False, "rad/V"),
        ("rad", "V", True, "rad/s/V"),
        ("rad", "", True, "rad/s"),
        ("", "V", True, "–/V"),
        ("", "", False, "–"),
    ],
)
def test_the_unit_of_again_unit_is_that_of_y_per_unit_of_u(
    unit: str, input_unit: str, rate: bool, text: str
) -> None:
    assert gain_unit(SimpleNamespace(unit=unit, input_unit=input_unit), rate=rate) == text


def test_lines_of_a_figure_are_interrupted_by_gaps() -> None:
    t, y = _with_gaps(np.array([0.0, 1.0, 2.0, 5.0, 6.0, 9.0]), np.arange(6.0))

    assert np.flatnonzero(np.isnan(y)).tolist() == [3, 6]
    np.testing.assert_allclose(t, [0, 1, 2, 2, 5, 6, 6, 9], atol=1e-6)
