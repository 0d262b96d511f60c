"""Standard deviations are known before the experiment."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.estimation.polynomial_structures import armax, bj, oe
from armrig.excitation import step, telegraph
from armrig.excitation.experiment_design import predicted_std
from armrig.excitation.physical_experiment_design import predicted_parameter_std
from armrig.models.fit import Fit
from armrig.numerics.polynomial import apply_filter
from armrig.physics.systems import ArmParameters, arm, chassis
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.sampling import sampled

B, A = np.array([0, 1, 0.5]), np.array([1, -1.2, 0.6])
RUNS, N = 200, 400


def planned(noise_variance: float = 1.0, Ts: float = 1.0, **polynomials: Any) -> Fit:
    """Return a model with one delay and a known variance of e."""
    return Fit.of_channel(noise_covariance=[[noise_variance]], Ts=Ts, nk=1, **polynomials)


def test_a_fit_predicts_its_std_for_its_estimation_data(plant: Any) -> None:
    """The arm with its integrator, gaps and two experiments: the same covariance, to 1 %."""
    first, second = plant.dataset(0, N=1500), plant.dataset(1, N=1500)
    holed = first.replaced(valid=np.arange(1500) % 70 > 3, step=None)
    data = merge([holed, second])
    fit = oe(data, nb=4, nf=4, integrator=True, starts="few")

    predicted = predicted_std(fit, data)

    np.testing.assert_allclose(predicted.std, fit.std, rtol=0.01)
    np.testing.assert_allclose(predicted.theta, fit.theta)
    assert data.N - data.missing == predicted.N


@pytest.mark.parametrize(
    "structure", sampled(["armax", "integrating bj", "integrating armax", "bj"], 2)
)
def test_models_with_a_noise_model_predict_their_std(structure: str) -> None:
    """On 4000 samples, within 10 %, because the noise of the data is one draw."""
    rng = np.random.default_rng(5)
    u, e = telegraph(4000, 0.3, seed=rng), 0.3 * rng.standard_normal(4000)
    C, D = [1, 0.5], [1, -0.7]
    integrated = np.cumsum if "integrating" in structure else np.array
    if "armax" in structure:
        y = integrated(apply_filter(B, A, u) + apply_filter(C, A, e))
        data = Dataset(u=u, y=y, Ts=1)
        na = 3 if "integrating" in structure else 2
        fit = armax(data, na=na, nb=2, nc=1, integrator=na == 3, starts="few")
    else:
        y = integrated(apply_filter(B, A, u)) + apply_filter(C, D, e)
        data = Dataset(u=u, y=y, Ts=1)
        nf = 3 if "integrating" in structure else 2
        fit = bj(data, nb=2, nc=1, nd=1, nf=nf, integrator=nf == 3, starts="few")

    predicted = predicted_std(fit, u)

    assert predicted.names == fit.names
    np.testing.assert_allclose(predicted.std, fit.std, rtol=0.1)


def test_the_plan_for_coloured_noise_agrees_with_theory() -> None:
    """ARMA(1, 1) noise has its asymptotic variance in closed form.

    For A = 1 + a/q, C = 1 + c/q: cov N = [[1/(1-a²), -1/(1-ac)], [-1/(1-ac), 1/(1-c²)]]^-1.
    """
    a, c, n = -0.7, 0.4, 20_000
    u = 1e-6 * telegraph(n, 0.3)  # teaches nothing of a
    model = planned(A=[1, a], B=[0, 1.0], C=[1, c], noise_variance=4.0, Ts=1.0)

    predicted = predicted_std(model, u)

    M = np.array([[1 / (1 - a**2), -1 / (1 - a * c)], [-1 / (1 - a * c), 1 / (1 - c**2)]])
    kept = [predicted.names.index(name) for name in ("a1", "c1")]
    np.testing.assert_allclose(
        n * predicted.covariance[np.ix_(kept, kept)], np.linalg.inv(M), rtol=0.01
    )


def test_a_coloured_noise_model_weighs_the_frequencies() -> None:
    """BJ: b's std is that of least squares on u and y through D, and d's that of an AR(1)."""
    u, D = telegraph(2000, 0.3), np.array([1, -0.8])
    coloured = planned(B=[0, 1.0], D=D, noise_variance=1.0, Ts=1.0)

    predicted = predicted_std(coloured, u)

    regressor = apply_filter(D, [1], np.concatenate([[0], u[:-1]]))
    first = apply_filter(D, [1], np.eye(2000)[0])  # the unknown past
    residual = regressor - first * (first @ regressor) / (first @ first)
    assert predicted.std[0] == pytest.approx(1 / np.linalg.norm(residual), rel=1e-6)
    assert predicted.std[1] == pytest.approx(np.sqrt((1 - 0.8**2) / 2000), rel=0.01)


@settings(max_examples=20)
@given(st.floats(0.1, 10), st.floats(0.1, 1.0))
def test_deviations_are_proportional_to_noise_and_inverse_to_input(
    noise: float, gain: float
) -> None:
    """The standard deviation is proportional to noise and inverse to the input's size."""
    u = telegraph(300, 0.3, 0.0, 5.0)
    one, other = (
        predicted_std(planned(B=B, F=A, noise_variance=v, Ts=1.0), x).std
        for v, x in ((1.0, u), (noise**2, gain * u))
    )

    np.testing.assert_allclose(other, one * noise / gain, rtol=1e-6)


