"""Figures of models, read back from their lines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.models.figures import _phase, plot_bode, plot_step
from armrig.models.fit import Fit
from armrig.models.pole_zero_figure import plot_poles_zeros
from armrig.models.spectral_estimate import SpectralEstimate
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tests.clients.models.made_fits import made

Vector = NDArray[np.float64]


def lag(pole: float = 0.8, *, Ts: float = 0.1, std: float = 0.0, **fields: Any) -> Fit:
    """Return a lag of first order with the gain 2; b and f have this relative deviation."""
    b = 2 * (1 - pole)
    deviations = [std * b, std * (1 - pole)] if std else []
    return made(B=(0, b), F=(1, -pole), Ts=Ts, std=deviations, **fields)


def integrating(Ts: float = 0.1, output: str = "alpha") -> Fit:
    """Return an integrator with a lag, gain 2 per s."""
    F = np.convolve([1, -1], [1, -0.8])
    return made(B=(0, 0.4 * Ts), F=F.tolist(), Ts=Ts, integrator=True, output=output)


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


def test_a_band_of_a_bode_plot_is_1_96_deviations_wide() -> None:
    """Decibels of |G| ± 1.96 std in the upper panel, degrees in the lower."""
    fit, omega = lag(std=0.01), np.array([0.5, 3.0, 20.0])
    response = fit.frequency_response(omega)

    ax = plot_bode(fit, omega=omega, labels=("one",), ax=Figure().add_subplot())

    assert ax.lines[0].get_label() == "one, 95 % linearised"
    below = axes_of(ax)[1]
    vertices = [panel.collections[0].get_paths()[0].vertices for panel in (ax, below)]
    for w, G, std, turn in zip(
        omega, response.G, response.std_magnitude, response.std_phase, strict=True
    ):
        edges = [np.unique(v[np.isclose(v[:, 0], w), 1]) for v in vertices]
        expected = 20 * np.log10(np.abs(G) + 1.96 * std * np.array([-1, 1]))
        assert (edges[0][0], edges[0][-1]) == pytest.approx(tuple(expected), abs=1e-3)
        degrees = np.degrees(np.angle(G) + 1.96 * turn * np.array([-1, 1]))
        assert (edges[1][0], edges[1][-1]) == pytest.approx(tuple(degrees), abs=1e-2)


def spectrum(omega: Vector, G: Any, **fields: Any) -> SpectralEstimate:
    values: dict[str, Any] = {
        "std_magnitude": np.full(omega.size, 0.1),
        "std_phase": np.full(omega.size, 0.05),
        "method": "spa, Hann",
        "integrator": False,
        "N": 60,
        "Ts": 0.1,
        "output": "alpha",
        "unit": "rad",
        "input_unit": "V",
        "source": "",
    }
    return SpectralEstimate(omega=omega, G=np.asarray(G, complex), **(values | fields))


def test_dots_are_on_the_turn_of_the_model_beside_them() -> None:
    """The phase of the model is near -200°, that of the dots 160°."""
    omega = np.array([1.0, 2.0, 4.0, 8.0])
    fit = made(B=(0, -0.4), F=(1, -0.8))
    G = fit.frequency_response(omega).G

    ax = plot_bode(fit, spectrum(omega, G), omega=np.geomspace(0.5, 9, 30))

    dots: Any = axes_of(ax)[1].containers[0]
    y = np.asarray(dots[0].get_ydata())
    curve = np.asarray(axes_of(ax)[1].lines[0].get_xydata())
    np.testing.assert_allclose(y, np.interp(omega, *curve.T), atol=1.0)


class Continuous:
    """A system like those of python-control, 3/(s + 2), or its value at z."""

    name = "theirs"

    def __init__(self, dt: float) -> None:
        """Have this sampling time; 0 for continuous time."""
        self.dt = dt

    def __call__(self, s: Any) -> Any:
        return 3 / (s + 2)


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_a_control_system_is_drawn_over_rad_per_s(dt: float) -> None:
    omega = np.array([0.5, 2.0, 10.0, 40.0])

    ax = plot_bode(Continuous(dt), omega=omega, ax=Figure().add_subplot())

    x, level = drawn_line(ax, "theirs")
    assert x.tolist() == [w for w in omega if not dt or w <= np.pi / dt]
    at = np.exp(1j * x * dt) if dt else 1j * x
    np.testing.assert_allclose(level, 20 * np.log10(np.abs(3 / (at + 2))))


def test_a_step_is_a_rate_only_if_all_models_integrate() -> None:
    both = plot_step(integrating(output="theta_1"), integrating(0.02), labels=("a", "b"))
    mixed = plot_step(integrating(), lag(), labels=("a", "b"))
    named = plot_step(integrating(output="lift"), labels=("a",))

    assert drawn_line(both, "a")[1][-1] == pytest.approx(2.0, rel=1e-2)
    assert drawn_line(both, "b")[1][-1] == pytest.approx(2.0, rel=1e-2)
    assert "[rad/s/V]" in both.get_ylabel()
    assert drawn_line(mixed, "a")[1][-1] > 4.0
    assert drawn_line(mixed, "b")[1][-1] == pytest.approx(2.0, rel=1e-2)
    assert mixed.get_ylabel().endswith("[rad/V]")
    assert named.get_ylabel() == "rate of lift [rad/s/V]"


@pytest.mark.parametrize(("Ts", "n"), [(0.1, 50), (0.02, 50), (0.01, 100), (2.0, 50)])
def test_a_step_is_as_long_as_a_second_or_50_samples(Ts: float, n: int) -> None:
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
        phase = _phase(np.exp(1j * np.radians(np.array(angles, float))))

        known = np.isfinite(phase)
        turned = (phase[known] - np.array(angles, float)[known]) / 360
        np.testing.assert_allclose(turned, np.round(turned), atol=1e-9)
        assert -360 <= phase[0] <= 0


def test_poles_and_zeros_are_in_the_z_plane_and_those_far_away_are_counted() -> None:
    B, F = np.real(np.poly([-0.5, 7.0, -9.0])), np.real(np.poly([0.6 + 0.4j, 0.6 - 0.4j, 0.9]))
    fit = made(B=[0.0, *B], F=F.tolist(), std=[1e-3] * 7)

    ax = plot_poles_zeros(fit, labels=("a",), ax=Figure().add_subplot())

    x, y = drawn_line(ax, "a, 95 %")
    assert sorted(zip(x.round(6), y.round(6), strict=True)) == [(0.6, -0.4), (0.6, 0.4), (0.9, 0.0)]
    zeros = next(line for line in ax.lines if line.get_marker() == "o")
    assert np.sort(np.asarray(zeros.get_xdata())) == pytest.approx([-9.0, -0.5, 7.0])
    assert [text.get_text() for text in ax.texts if "beyond" in text.get_text()] == [
        "2 beyond |z| = 2"
    ]
    (low, high), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert low < -0.5 < 1.0 < high < 2
    assert bottom == pytest.approx(-top)


def test_a_complex_pair_that_cancels_is_framed_above_and_below() -> None:
    zeros, poles = [0.6 + 0.401j, 0.6 - 0.401j, 0.1], [0.6 + 0.4j, 0.6 - 0.4j, 0.9]
    B, F = np.real(np.poly(zeros)), np.real(np.poly(poles))

    ax = plot_poles_zeros(made(B=[0.0, *B], F=F.tolist(), std=[0.01] * 7))

    (frame,) = (line for line in ax.lines if line.get_marker() == "s")
    assert np.asarray(frame.get_xdata()) == pytest.approx([0.6, 0.6], abs=1e-6)
    assert np.sort(np.asarray(frame.get_ydata())) == pytest.approx([-0.4005, 0.4005], abs=1e-6)
    assert frame.get_label() == "cannot be distinguished"
