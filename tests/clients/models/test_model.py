"""A model without an estimate: it answers as a fit does, and claims no uncertainty."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import armrig
import numpy as np
import pytest
from armrig.models.fit import Fit
from armrig.physics.systems import physical_model
from armrig_core.errors import InputError
from armrig_core.rig.arm import ArmParameters, arm_matrices, zero_order_hold
from numpy.typing import NDArray

from tests.clients.models.made_fits import changed, made

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant


Vector = NDArray[np.float64]


@pytest.fixture(scope="module")
def fit(plant: HandoutPlant) -> armrig.Fit:
    return armrig.oe(plant.dataset(1, N=800), nb=4, nf=4, integrator=True, starts="few")


def test_a_model_that_was_not_estimated_has_no_deviations_and_no_loss() -> None:
    model = Fit.of_channel(B=[0, 0.3], F=np.convolve([1, -1], [1, -0.6]), nk=1, Ts=0.1)

    assert (model.label, model.heading) == ("model", "model(nb=1, nf=2, nk=1)")
    assert repr(model).splitlines()[0] == "model(nb=1, nf=2, nk=1): u to y, Ts 0.1 s"
    assert "±" not in repr(model)
    assert not model.trusts_robust
    assert not model.poles().covariance.any()
    assert not model.step_response(9).std.any()
    for name in ("loss", "N", "fit_percent", "whiteness", "aic"):
        with pytest.raises(InputError, match="model was not estimated: it has no loss"):
            getattr(model, name)
    with pytest.raises(InputError, match="model was not estimated: it has no noise model to test"):
        armrig.residuals(model, armrig.Dataset(u=[0.0, 1.0], y=[0.0, 1.0], Ts=0.1))


def test_the_physical_model_of_alpha_is_that_of_the_arm() -> None:
    """The pulse response is C Phi^(k-1) Gamma of the second output, without an integrator."""
    A, B, C = arm_matrices(ArmParameters())
    data = armrig.Dataset(u=np.zeros(2), y=np.zeros(2), Ts=0.01, output="alpha", unit="rad")
    Phi, Gamma = zero_order_hold(A, B, data.Ts)
    x, expected = Gamma[:, 0], [0.0]
    for _ in range(49):
        expected.append(float(C[1] @ x))
        x = Phi @ x

    physics = physical_model(ArmParameters(), data)

    np.testing.assert_allclose(physics.simulate(np.eye(1, 50)[0]), expected, rtol=1e-9, atol=1e-14)
    assert physics.orders == {"nb": 3, "nf": 3, "nk": 1}
    assert not physics.integrator
    assert np.all(np.abs(np.roots(physics.F)) < 1)


def test_a_pole_has_a_deviation_with_an_ill_conditioned_covariance(fit: armrig.Fit) -> None:
    """J C J' is rounded below 0 if a direction that moves no pole has a large variance."""
    poles = np.array([0.95 + 0.025j, 0.95 - 0.025j, 0.99 + 0.008j, 0.99 - 0.008j])
    F = np.poly(poles).real
    powers = poles[0] ** np.arange(3, -1, -1)
    still = np.linalg.svd(np.vstack([powers.real, powers.imag]))[2][2:]
    plain = changed(fit, F=F, structure="OE", integrator=False)
    f = plain.slice_of("f")

    for v in np.random.default_rng(3).standard_normal((20, 2)) @ still:
        covariance = np.zeros((f.stop, f.stop))
        covariance[f, f] = 1e4 * np.outer(v, v)
        with np.errstate(invalid="raise"):
            known = replace(plain, covariance=covariance, covariance_robust=covariance)
            assert np.isfinite(known.poles().std).all()


def whole() -> armrig.Fit:
    """Return a model with five polynomials of different orders."""
    return made(
        A=(1, -0.5),
        B=(0, 0, 1, 0.5),
        C=(1, 0.3, 0.1),
        D=(1, -0.7, 0.2, 0.1),
        F=(1, -1.5, 0.7, -0.1),
        nk=2,
        std=0.01 * np.arange(1, 12),
    )


def test_python_control_accepts_both_transfer_functions() -> None:
    """B/(A F) from u, C/(A D) from e."""
    fit, omega = whole(), np.array([0.3, 4.0, 20.0])
    x = np.exp(-1j * omega * fit.Ts)
    p = {letter: np.polyval(getattr(fit, letter)[::-1], x) for letter in "ABCDF"}

    np.testing.assert_allclose(fit.to_control()(1 / x), p["B"] / (p["A"] * p["F"]))
    np.testing.assert_allclose(fit.noise_to_control()(1 / x), p["C"] / (p["A"] * p["D"]))
    assert (fit.noise_to_control().dt, fit.noise_to_control().input_labels) == (0.1, ["e"])
    Phi = fit.noise_spectrum(omega).Phi
    np.testing.assert_allclose(Phi, 0.04 * 0.1 * np.abs(p["C"] / (p["A"] * p["D"])) ** 2)
    np.testing.assert_allclose(fit.frequency_response(omega).G, p["B"] / (p["A"] * p["F"]))


