"""A model in continuous time: sampling, conversion, use on data, texts and its file."""

from __future__ import annotations

from pathlib import Path

import control
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation.polynomial_structures import armax, oe
from armrig.estimation.transfer_functions import tf
from armrig.models.fit import Fit
from armrig.models.model_file import load_fit
from armrig.validation.comparison import compare
from armrig.validation.residuals import residuals
from armrig_core.errors import InputError
from scipy.signal import lfilter

from tests.clients.estimation.test_transfer_functions import TS, data

PLANT = {"B": (1.0, 4.0), "F": (1, 3.0, 6.0, 4.0)}


@pytest.fixture(scope="module")
def fit() -> Fit:
    """Return a model with a zero, a real pole and a pair."""
    return tf(data(**PLANT), poles=3, zeros=1, delay=0.05)


def test_a_model_goes_to_discrete_time_and_back(fit: Fit) -> None:
    fit = tf(data(**PLANT), poles=3, zeros=1)
    back = fit.to_discrete().to_continuous()

    np.testing.assert_allclose(back.theta, fit.theta, rtol=1e-8)
    np.testing.assert_allclose(back.covariance, fit.covariance, rtol=1e-5)


@pytest.mark.parametrize("Ts", [TS, 0.03])
def test_the_covariance_of_a_sampled_model_is_that_of_its_derivatives(fit: Fit, Ts: float) -> None:
    sampled = fit.to_discrete(Ts)
    J = np.empty((sampled.theta.size, fit.theta.size))
    for k, h in enumerate(1e-6 * np.abs(fit.theta)):
        ahead, behind = (
            fit.form.replaced(fit.theta + s * h * np.eye(fit.theta.size)[k]).sampled(Ts)[0].theta
            for s in (1, -1)
        )
        J[:, k] = (ahead - behind) / (2 * h)

    np.testing.assert_allclose(sampled.std, np.sqrt(np.diag(J @ fit.covariance @ J.T)), rtol=1e-4)


def test_noise_and_equation_error_models_are_converted_too() -> None:
    model = armax(data(B=(1.0, 4.0), H=([1.0], [1.0, -1.7, 0.75])), na=2, nb=2, nc=1)
    there = model.to_continuous().to_discrete()
    omega = np.array([0.1, 1.0, 10.0])

    for of in ("frequency_response", "noise_spectrum"):
        a, b = (getattr(m, of)(omega) for m in (model, there))
        name = "G" if of == "frequency_response" else "Phi"
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-6)
    a, b = (m.frequency_response(omega).std_magnitude for m in (model, there))
    np.testing.assert_allclose(a, b, rtol=1e-4)


def test_a_pole_without_a_logarithm_is_refused() -> None:
    negative = Fit.of_channel(B=[0, 1.0, 0.2], F=[1, -0.1, -0.3], nk=1, Ts=TS)
    with pytest.raises(InputError, match=r"a pole at z = -0.5.*lower the order, or estimate in s"):
        negative.to_continuous()
    direct = Fit.of_channel(B=[1.0, 1.0], F=[1, -0.5], nk=0, Ts=TS)
    with pytest.raises(InputError, match="Estimate with nk=1 and nb=1"):
        direct.to_continuous()
    with pytest.raises(InputError, match="already sampled"):
        negative.to_discrete(TS)


def test_predictions_residuals_and_comparison_are_those_of_the_sampled_model(fit: Fit) -> None:
    own, new, sampled = data(**PLANT), data(9, **PLANT), fit.to_discrete()

    np.testing.assert_array_equal(fit.predict(new), sampled.predict(new))
    np.testing.assert_array_equal(fit.simulate(new.u), sampled.simulate(new.u))
    assert residuals(fit, new).missing_dynamics == pytest.approx(
        residuals(sampled, new).missing_dynamics, abs=1e-6
    )
    assert residuals(fit, own).white.p_value == pytest.approx(fit.whiteness)
    assert compare(new, fit)[0].fit_percent == compare(new, sampled)[0].fit_percent


def test_the_response_is_that_of_python_control() -> None:
    fit = tf(data(**PLANT), poles=3, zeros=1)
    omega = np.array([0.0, 1.0, 100.0])

    np.testing.assert_allclose(
        fit.frequency_response(omega).G, control.frequency_response(fit.to_control(), omega).complex
    )


def test_the_numbers_of_a_plant_have_the_deviations_of_their_derivatives() -> None:
    fit = tf(data(**PLANT), poles=3, zeros=1, delay="estimate")
    numbers, h = fit.quantities(), 1e-6
    assert {*numbers} >= {"gain", "time constant", "natural frequency", "damping", "delay"}

    for name, found in numbers.items():
        gradient = []
        for k, value in enumerate(fit.theta):
            step = h * abs(value) * np.eye(fit.theta.size)[k]
            a, b = (
                Fit(**{**vars(fit), "form": fit.form.replaced(fit.theta + s * step)})
                .quantities()[name]
                .value
                for s in (1, -1)
            )
            gradient.append((a - b) / (2 * h * abs(value)))
        std = np.sqrt(gradient @ fit.covariance @ gradient)
        assert found.std == pytest.approx(std, rel=1e-4), name


def test_the_gain_of_a_model_with_a_pole_that_may_be_0_is_not_determined() -> None:
    """The response is a ramp, and the model has no integrator."""
    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([1.0, 3.0], 100), 10)
    y = 0.05 * np.cumsum(lfilter([0, 0.2], [1, -0.8], u)) + 0.01 * rng.standard_normal(u.size)

    found = tf(Dataset(u=u, y=y, Ts=0.05), poles=2, zeros=0).quantities()

    assert np.isnan(found["gain"].value)
    first, second = repr(found).splitlines()
    assert first == "gain           not determined: a pole may be 0; estimate with an integrator"
    assert second.startswith("time constant  0.2")


def test_a_file_contains_the_model_with_all_digits(fit: Fit, tmp_path: Path) -> None:
    fit.save(tmp_path / "fit.json")
    loaded = load_fit(tmp_path / "fit.json")

    assert repr(loaded) == repr(fit)
    np.testing.assert_array_equal(loaded.theta, fit.theta)
    assert (loaded.form.delay, loaded.form.Ts, loaded.form.hold) == (0.05, TS, "zoh")


def test_the_text_has_the_equation_in_s_and_the_numbers(fit: Fit) -> None:
    lines = repr(fit).splitlines()

    assert lines[0].startswith("TF(poles=3, zeros=1): u [V] to speed [rad/s], continuous time")
    assert lines[1] == "  y(t) = B(s)/F(s) u(t - delay) + e(t)"
    assert lines[2].startswith("  B(s) = ")
    assert " s + " in lines[2]
    assert lines[3].startswith("  F(s) = s^3 + ")
    assert any(line.startswith("  time constant") for line in lines)
    assert "F(s) &= s^{3} + (" in fit.latex()
    assert 'u(t - "delay")' in fit.typst()  # Typst refuses an unknown variable


def test_summary_and_figures_use_the_sampled_model(fit: Fit) -> None:
    assert repr(fit.summary()) == repr(fit.to_discrete().summary())
    assert len(fit.plot().axes) == len(oe(data(), nb=2, nf=2).plot().axes)
