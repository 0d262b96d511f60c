"""Characteristics by which models are compared with the physics (handout, assignment 3.4)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import armrig
import numpy as np
import pytest
from armrig.models import characteristics
from armrig.models.characteristics import SCALARS, model_characteristics
from armrig.numerics.polynomial import filtered
from armrig.physics.physical_model import physical_model
from armrig_core.arm import ArmParameters, arm_matrices

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant

HANDOUT = ArmParameters()


def test_the_physics_has_the_figures_that_follow_from_its_parameters(plant: HandoutPlant) -> None:
    """Gain 1/(N K_m), anti-resonance sqrt(K_lin/J_2), the eigenvalues as poles, no deviations."""
    t = model_characteristics(physical_model(HANDOUT, plant.dataset(1)))
    eigenvalues = np.linalg.eigvals(arm_matrices(HANDOUT)[0])

    assert t.integrating
    assert t.gain == pytest.approx(1 / (HANDOUT.N * HANDOUT.K_m), rel=1e-6)
    assert t.antiresonance == pytest.approx(np.sqrt(HANDOUT.K_lin / HANDOUT.J_2), rel=2e-3)
    assert np.sort(np.abs(t.poles)) == pytest.approx(np.sort(np.abs(eigenvalues)), abs=1e-4)
    assert set(t.std.values()) == {0.0}


def test_a_first_order_system_has_its_textbook_figures() -> None:
    """Gain 2, time constant 0.1 s, bandwidth 10 rad/s, neither resonance nor overshoot."""
    Ts, tau = 1e-3, 0.1
    pole = np.exp(-Ts / tau)
    fit = replace(_any_fit(), B=np.array([0.0, 2 * (1 - pole)]), F=np.array([1.0, -pole]), Ts=Ts)

    t = model_characteristics(fit)

    assert t.gain == pytest.approx(2.0)
    assert t.rise_time == pytest.approx(tau, rel=0.01)
    assert t.bandwidth == pytest.approx(1 / tau, rel=0.01)
    assert np.isnan([t.resonance, t.antiresonance]).all()
    assert t.overshoot == pytest.approx(0.0, abs=0.2)
    assert t.poles == pytest.approx([-1 / tau])


def test_the_deviations_of_the_slow_pair_of_real_poles_are_poor() -> None:
    F = np.real(np.poly([0.97 * np.exp(1j), 0.97 * np.exp(-1j), 0.9, 0.86]))
    P = 1e-6 * np.eye(5)
    fit = replace(_any_fit(), F=F, covariance=P, covariance_robust=P)

    t = model_characteristics(fit)

    assert np.abs(fit.poles().values[0]) > 0.95  # the fast pair comes first there
    assert (t.poles_sampled == (t.poles.imag == 0)).all()


@pytest.mark.exhaustive
def test_errors_are_as_large_as_the_deviations_reported(
    plant: HandoutPlant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over 30 experiments the errors divided by their deviations have an effective value near 1.

    Each experiment has deviations of its own: how well the gain shows depends on how far the
    telegraph has wandered.
    """
    monkeypatch.setattr(characteristics, "DRAWS", 12)  # for the ranges, which are not looked at
    truth = model_characteristics(physical_model(HANDOUT, plant.dataset(1)))
    found = [
        model_characteristics(
            armrig.oe(plant.dataset(seed, N=1500), nb=4, nf=4, integrator=True, starts="few")
        )
        for seed in range(30)
    ]

    for name in SCALARS:
        z = [(getattr(t, name) - getattr(truth, name)) / t.std[name] for t in found]
        assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.35, name


@pytest.mark.parametrize("seed", [0, 2])
def test_a_deviation_is_the_scatter_of_draws(plant: HandoutPlant, seed: int) -> None:
    """200 draws determine a deviation to 5 %, if the linearisation is good."""
    fit = armrig.oe(plant.dataset(seed, N=1500), nb=4, nf=4, integrator=True)
    t = model_characteristics(fit)
    assert t.draws is not None
    drawn = [model_characteristics(_moved(fit, theta)) for theta in t.draws.theta[:200]]

    for name in SCALARS:
        x = np.array([getattr(d, name) for d in drawn])
        scatter = np.sqrt(np.mean((x - getattr(t, name)) ** 2))
        assert t.ranges[name].method == "linearised"
        assert t.std[name] == pytest.approx(scatter, rel=0.2), name


@pytest.mark.exhaustive
def test_a_wrong_inertia_of_the_arm_is_reported_with_what_depends_on_it(
    plant: HandoutPlant,
) -> None:
    """The gain does not depend on J_2."""
    data = plant.dataset(1)
    fit = armrig.oe(data, nb=4, nf=4, integrator=True)
    wrong = physical_model(replace(HANDOUT, J_2=1.05 * HANDOUT.J_2), data)

    said = armrig.compare(plant.dataset(2), fit, wrong, labels=("OE", "physics")).explain()

    assert "anti-resonance: OE" in said
    assert "sqrt(K_lin/J_2)" in said
    assert "steady gain" not in said
    assert said.startswith("OE is closest")