def test_the_text_of_a_plan_states_whether_the_experiment_is_long_enough() -> None:
    u = telegraph(3000, 0.3)
    predicted = predicted_std(planned(B=B, F=A, noise_variance=0.1, Ts=0.01), u)
    got = float(predicted.std[2])

    assert predicted.seconds_for(f1=got / 2) == pytest.approx(4 * 30)
    assert "30 s is too short, about 120 s are needed" in predicted.explain(f1=got / 2)
    assert "30 s is long enough, about 7.5 s are needed" in predicted.explain(f1=2 * got)
    both = predicted.explain(f1=2 * got, b1=float(predicted.std[0]) / 3)
    assert both.splitlines()[-1] == "together: 30 s is too short, about 270 s are needed"
    with pytest.raises(ValueError, match="'g1' is not among the parameters b1, b2, f1, f2"):
        predicted.explain(g1=1.0)
    with pytest.raises(ValueError, match="f1=0: a wanted standard deviation must be > 0"):
        predicted.explain(f1=0)
    longer = predicted_std(planned(B=B, F=A, noise_variance=0.1, Ts=0.01), telegraph(12_000, 0.3))
    assert longer.std[2] == pytest.approx(got / 2, rel=0.1)


def test_the_inertia_s_standard_deviation_is_predicted_from_physics() -> None:
    """As from least squares linearised at the truth, with every nuisance parameter by hand."""
    p, Ts, std = ArmParameters(), 0.01, 5e-3
    u = telegraph(1000, 0.05)
    t = Ts * np.arange(1000)

    predicted = predicted_parameter_std(chassis, u, Ts=Ts, noise_variance=std**2)

    def angle(J_1: float, u: Any) -> Any:
        # theta_1'' = (k u - d theta_1')/J_1, held u: velocity and angle in closed form.
        tau, gain = J_1 / p.damping, p.torque_per_volt / p.damping
        w = apply_filter([0, gain * (1 - np.exp(-Ts / tau))], [1, -np.exp(-Ts / tau)], u)
        moved = gain * u * Ts + (w - gain * u) * tau * (1 - np.exp(-Ts / tau))
        return np.concatenate([[0], np.cumsum(moved)[:-1]])

    h = 1e-4 * p.J_1
    slope = (angle(p.J_1 + h, u) - angle(p.J_1 - h, u)) / (2 * h)
    pole = np.exp(-t * p.damping / p.J_1)
    Z = np.linalg.qr(np.column_stack([np.ones(1000), pole, angle(p.J_1, np.ones(1000))]))[0]
    slope = slope - Z @ (Z.T @ slope)
    assert predicted.std[0] == pytest.approx(std / np.linalg.norm(slope), rel=1e-5)
    assert predicted.names == ("J_1",)


