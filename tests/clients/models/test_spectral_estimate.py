"""A frequency response estimated without a structure."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from armrig.models.spectral_estimate import (
    gain_unit,
    high_band,
    high_slope,
    log_slope,
    low_slope,
)
from matplotlib.figure import Figure

from tests.clients.models.made_fits import made_estimate


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
    assert gain_unit(SimpleNamespace(unit=unit, input_unit=input_unit), rate=rate) == text


def test_the_phase_continues_after_an_unknown_frequency() -> None:
    """A delay of three samples turns the phase by more than a circle; one frequency is NaN."""
    omega = np.linspace(0.1, 3.0, 30)
    delay = -3 * np.where(np.arange(30) == 10, np.nan, omega)

    np.testing.assert_allclose(made_estimate(omega, np.exp(1j * delay), Ts=1.0).phase, delay)


def test_the_rate_of_an_estimate_is_its_difference_quotient() -> None:
    """(1 - exp(-iωTs))/Ts: deviations by its modulus, spectra by the square, phases as before."""
    omega = np.array([2.0, 9.0, 30.0])
    factor = (1 - np.exp(-1j * omega * 0.1)) / 0.1
    known = {
        name: np.array([0.1, 0.2, 0.5]) * (k + 1)
        for k, name in enumerate(
            ("std_magnitude", "noise_spectrum", "noise_std", "noise_only_std", "nonlinear_std")
        )
    }
    kept = {"std_phase": np.array([0.1, 0.3, 0.7]), "coherence": np.array([0.9, 0.5, 0.1])}
    found = made_estimate(omega, [1.0, 2j, -3.0], integrator=True, **known, **kept)

    rate = found.rate()

    np.testing.assert_allclose(rate.G, found.G * factor)
    for name, x in known.items():
        power = 2 if name in ("noise_spectrum", "noise_std") else 1
        np.testing.assert_allclose(getattr(rate, name), x * np.abs(factor) ** power)
    for name, x in kept.items():
        np.testing.assert_array_equal(getattr(rate, name), x)
    assert (rate.output, rate.unit, rate.integrator) == ("velocity", "rad/s", False)
    bare = made_estimate(omega, found.G, unit="").rate()
    assert (bare.unit, bare.noise_spectrum, bare.nonlinear_std) == ("", None, None)


def test_slopes_are_those_of_the_bands_at_each_end() -> None:
    """First decade -20 dB, then -60 dB a decade; one frequency is not believed."""
    omega = np.geomspace(0.1, 30.0, 60)
    G = np.where(omega < 1, 1 / omega, 1 / omega**3)
    found, believed = made_estimate(omega, G), np.delete(np.arange(60), 3)

    slope, low = low_slope(found, believed)

    assert slope == pytest.approx(-20)
    assert low.tolist() == [w for w in omega[believed] if w <= 0.1 * np.sqrt(10)]
    assert high_slope(found, believed) == pytest.approx(-60)
    band = omega[high_band(found, believed)]
    top = 0.6 * np.pi / 0.1
    assert band.tolist() == [w for w in omega if top / 10 ** (1 / 3) <= w <= top]
    few = high_band(found, np.array([0, 10, 20, 30, 40]))
    assert few.tolist() == [20, 30, 40]
    assert low_slope(found, np.array([0, 20, 21, 30]))[1].tolist() == omega[[0, 20, 21]].tolist()
    nothing = np.zeros(0, dtype=int)
    assert np.isnan(high_slope(found, nothing))
    assert np.isnan(low_slope(found, nothing)[0])


def test_a_slope_is_that_of_a_fitted_line() -> None:
    rng = np.random.default_rng(0)
    omega = np.geomspace(1.0, 30.0, 12)
    magnitude = omega**-1.5 * 10 ** (0.05 * rng.standard_normal(12))

    slope = log_slope(omega, magnitude)

    expected, _ = np.polyfit(np.log10(omega), 20 * np.log10(magnitude), 1)
    assert slope == pytest.approx(expected)


def test_only_known_values_are_passed_to_python_control() -> None:
    omega = np.array([1.0, 2.0, 4.0])

    system = made_estimate(omega, [1.0, np.nan, 3j]).to_control()

    assert system.omega.tolist() == [1.0, 4.0]
    assert np.ravel(system.frdata).tolist() == [1.0, 3j]
    assert system.dt == 0.1


def test_a_figure_begins_between_minus_360_and_0_degrees() -> None:
    """Deviations are bands of ±1.96 about the curves; the axis of the coherence is shared."""
    omega = np.geomspace(1.0, 30.0, 20)
    for first in (10.0, 170.0, -350.0):
        G = 2.0 * np.exp(1j * np.radians(first - 40 * np.log(omega)))
        std = np.full(20, 0.1)
        found = made_estimate(
            omega, G, std_magnitude=std, std_phase=std, coherence=np.linspace(0.2, 0.9, 20),
            nonlinear_std=0.02 * G.real**2, noise_only_std=np.full(20, 0.02),
        )  # fmt: skip

        ax, below, *rest = found.plot(ax=Figure().add_subplot()).axes

        (curve,) = (line for line in ax.lines if line.get_label() == "by hand")
        phase = np.asarray(below.lines[0].get_ydata())
        assert -360 < phase[0] <= 0
        assert (phase[0] - first) % 360 == pytest.approx(0, abs=1e-6)
        np.testing.assert_allclose(phase - phase[0], -40 * np.log(omega), atol=1e-9)
        np.testing.assert_allclose(np.asarray(curve.get_ydata()), 20 * np.log10(2.0))
        band = below.collections[0].get_paths()[0].vertices
        assert band[:, 1].max() - phase.max() == pytest.approx(np.degrees(1.96 * 0.1), rel=1e-3)
        names = [line.get_label() for line in ax.lines]
        assert "nonlinear distortion (one realisation)" in names
        noise = ax.lines[names.index("noise")]
        np.testing.assert_allclose(np.asarray(noise.get_ydata()), 20 * np.log10(0.02))
        shown = [line for axis in rest for line in axis.lines]
        np.testing.assert_array_equal(shown[-1].get_ydata(), np.linspace(0.2, 0.9, 20))
        assert "rad/V" in ax.get_ylabel()
