"""A model without an estimate: it answers as a fit does, and claims no uncertainty."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import armrig
import numpy as np
import pytest
from armrig.models.model import Model
from armrig.physics.physical_model import PhysicalModel, physical_model
from armrig_core.arm import ArmParameters, arm_matrices, zero_order_hold

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant


@pytest.fixture(scope="module")
def fit(plant: HandoutPlant) -> armrig.Fit:
    """Return an estimated model of the arm."""
    return armrig.oe(plant.dataset(1, N=800), nb=4, nf=4, integrator=True)


def claimed(fit: armrig.Fit) -> Model:
    """Return the same polynomials as a model."""
    return Model(A=fit.A, B=fit.B, F=fit.F, nk=fit.nk, integrator=True, Ts=fit.Ts)


def test_a_model_answers_as_the_fit_of_the_same_polynomials(fit: armrig.Fit) -> None:
    model, omega = claimed(fit), np.geomspace(0.1, 50.0, 40)
    u = np.random.default_rng(0).standard_normal(60)

    np.testing.assert_array_equal(model.poles().values, fit.poles().values)
    np.testing.assert_array_equal(model.zeros().values, fit.zeros().values)
    G = model.frequency_response(omega).G
    np.testing.assert_array_equal(G, fit.frequency_response(omega).G)
    np.testing.assert_array_equal(model.step_response(30).y, fit.step_response(30).y)
    np.testing.assert_array_equal(model.simulate(u), fit.simulate(u))
    assert model.orders == fit.orders
    assert model.names == fit.names


def test_nothing_in_a_model_is_uncertain(fit: armrig.Fit) -> None:
    model = claimed(fit)

    assert not model.trusted_covariance.any()
    assert not model.poles().std.any()
    assert not model.frequency_response([1.0, 10.0]).std_magnitude.any()
    assert not model.step_response(10).std.any()
    assert fit.poles().std.any()


def test_a_model_cannot_be_changed(fit: armrig.Fit) -> None:
    model = claimed(fit)

    with pytest.raises(AttributeError):
        model.nk = 2  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        model.B[1] = 2.0


def test_the_physics_is_no_fit_and_says_nothing_of_losses(plant: HandoutPlant) -> None:
    physics = physical_model(ArmParameters(), plant.dataset(1, N=200))

    assert isinstance(physics, PhysicalModel)
    assert not isinstance(physics, armrig.Fit)
    assert not hasattr(physics, "loss")
    assert repr(physics).startswith("physics(nb=4, nf=4, nk=1): u ")
    assert "y(t) = B(q)/F(q) u(t) + e(t)" in repr(physics)
    assert "nan" not in repr(physics)
    assert "±" not in repr(physics)


def test_models_are_compared_under_their_own_names(fit: armrig.Fit, plant: HandoutPlant) -> None:
    data = plant.dataset(2, N=400)
    physics = physical_model(ArmParameters(), data)

    table = armrig.compare(data, physics, fit)

    assert [row.name for row in table.rows] == ["physics", "OE[4 4 1]"]
    assert "OE[4 4 1] and physics: no characteristic differs" in table.explain()


def test_the_physics_predicts_by_simulation(plant: HandoutPlant) -> None:
    """The noise is white on the output, so the past of y does not predict the next sample."""
    data = plant.dataset(2, N=300)
    physics = physical_model(ArmParameters(), data)

    np.testing.assert_array_equal(physics.predict(data), physics.predict(data, horizon=1))
    assert np.nanstd(data.y - physics.predict(data)) < 0.01


def test_the_physics_of_alpha_is_that_of_the_arm() -> None:
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


def test_a_pole_that_an_ill_conditioned_covariance_hardly_moves_has_a_deviation(
    fit: armrig.Fit,
) -> None:
    """J C J' is rounded below 0 if a direction that moves no pole has a large variance."""
    poles = np.array([0.95 + 0.025j, 0.95 - 0.025j, 0.99 + 0.008j, 0.99 - 0.008j])
    F = np.poly(poles).real
    powers = poles[0] ** np.arange(3, -1, -1)
    still = np.linalg.svd(np.vstack([powers.real, powers.imag]))[2][2:]
    plain = replace(fit, F=F, structure="OE", integrator=False)
    f = plain.slice_of("f")

    for v in np.random.default_rng(3).standard_normal((20, 2)) @ still:
        covariance = np.zeros((f.stop, f.stop))
        covariance[f, f] = 1e4 * np.outer(v, v)
        with np.errstate(invalid="raise"):
            known = replace(plain, covariance=covariance, covariance_robust=covariance)
            assert np.isfinite(known.poles().std).all()