def test_an_input_with_too_little_information_is_refused() -> None:
    """A step at the first sample excites nothing if the initial state is unknown."""
    model, u = planned(B=B, F=A, noise_variance=1.0, Ts=1.0), telegraph(300, 0.1)

    with pytest.raises(ValueError, match=r"determines only \d of 4 parameters"):
        predicted_std(model, step(300))
    with pytest.raises(ValueError, match=r"determines only \d of 4 parameters"):
        # If torque and back-EMF are known by their ratio alone, N and K_m cannot be separated.
        predicted_parameter_std(
            chassis, u, Ts=0.01, noise_variance=1e-6, free=("J_1", "N", "K_m", "R_m")
        )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"F": [1.0, -1.0]}, "F has a root on or outside"),
        ({"C": [1.0, 2.0]}, "C has a root on or outside"),
        ({"B": [0.0, 0.0]}, r"determines only \d of 3 parameters"),
    ],
)
def test_an_impossible_planned_model_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        predicted_std(planned(**({"B": B, "F": A} | change)), telegraph(300, 0.3))


def test_impossible_arguments_of_a_plan_are_refused() -> None:
    u = telegraph(300, 0.3)
    model = planned(B=B, A=A, noise_variance=1.0, Ts=1.0)
    gaps = Dataset(u=u, y=u, Ts=1.0, valid=np.arange(300) > 3)

    with pytest.raises(ValueError, match=r"4 samples are missing.*only an output-error model"):
        predicted_std(model, gaps)
    with pytest.raises(ValueError, match="noise_variance=nan must be > 0"):
        predicted_std(model, u, noise_variance=float("nan"))
    with pytest.raises(ValueError, match="Ts=1 s and the data have Ts=2 s"):
        predicted_std(model, Dataset(u=u, y=u, Ts=2.0))
    for free in (("b_1",), ()):
        with pytest.raises(ValueError, match="must name parameters that are > 0"):
            predicted_parameter_std(arm, u, Ts=0.01, noise_variance=1e-6, free=free)
    with pytest.raises(ValueError, match="output='beta' is none of the model's outputs"):
        predicted_parameter_std(arm, u, Ts=0.01, noise_variance=1e-6, output="beta")


def test_a_gap_at_the_end_informs_like_a_shorter_experiment() -> None:
    """For a physical model and a black box; the planned length still contains the gap."""
    u = telegraph(300, 0.1)
    y, there = np.where(np.arange(300) < 180, 0.0, np.nan), np.arange(300) < 180
    gap = Dataset(u=u, y=y, valid=there, Ts=0.01)
    model = planned(B=B, F=A, noise_variance=1.0, Ts=0.01)

    for predict in (
        lambda x: predicted_std(model, x),
        lambda x: predicted_parameter_std(
            arm, x, Ts=0.01, noise_variance=1e-4, free=("J_1", "K_lin")
        ),
    ):
        found, short, long = (predict(x) for x in (gap, u[:180], u))
        np.testing.assert_allclose(found.std, short.std, rtol=1e-6)
        assert (long.std < short.std).all()
        assert (found.N, short.N) == (180, 180)
        assert (found.seconds, short.seconds) == pytest.approx((3.0, 1.8))


def test_each_experiment_adds_its_information() -> None:
    """Two equal experiments from rest halve every variance; each has its own initial state."""
    u = telegraph(200, 0.1)
    once = Dataset(u=u, y=np.zeros(200), Ts=0.01)
    model = planned(B=B, A=A, C=[1, 0.4], noise_variance=1.0, Ts=0.01)

    for predict in (
        lambda x: predicted_std(model, x),
        lambda x: predicted_parameter_std(chassis, x, Ts=0.01, noise_variance=1e-4),
    ):
        one, two = (predict(x).covariance for x in (once, merge([once, once])))
        np.testing.assert_allclose(two, one / 2, rtol=1e-9)
