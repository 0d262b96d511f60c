"""Characteristics by which models are compared with the physics (handout, assignment 3.4)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import armrig
import numpy as np
import pytest
from armrig.models import characteristics
from armrig.models.characteristics import SCALARS, model_characteristics, overlapping
from armrig.numerics.polynomial import apply_filter
from armrig.physics.systems import physical_model
from armrig_core.rig.arm import ArmParameters, arm_matrices

from tests.clients.models.made_fits import made
from tests.sampling import sampled

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant

HANDOUT = ArmParameters()


def test_the_figures_of_the_physics_follow_from_its_parameters(plant: HandoutPlant) -> None:
    """Gain 1/(N K_m), anti-resonance sqrt(K_lin/J_2), the eigenvalues as poles, no deviations."""
    t = model_characteristics(physical_model(HANDOUT, plant.dataset(1)))
    eigenvalues = np.linalg.eigvals(arm_matrices(HANDOUT)[0])

    assert t.integrating
    assert t.gain == pytest.approx(1 / (HANDOUT.N * HANDOUT.K_m), rel=1e-6)
    assert t.antiresonance == pytest.approx(np.sqrt(HANDOUT.K_lin / HANDOUT.J_2), rel=2e-3)
    assert np.sort(np.abs(t.poles)) == pytest.approx(np.sort(np.abs(eigenvalues)), abs=1e-4)
    assert set(t.std.values()) == {0.0}


def test_only_the_deviations_of_real_poles_are_sampled() -> None:
    F = np.real(np.poly([0.97 * np.exp(1j), 0.97 * np.exp(-1j), 0.9, 0.86]))
    fit = made(F=F.tolist(), std=[1e-3] * 5)

    t = model_characteristics(fit)

    assert np.abs(fit.poles().values[0]) > 0.95  # the fast pair comes first there
    assert (t.poles_sampled == (t.poles.imag == 0)).all()


@pytest.mark.parametrize("seed", sampled([0, 2]))
def test_a_deviation_is_the_scatter_of_draws(plant: HandoutPlant, seed: int) -> None:
    """200 draws determine a deviation to 5 %, if the linearisation is good."""
    fit = armrig.oe(plant.dataset(seed, N=1500), nb=4, nf=4, integrator=True, starts="few")
    t = model_characteristics(fit)
    assert t.draws is not None
    drawn = [model_characteristics(_moved(fit, theta)) for theta in t.draws.theta[:200]]

    for name in SCALARS:
        x = np.array([getattr(d, name) for d in drawn])
        scatter = np.sqrt(np.mean((x - getattr(t, name)) ** 2))
        assert t.ranges[name].method == "linearised"
        assert t.std[name] == pytest.approx(scatter, rel=0.2), name


def _moved(fit: armrig.Fit, theta: np.ndarray) -> armrig.Fit:
    """Return a claim with other coefficients, b1 … b4 f1 … f4."""
    none = np.zeros((8, 8))
    form = fit.form.replaced(theta)
    return replace(fit, form=form, covariance=none, covariance_robust=none)


def test_a_resonance_is_the_peak_of_the_gain_to_rounding() -> None:
    """The peak of 1/|F|² for a pair of poles r exp(±iφ) has a closed form."""
    r, phi, Ts = 0.95, 0.4, 0.01
    fit = made(F=(1.0, -2 * r * np.cos(phi), r**2), Ts=Ts)
    peak = np.arccos((1 + r**2) / (2 * r) * np.cos(phi)) / Ts

    assert model_characteristics(fit).resonance == pytest.approx(peak, rel=1e-11)


@pytest.mark.parametrize("Ts", [0.002, 0.01])
def test_the_times_of_a_model_equal_the_step_analysis_at_any_Ts(Ts: float) -> None:
    """A chassis with a time constant of 20 ms, by its rate, and with a dead time."""
    pole = np.exp(-Ts / 0.02)
    # theta_1's answer to a held input: the integral of a first-order rate.
    B = np.array([0.0, Ts - 0.02 * (1 - pole), 0.02 * (1 - pole) - Ts * pole])
    F = np.convolve([1.0, -1.0], [1.0, -pole])
    u = np.repeat([0.0, 1.0], 200)
    data = armrig.Dataset(u=u, y=apply_filter(B, F, u), Ts=Ts, output="theta_1", unit="rad")
    fit = armrig.oe(data, nb=2, nf=2, integrator=True, starts="few")
    late = made(B=(0.0, 0.0, 0.0, 1 - pole), nk=3, F=(1.0, -pole), Ts=Ts)

    of_data, of_late = armrig.step_analysis(data), model_characteristics(late)
    for t in (model_characteristics(fit), of_late):
        assert t.rise_time == pytest.approx(0.02, rel=0.01)
        assert t.equivalent_time == pytest.approx(0.02, rel=0.025)
        assert t.slowest_time == pytest.approx(0.02, rel=1e-6)
    assert of_data.tau == pytest.approx(0.02, rel=0.01)
    assert of_data.equivalent_time == pytest.approx(0.02, rel=1e-3)


@pytest.mark.parametrize("gain", [2.0, -3.0])
def test_an_oscillator_of_any_gain_has_the_figures_of_the_textbook(gain: float) -> None:
    """Damping 0.2 at 20 rad/s; z-plane sampling at 10 ms hardly moves the figures."""
    zeta, w, Ts = 0.2, 20.0, 0.01
    z = np.exp((-zeta + 1j * np.sqrt(1 - zeta**2)) * w * Ts)
    F = np.real(np.poly([z, z.conjugate()]))

    t = model_characteristics(made(B=(0, gain * F.sum()), F=F.tolist(), Ts=Ts))

    assert t.gain == pytest.approx(gain)
    assert t.resonance == pytest.approx(w * np.sqrt(1 - 2 * zeta**2), rel=1e-3)
    flat = 1 - 2 * zeta**2
    assert t.bandwidth == pytest.approx(w * np.sqrt(flat + np.sqrt(flat**2 + 1)), rel=5e-3)
    overshoot = 100 * np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2))
    assert t.overshoot == pytest.approx(overshoot, rel=2e-3)
    assert t.slowest_time == pytest.approx(1 / (zeta * w))
    assert np.isnan(t.antiresonance)
    assert not t.integrating


def test_poles_are_in_the_order_of_their_speed_with_their_own_deviations() -> None:
    """The deviation of s = log(z)/Ts is that of z divided by |z| Ts."""
    z = [0.5, 0.95, 0.9 * np.exp(0.3j), 0.9 * np.exp(-0.3j), -0.4]
    fit = made(F=np.real(np.poly(z)).tolist(), std=[0.001] * 6)

    t = model_characteristics(fit)

    s = np.log(np.array(z[:4], complex)) / fit.Ts
    expected = s[[1, 2, 3, 0]]
    np.testing.assert_allclose(t.poles[:4].real, expected.real, rtol=1e-9)
    np.testing.assert_allclose(np.abs(t.poles[:4].imag), np.abs(expected.imag), atol=1e-9)
    assert np.isnan(t.poles[4])
    pairs = zip(np.abs(fit.poles().values).tolist(), fit.poles().std, strict=True)
    own = {round(modulus, 6): std for modulus, std in pairs}
    for pole, std in zip(t.poles[:4], t.poles_std[:4], strict=True):
        modulus = float(np.exp(pole.real * fit.Ts))
        assert std == pytest.approx(own[round(modulus, 6)] / (modulus * fit.Ts), rel=1e-9)


def test_pairs_that_cancel_are_listed_once_and_the_closest_first() -> None:
    zeros, poles = [0.6 + 0.31j, 0.6 - 0.31j, 0.9], [0.6 + 0.3j, 0.6 - 0.3j, 0.88]
    B, F = np.real(np.poly(zeros)), np.real(np.poly(poles))
    fit = made(B=[0.0, *B], F=F.tolist(), std=[0.02] * 7)
    sure = made(B=[0.0, *B], F=F.tolist(), std=[1e-6] * 7)

    found = overlapping(fit)

    assert [(round(p.real, 6), round(p.imag, 6)) for p, _, _ in found] == [(0.6, 0.3), (0.88, 0.0)]
    assert [zero for _, zero, _ in found] == pytest.approx([0.6 + 0.31j, 0.9])
    assert all(0.01 < p < 1 for _, _, p in found)
    assert overlapping(sure) == []


def test_the_pole_of_an_integrator_is_not_part_of_a_pair() -> None:
    for letter in ("A", "F"):
        p = {letter: [1.0, -1.5, 0.5]}
        claimed = made(B=(0, 1, -0.999), **p, integrator=True, std=[0.1] * 4)
        free = made(B=(0, 1, -0.999), **p, std=[0.1] * 4)

        assert 1.0 not in [round(pole.real, 6) for pole, _, _ in overlapping(claimed)]
        assert 1.0 in [round(pole.real, 6) for pole, _, _ in overlapping(free)]


@pytest.mark.parametrize(
    ("undefined", "known"), [(0, True), (20, True), (21, False), (399, False), (400, False)]
)
def test_a_range_is_known_if_the_figure_exists_in_19_of_20_draws(
    undefined: int, known: bool
) -> None:
    samples = 5.0 + 0.1 * np.random.default_rng(1).standard_normal(400)
    samples[:undefined] = np.nan

    found = characteristics._range(5.0, 0.1, samples)

    assert bool(np.isfinite(found.low)) == known
    assert np.isnan(characteristics._range(float("nan"), 0.1, samples).low)
    assert characteristics._range(5.0, float("nan"), samples).method == "sampled"
    same = characteristics._range(5.0, 0.1, np.full(400, 5.0))
    assert (same.low, same.high) == (pytest.approx(4.804, abs=1e-3), pytest.approx(5.196, abs=1e-3))


@pytest.mark.parametrize(("pole", "expected"), [(1.0049, True), (0.9951, True), (0.9949, False)])
def test_a_pole_within_5e_3_of_1_integrates(pole: float, expected: bool) -> None:
    assert characteristics.integrates(made(F=(1, -pole))) is expected
    assert characteristics.integrates(made(A=(1, -pole))) is expected
    assert characteristics.integrates(made(F=(1, -1), integrator=True))


@pytest.mark.parametrize("letter", ["A", "F"])
def test_a_claimed_integrator_has_the_gain_of_its_rate(letter: str) -> None:
    """0.3 / ((1 - 0.9) Ts), and the pole at 0 is the slowest."""
    p = {letter: [1.0, -1.9, 0.9]}

    t = model_characteristics(made(B=(0, 0.3), Ts=0.02, integrator=True, **p))

    assert t.integrating
    assert t.gain == pytest.approx(0.3 / 0.1 / 0.02)
    assert t.poles == pytest.approx([0.0, np.log(0.9) / 0.02])
    assert t.slowest_time == pytest.approx(-0.02 / np.log(0.9))
    assert np.isnan([t.resonance, t.antiresonance]).all()
    assert t.overshoot == pytest.approx(0, abs=1e-6)
