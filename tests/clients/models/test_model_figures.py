"""Figures of models, read back from their lines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.models.figures import continuous_phase, plot_bode, plot_step
from armrig.models.fit import Fit
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tests.clients.models.made_fits import apart, fit_of_form, made, made_estimate

Vector = NDArray[np.float64]


def lag(pole: float = 0.8, *, Ts: float = 0.1, std: float = 0.0, **fields: Any) -> Fit:
    """Return a lag of first order with the gain 2; b and f have this relative deviation."""
    b = 2 * (1 - pole)
    deviations = [std * b, std * (1 - pole)] if std else []
    return made(B=(0, b), F=(1, -pole), Ts=Ts, std=deviations, **fields)


def drawn_line(ax: Axes, label: str) -> tuple[Vector, Vector]:
    """Return x and y of the line with this label."""
    (line,) = (line for line in ax.lines if line.get_label() == label)
    return np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)


def axes_of(figure: Any) -> list[Axes]:
    return list(figure.figure.axes)


def test_frequencies_end_at_the_highest_nyquist_frequency_of_the_models() -> None:
    """Each curve ends at its own."""
    ax = plot_bode(lag(Ts=0.1), lag(Ts=0.02), labels=("slow", "fast"), ax=Figure().add_subplot())

    slow, fast = (drawn_line(ax, name)[0] for name in ("slow", "fast"))
    assert ax.get_xlim() == pytest.approx((np.pi / 0.02 / 600, np.pi / 0.02))
    assert fast[-1] == pytest.approx(np.pi / 0.02)
    assert np.pi / 0.1 * 0.97 < slow[-1] <= np.pi / 0.1
    omega = [1.0, 2.0, 40.0]
    given = plot_bode(lag(Ts=0.1), labels=("slow",), omega=omega, ax=Figure().add_subplot())
    assert drawn_line(given, "slow")[0].tolist() == [1.0, 2.0]


def test_the_phase_of_an_estimate_is_drawn_within_half_a_turn_of_the_model() -> None:
    """The phase of the model is near -200°, that of the dots 160°."""
    omega = np.array([1.0, 2.0, 4.0, 8.0])
    fit = made(B=(0, -0.4), F=(1, -0.8))
    G = fit.frequency_response(omega).G

    ax = plot_bode(fit, made_estimate(omega, G, output="alpha"), omega=np.geomspace(0.5, 9, 30))

    dots: Any = axes_of(ax)[1].containers[0]
    y = np.asarray(dots[0].get_ydata())
    curve = np.asarray(axes_of(ax)[1].lines[0].get_xydata())
    np.testing.assert_allclose(y, np.interp(omega, *curve.T), atol=1.0)


@pytest.mark.parametrize(("Ts", "n"), [(0.1, 50), (0.02, 50), (0.01, 100), (2.0, 50)])
def test_the_length_of_a_step_is_at_least_a_second_or_50_samples(Ts: float, n: int) -> None:
    ax = plot_step(lag(Ts=Ts), labels=("a",), ax=Figure().add_subplot())
    short = plot_step(lag(Ts=Ts), n=7, labels=("a",), ax=Figure().add_subplot())

    t, y = drawn_line(ax, "a")
    assert t.size == n + 1
    assert (t[0], y[0], t[-1]) == (0.0, 0.0, pytest.approx((n - 1) * Ts))
    assert drawn_line(short, "a")[0].size == 8


def test_a_band_of_a_step_is_1_96_deviations_wide_but_does_not_flatten_the_curves() -> None:
    fit, wide = lag(std=0.02), lag(std=0.02, whiteness=1e-6)
    std = fit.step_response(50).std

    for model, factor in ((fit, 1.0), (wide, 2.0)):
        ax = plot_step(model, labels=("a",), ax=Figure().add_subplot())
        vertices = ax.collections[0].get_paths()[0].vertices
        assert vertices[:, 1].max() == pytest.approx(
            np.max(fit.step_response(50).y + 1.96 * factor * std), rel=0.02
        )
    low, high = plot_step(lag(pole=0.5, std=2.5)).get_ylim()
    assert (low, high) == (pytest.approx(-2.0, abs=0.3), pytest.approx(4.0, abs=0.3))


def test_a_phase_that_jumps_by_half_a_turn_stays_between_minus_360_and_0() -> None:
    for angles in ([-100, -160, 170, 100], [-10, -170, 20, 10, -350], [-300, -350, 5, 20]):
        phase = continuous_phase(np.exp(1j * np.radians(np.array(angles, float))))

        known = np.isfinite(phase)
        turned = (phase[known] - np.array(angles, float)[known]) / 360
        np.testing.assert_allclose(turned, np.round(turned), atol=1e-9)
        assert -360 <= phase[0] <= 0


def test_a_model_of_several_signals_has_a_panel_for_each_channel() -> None:
    """The input v does not reach b."""
    figure = fit_of_form(apart()).plot()

    legends = [legend for ax in figure.axes if (legend := ax.get_legend())]
    shown = [text.get_text() for legend in legends for text in legend.get_texts()]
    channels = ["u to a", "v to a", "w to a", "u to b", "w to b"]
    assert [name.partition(",")[0] for name in shown] == channels
