"""Figures of estimates without a structure show what they say and name their recording."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from armrig.estimation.nonparametric.figures import (
    _gain,
    _with_gaps,
    plot_step_analysis,
)
from matplotlib import pyplot as plt
from matplotlib.figure import Figure


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """Draw without a screen, and leave no figure open."""
    with mpl.rc_context({"backend": "agg"}):
        yield
        plt.close("all")


@pytest.mark.parametrize(("dead_time", "gain"), [(0.1, -2.0), (0.0, 3.0)])
def test_63_per_cent_is_marked_after_the_dead_time(dead_time: float, gain: float) -> None:
    t = np.arange(-50, 200) / 100
    y = gain * np.where(t > dead_time, 1 - np.exp(-np.maximum(t - dead_time, 0) / 0.2), 0.0)
    result = SimpleNamespace(
        t=t, y=y, smooth_t=t[t > 0], smooth=y[t > 0], smooth_std=np.full(199, 0.1),
        gain=gain, dead_time=dead_time, tau=0.2, settling=0.5,
        output="level", unit="mm", input_unit="A", source="beef",
    )  # fmt: skip
    ax = Figure().add_subplot()

    plot_step_analysis(result, ax=ax)

    at, level = dead_time + 0.2, (1 - np.exp(-1)) * gain
    lines = {str(line.get_label()): line for line in ax.lines}
    dot = lines[r"63 %: $\tau$ = 200 ms"]
    assert (dot.get_xdata()[0], dot.get_ydata()[0]) == pytest.approx((at, level))
    assert lines[f"final value {gain:.3g}"].get_ydata() == [gain, gain]
    assert lines["smoothed from the step on"].get_xdata()[0] == 0.0
    assert ax.get_xlim()[1] == pytest.approx(2.5 * max(0.5, 2 * at))
    low, high = ax.get_ylim()
    assert low < min(gain, 0) < max(gain, 0) < high
    shades = [p for p in ax.patches if p.get_label() == "dead time"]
    assert [p.get_x() + p.get_width() for p in shades] == ([dead_time] if dead_time else [])
    band = ax.collections[0].get_datalim(ax.transData)
    assert (band.y0, band.y1) == pytest.approx((y[t > 0].min() - 0.2, y[t > 0].max() + 0.2))


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
def test_the_unit_of_a_gain_is_that_of_y_per_unit_of_u(
    unit: str, input_unit: str, rate: bool, text: str
) -> None:
    assert _gain(SimpleNamespace(unit=unit, input_unit=input_unit), rate=rate) == text


def test_lines_of_a_figure_are_interrupted_by_gaps() -> None:
    t, y = _with_gaps(np.array([0.0, 1.0, 2.0, 5.0, 6.0, 9.0]), np.arange(6.0))

    assert np.flatnonzero(np.isnan(y)).tolist() == [3, 6]
    np.testing.assert_allclose(t, [0, 1, 2, 2, 5, 6, 6, 9], atol=1e-6)