@pytest.mark.exhaustive
def test_the_right_physics_differs_by_nothing(plant: HandoutPlant) -> None:
    data = plant.dataset(4)
    fit = armrig.oe(data, nb=4, nf=4, integrator=True)
    table = armrig.compare(plant.dataset(5), fit, physical_model(HANDOUT, data))

    assert "no characteristic differs" in table.explain()
    assert "a small difference" in table.explain()


def test_a_model_that_cannot_simulate_is_not_held_against_the_rig(plant: HandoutPlant) -> None:
    data = plant.dataset(1)
    models = armrig.arx(data, na=4, nb=4), physical_model(HANDOUT, data)

    said = armrig.compare(plant.dataset(2), *models, labels=("ARX", "physics")).explain()

    assert "which biases the ARX model: take OE" in said


def test_the_table_has_a_column_for_each_model(plant: HandoutPlant) -> None:
    data = plant.dataset(1)
    table = armrig.compare(
        data, armrig.arx(data, na=2, nb=2), physical_model(HANDOUT, data), labels=("mine", "theirs")
    )
    lines = table.table().splitlines()

    assert lines[0].split()[-2:] == ["mine", "theirs"]
    noted = [line for line in lines if "linearisation" in line or "summary()" in line]
    assert len(lines) - len(noted) == 1 + len(SCALARS) + 4


def test_labels_are_one_a_model(plant: HandoutPlant) -> None:
    data = plant.dataset(1)

    with pytest.raises(ValueError, match="2 labels for 1 models"):
        armrig.compare(data, physical_model(HANDOUT, data), labels=("a", "b"))


def _moved(fit: armrig.Fit, theta: np.ndarray) -> armrig.Fit:
    """Return a claim with other coefficients, b1 … b4 f1 … f4."""
    none = np.zeros((8, 8))
    B, F = np.append(0, theta[:4]), np.append(1, theta[4:])
    return replace(fit, B=B, F=F, covariance=none, covariance_robust=none)


def _any_fit() -> armrig.Fit:
    none = np.zeros((2, 2))
    return armrig.Fit(
        structure="oe",
        A=np.ones(1),
        B=np.array([0.0, 1.0]),
        F=np.array([1.0, -0.5]),
        nk=1,
        covariance=none,
        covariance_robust=none,
        noise_variance=1.0,
        loss=1.0,
        N=100,
        Ts=1.0,
        fit_percent=0.0,
        whiteness=0.5,
    )


def test_a_resonance_is_the_peak_of_the_gain_to_rounding() -> None:
    """The peak of 1/|F|² for a pair of poles r exp(±iφ) has a closed form."""
    r, phi, Ts = 0.95, 0.4, 0.01
    F = np.array([1.0, -2 * r * np.cos(phi), r**2])
    P = np.zeros((3, 3))
    fit = replace(_any_fit(), F=F, Ts=Ts, covariance=P, covariance_robust=P)
    peak = np.arccos((1 + r**2) / (2 * r) * np.cos(phi)) / Ts

    assert model_characteristics(fit).resonance == pytest.approx(peak, rel=1e-11)


@pytest.mark.parametrize("Ts", [0.002, 0.01])
def test_the_times_of_a_model_are_those_of_the_step_analysis_whatever_Ts(Ts: float) -> None:
    """A chassis with a time constant of 20 ms, by its rate, and with a dead time."""
    pole = np.exp(-Ts / 0.02)
    # theta_1's answer to a held input: the integral of a first-order rate.
    B = np.array([0.0, Ts - 0.02 * (1 - pole), 0.02 * (1 - pole) - Ts * pole])
    F = np.convolve([1.0, -1.0], [1.0, -pole])
    u = np.repeat([0.0, 1.0], 200)
    data = armrig.Dataset(u=u, y=filtered(B, F, u), Ts=Ts, output="theta_1", unit="rad")
    fit = armrig.oe(data, nb=2, nf=2, integrator=True)
    B_late = np.array([0.0, 0.0, 0.0, 1 - pole])
    late = replace(_any_fit(), B=B_late, nk=3, F=np.array([1.0, -pole]), Ts=Ts)

    of_data, of_late = armrig.step_analysis(data), model_characteristics(late)
    for t in (model_characteristics(fit), of_late):
        assert t.rise_time == pytest.approx(0.02, rel=0.01)
        assert t.equivalent_time == pytest.approx(0.02, rel=0.025)
        assert t.slowest_time == pytest.approx(0.02, rel=1e-6)
    assert of_data.tau == pytest.approx(0.02, rel=0.01)
    assert of_data.equivalent_time == pytest.approx(0.02, rel=1e-3)