@pytest.mark.parametrize("integrating", ["", "a", "f"])
def test_deviations_follow_from_the_derivatives(integrating: str) -> None:
    """Each of the parameters is moved alone: |G|, its phase, the step, the noise and the roots."""
    fit, omega = whole(), np.array([0.3, 4.0, 20.0])
    if integrating:
        p = getattr(fit, integrating.upper())
        fit = changed(fit, **{integrating.upper(): np.convolve(p, [1, -1])})
        d = fit.theta.size
        P = np.diag(np.square(0.01 * np.arange(1, d + 1)))
        fit = replace(fit, covariance=P, covariance_robust=P)
    d = fit.theta.size

    def moved(h: Vector) -> list[Vector]:
        theta = fit.theta + h
        parts = {letter: theta[fit.slice_of(letter)] for letter in "abcdf"}
        other = changed(
            fit,
            B=np.append([0.0, 0.0], parts.pop("b")),
            **{letter.upper(): np.append(1.0, part) for letter, part in parts.items()},
        )
        G = other.frequency_response(omega).G
        zeros = other.zeros().values
        Phi = other.noise_spectrum(omega).Phi
        return [np.abs(G), np.angle(G), other.step_response(12).y, Phi, zeros.real]

    std = np.sqrt(np.diag(fit.covariance))
    variances: list[Vector] = [np.zeros(x.size) for x in moved(np.zeros(d))]
    for k in range(d):
        h = np.zeros(d)
        h[k] = 1e-6
        ends = zip(moved(h), moved(-h), strict=True)
        for v, (above, below) in zip(variances, ends, strict=True):
            v += ((above - below) / 2e-6 * std[k]) ** 2

    response, spectrum = fit.frequency_response(omega), fit.noise_spectrum(omega)
    np.testing.assert_allclose(response.std_magnitude**2, variances[0], rtol=1e-4)
    np.testing.assert_allclose(response.std_phase**2, variances[1], rtol=1e-4)
    step = fit.step_response(12).std
    np.testing.assert_allclose(step**2, variances[2], rtol=1e-4, atol=1e-12)
    of_lambda = 2 / fit.N * spectrum.Phi**2
    np.testing.assert_allclose(spectrum.std**2, variances[3] + of_lambda, rtol=1e-4)
    np.testing.assert_allclose(fit.zeros().covariance[:, 0, 0], variances[4], rtol=1e-4)


def test_a_rate_is_the_step_difference_at_the_middle_of_each_interval() -> None:
    for fit in (whole(), replace(whole(), Ts=0.02)):
        step, rate = fit.step_response(9), fit.step_response(8, rate=True)

        np.testing.assert_allclose(step.t, fit.Ts * np.arange(9))
        np.testing.assert_allclose(rate.t, fit.Ts * (np.arange(8) + 0.5))
        np.testing.assert_allclose(rate.y, np.diff(step.y) / fit.Ts, atol=1e-12)
        assert (step.rate, rate.rate) == (False, True)


def test_an_integrator_is_a_pole_at_1_without_a_deviation_and_no_parameter() -> None:
    for letter, other in (("A", "F"), ("F", "A")):
        p = {letter: np.convolve([1, -1.0000001], [1, -0.6]).tolist()}
        fit = made(B=(0, 1, 0.5), **p, integrator=True, std=[0.1] * 4)

        poles = fit.poles()

        at = int(np.argmin(np.abs(poles.values - 1)))
        assert poles.values[at] == 1.0
        assert poles.std[at] == 0.0
        assert poles.std[1 - at] > 0
        assert fit.parameters == 3
        assert fit.integrating == letter.lower()
        assert changed(fit, integrator=False).parameters == 4
        assert changed(fit, integrator=False).integrating == ""
        assert getattr(fit, other).tolist() == [1.0]


def test_roots_are_printed_with_their_deviations() -> None:
    """z² - 1.2 z + 0.52 has the roots 0.6 ± 0.4i."""
    roots = made(F=(1, -1.2, 0.52), std=(0.1, 1e-3, 2e-3)).poles()
    re, im = 0.5e-3, float(np.hypot(0.6 * 0.5e-3 / 0.4, 1e-3 / 0.4))

    lines = repr(roots).splitlines()

    assert roots.std == pytest.approx([np.hypot(re, im)] * 2)
    assert lines[1].split() == ["0.60000", f"{re:.2g}", "0.40000", f"{im:.2g}", "0.72111", "0.588"]
    assert lines[2].split()[2] == "-0.40000"
    assert lines[2].split()[-1] == "-0.588"
    assert (len(roots), roots[1], [*roots]) == (2, 0.6 - 0.4j, [0.6 + 0.4j, 0.6 - 0.4j])
    assert repr(made().poles()) == "no roots"
