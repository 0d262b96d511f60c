"""Figures of estimates without a structure show what they say and name their recording."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from armrig.estimation.nonparametric.bla import bla
from armrig.estimation.nonparametric.correlation import correlation
from armrig.estimation.nonparametric.etfe import etfe
from armrig.estimation.nonparametric.figures import (
    _gain,
    _with_gaps,
    plot_step_analysis,
    plot_structure,
)
from armrig.estimation.nonparametric.impulse import impulse_response
from armrig.estimation.nonparametric.sampling_time import sampling_time
from armrig.estimation.nonparametric.spectral import spa
from armrig.estimation.nonparametric.step_analysis import step_analysis
from armrig.numerics.quantities import minus
from armrig.validation.structure_hints import structure_hints
from matplotlib import pyplot as plt
from matplotlib.figure import Figure


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """Draw without a screen, and leave no figure open."""
    with mpl.rc_context({"backend": "agg"}):
        yield
        plt.close("all")


def periodic(arm: Any) -> Any:
    """Return four periods of noise."""
    return arm.dataset(np.tile(np.random.default_rng(1).uniform(0, 5, 100), 4), 1e-3)


RESULTS: dict[str, Callable[[Any], Any]] = {
    "impulse": lambda arm: impulse_response(arm.telegraph(), 40),
    "plain": lambda arm: impulse_response(arm.telegraph(), 30, None, 5, integrator=False),
    "correlation": lambda arm: correlation(arm.telegraph()),
    "spa": lambda arm: spa(arm.telegraph(), "log"),
    "etfe": lambda arm: etfe(periodic(arm)),
    "bla": lambda arm: bla([periodic(arm), periodic(arm)]),
    "step": lambda arm: step_analysis(arm.steps()),
    "sampling": lambda arm: sampling_time(arm.telegraph()),
    "structure": lambda arm: structure_hints(arm.telegraph()[:500]),
}


@pytest.mark.parametrize("made", RESULTS.values(), ids=RESULTS.keys())
def test_a_result_plots_itself(made: Callable[[Any], Any], arm: Any) -> None:
    result = made(arm)
    ax = Figure().add_subplot()

    assert result.plot(ax=ax) is ax.figure
    assert plt.get_fignums() == []
    ax.figure.canvas.draw()
    assert "abcdef012345" in ax.get_title(loc="right")
    assert result.plot().axes[0].has_data()
    assert len(plt.get_fignums()) == 1
    assert not re.search(r"\bnan\b", repr(result))


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


@pytest.mark.parametrize(("low", "high"), [(-20.0, -40.0), (None, -60.0), (0.0, None)])
def test_slopes_and_resonances_are_drawn_where_they_are(
    low: float | None, high: float | None
) -> None:
    omega = np.geomspace(0.1, 100.0, 61)
    magnitude = 3.0 / (1 + omega**2)
    spectrum = SimpleNamespace(
        omega=omega, G=np.where(omega > 90, np.nan, magnitude), magnitude=magnitude,
        output="level", unit="mm", input_unit="A", source="beef",
    )  # fmt: skip
    hints: Any = SimpleNamespace(
        spectrum=spectrum, low_slope=low, high_slope=high, trusted=40.0, resonances=(2.0, 9.0),
        antiresonances=(5.0,), singular_values=0.5 ** np.arange(20.0), threshold=0.01,
    )  # fmt: skip
    figure = Figure()

    ax = plot_structure(hints, ax=figure.add_subplot())

    lines = {str(line.get_label()): line for line in ax.lines}
    for slope, at in ((low, 0.1), (high, 20.0)):
        if slope is not None:
            x, y = lines[f"slope {minus(f'{slope:.0f}')} dB/decade"].get_data()
            assert (y[1] - y[0]) / np.log10(x[1] / x[0]) == pytest.approx(slope)
            assert x[0] <= at * 1.001
            assert x[1] > at
    for name, marks in (("resonance", (2.0, 9.0)), ("antiresonance", (5.0,))):
        x, y = lines[name].get_data()
        np.testing.assert_allclose(x, marks)
        np.testing.assert_allclose(y, 20 * np.log10(3 / (1 + x**2)), atol=0.1)
    [shade] = [p for p in ax.patches if p.get_label() == "not explained by the input"]
    assert shade.get_x() == 40.0
    below = figure.axes[1]
    heights = [bar.get_height() for bar in below.patches]
    np.testing.assert_allclose(heights, 0.5 ** np.arange(12.0))
    assert below.lines[0].get_ydata()[0] == 0.01
    assert ax.get_ylabel() == "$|G|$ [dB re 1 mm/A]"


def test_no_line_crosses_a_gap() -> None:
    t, y = _with_gaps(np.array([0.0, 1.0, 2.0, 5.0, 6.0, 9.0]), np.arange(6.0))

    assert np.flatnonzero(np.isnan(y)).tolist() == [3, 6]
    np.testing.assert_allclose(t, [0, 1, 2, 2, 5, 6, 6, 9], atol=1e-6)


def test_the_band_about_zero_is_where_coefficients_are_judged(second: Any) -> None:
    found = impulse_response(
        second.dataset(np.random.default_rng(1)), 30, kernel=None, integrator=False
    )

    [ax] = found.plot(level=0.95).axes

    band = np.max(np.abs(ax.collections[0].get_paths()[0].vertices[:, 1]))
    assert band == pytest.approx(float(np.max(found.band(0.95))), rel=1e-6)
    assert "95 % confidence" in ax.get_legend().get_texts()[0].get_text()
