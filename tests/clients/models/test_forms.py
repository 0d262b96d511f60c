"""Polynomials and state spaces of any number of signals: channels, predictions and texts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Signals
from armrig.data.finding import warning
from armrig.models.estimate import Minimisation
from armrig.models.polynomials import Polynomials
from armrig.models.state_space import StateSpace
from armrig.numerics.polynomial import Array, apply_filter
from armrig_core.errors import InputError

from tests.clients.models.made_fits import (
    FORMS,
    MORE,
    OF_ONE_OUTPUT,
    ONE,
    apart,
    fit_of_form,
    joined,
    made,
    matrices,
    of_one_output,
    vectors,
    with_all_polynomials,
)


@pytest.mark.parametrize("name", MORE | OF_ONE_OUTPUT)
def test_each_channel_and_its_derivatives_equal_those_of_the_state_space(name: str) -> None:
    form: Any = (MORE | OF_ONE_OUTPUT)[name]()
    z = np.exp(1j * np.array([0.2, 1.0, 2.8]))
    model = form.innovations_form()

    inverse = np.linalg.inv(z[:, None, None] * np.eye(model.order) - model.A)
    whole = model.C @ inverse @ model.B + model.D

    for i in range(whole.shape[1]):
        for j in range(whole.shape[2]):
            if not form.has(i, j):
                assert (whole[:, i, j] == 0).all()
                continue
            channel, known = form.channel(i, j)
            ((A,),), ((B,),), ((F,),), ((nk,),) = channel.A, channel.B, channel.F, channel.nk
            ratio = np.polyval(B[::-1], 1 / z)
            for below in (A, F):
                ratio = ratio / np.polyval(below[::-1], 1 / z)
            np.testing.assert_allclose(whole[:, i, j], ratio, atol=1e-9)
            assert not B[:nk].any()
            assert abs(B[nk]) > 1e-6
            if name in OF_ONE_OUTPUT:
                below = z[:, None, None] * np.eye(model.order) - model.A
                H = 1 + (model.C @ np.linalg.solve(below, model.K))[:, 0, 0]
                noise = np.polyval(channel.C[0][::-1], 1 / z) / np.polyval(A[::-1], 1 / z)
                np.testing.assert_allclose(noise, H, atol=1e-9)

            def free(theta: Array, i: int = i, j: int = j) -> Array:
                return form.replaced(theta).channel(i, j)[0].theta

            J = np.empty((free(form.theta).size, form.theta.size))
            for k in range(form.theta.size - (form.K.size if name == "without K" else 0)):
                h = np.zeros(form.theta.size)
                h[k] = 1e-6
                J[:, k] = (free(form.theta + h) - free(form.theta - h)) / 2e-6
            if name == "without K":
                J[:, -form.K.size :] = 0.0  # a K that is not 0 makes a model with C
            np.testing.assert_allclose(known, J, atol=1e-6)


@pytest.mark.parametrize("nk", range(4))
def test_an_armax_model_has_the_observer_form(nk: int) -> None:
    """N4SID gives such models; the transfer function is that of the polynomials."""
    form = OF_ONE_OUTPUT[f"ARMAX, nk {nk}"]()
    fit = made(structure="n4sid", A=form.A[0][0], B=form.B[0][0], C=form.C[0], nk=nk)

    A, *_ = fit.state_space()

    assert A.shape == (max(nk, 2),) * 2
    for z in np.exp(1j * np.array([0.1, 0.9, 2.5])):
        G = np.polyval(fit.B[::-1], 1 / z) / np.polyval(fit.A[::-1], 1 / z)
        assert fit.to_control()(z) == pytest.approx(G)


def test_a_state_space_of_one_channel_becomes_polynomials_with_its_responses() -> None:
    form = of_one_output(1)
    d = form.theta.size
    P = np.diag(np.square(0.001 * np.arange(1, d + 1)))
    of: dict[str, Any] = {"inputs": ("u",), "outputs": ("y",), "input_units": ("V",)}
    of |= {"units": ("rad",), "structure": "ss", "specification": "order=2, nk=1"}
    quality = fit_of_form(apart()).quality[:1]

    fit = fit_of_form(
        form, **of, covariance=P, covariance_robust=4 * P,
        noise_covariance=np.eye(1), quality=quality,
    )  # fmt: skip

    assert (fit.heading, fit.label) == ("SS(order=2, nk=1)", "SS[2 1]")
    assert fit.names == ("a1", "a2", "b1", "b2", "c1", "c2")
    _, J = form.channel(0, 0)
    np.testing.assert_allclose(fit.covariance, J @ P @ J.T)
    np.testing.assert_allclose(fit.covariance_robust, 4 * fit.covariance)
    np.testing.assert_allclose(np.sort(fit.poles().values), np.sort(np.linalg.eigvals(form.A)))
    u = np.random.default_rng(0).standard_normal(50)
    np.testing.assert_allclose(fit.simulate(u), form.innovations_form().simulated(u[:, None])[:, 0])


def without_denominators() -> Polynomials:
    """Return the rows of `apart` without A and F: FIR with a noise model."""
    return replace(apart(), F=vectors([ONE] * 3, [ONE] * 3))


@pytest.mark.parametrize(
    "form", [apart(), joined(), without_denominators(), with_all_polynomials()]
)
def test_the_noise_spectra_of_state_space_and_polynomials_are_equal(form: Polynomials) -> None:
    """H = 1 + C inv(q - A) K in the innovations form, and inv(A) C/D of the rows."""
    model = form.innovations_form()
    for z in np.exp(1j * np.array([0.2, 1.0, 2.8])):
        below = z * np.eye(len(model.A)) - model.A
        H = np.eye(2) + model.C @ np.linalg.solve(below, model.K)

        A = np.array([[np.polyval(a[::-1], 1 / z) for a in row] for row in form.A])
        ratio = [
            np.polyval(c[::-1], 1 / z) / np.polyval(d[::-1], 1 / z)
            for c, d in zip(form.C, form.D, strict=True)
        ]
        np.testing.assert_allclose(H, np.linalg.solve(A, np.diag(ratio)), atol=1e-9)


@pytest.mark.parametrize("name", FORMS)
def test_each_coefficient_of_theta_is_replaced_at_its_position(name: str) -> None:
    form: Any = FORMS[name]()
    theta = np.arange(1.0, form.theta.size + 1)

    moved = form.replaced(theta)

    np.testing.assert_array_equal(moved.theta, theta)
    assert moved.nk == form.nk
    assert len(form.names) == theta.size
    assert len(set(form.names)) == theta.size
    if name == "matrices":
        return
    for (letter, i, k, lag), value in zip(form.names, theta, strict=True):
        p = getattr(moved, letter.upper())[i]
        p = p if letter in "cd" else p[k]
        assert p[lag] == value
        at = form.slice_of(letter, i, k)
        assert value in theta[at]
    assert [row[i][0] for i, row in enumerate(moved.A)] == [1.0, 1.0]
    with pytest.raises(InputError, match=r"no polynomial x\[0, 0\]"):
        form.slice_of("x", 0, 0)


def test_the_delays_of_a_state_space_are_chains_of_states() -> None:
    form = matrices()

    system = form.innovations_form()

    assert system.order == 3 + 2  # two more samples for w
    u = np.zeros((8, 3))
    u[0, 2] = 1.0
    y = system.simulated(u)
    assert not y[:3].any()
    np.testing.assert_allclose(y[3], form.C @ form.B[:, 2])
    np.testing.assert_allclose(y[4], form.C @ form.A @ form.B[:, 2])


def test_a_channel_has_the_signals_and_numbers_of_its_output_and_input() -> None:
    fit = fit_of_form(apart())
    form, P = fit.form, fit.covariance

    for i, j, channel in fit.channels():
        assert (channel.output, channel.unit) == (("a", "rad"), ("b", "m"))[i]
        assert channel.input_unit == ("V", "A", "")[j]
        assert channel.noise_variance == (0.04, 0.09)[i]
        q = fit.quality[i]
        assert (channel.loss, channel.N, channel.fit_percent) == (q.loss, q.N, q.fit_percent)
        assert channel.whiteness == q.white.p_value
        of_channel, J = form.channel(i, j)
        assert channel.nk == of_channel.nk[0][0]
        np.testing.assert_array_equal(channel.B, of_channel.B[0][0])
        np.testing.assert_allclose(channel.covariance, J @ P @ J.T)
        np.testing.assert_allclose(channel.covariance_robust, 4 * channel.covariance)
        assert channel.structure == "bj"
    assert [(i, j) for i, j, _ in fit.channels()] == [(0, 0), (0, 1), (0, 2), (1, 0), (1, 2)]
    assert fit_of_form(joined())["b", "u"].structure == "channel"
    integrating = fit_of_form(apart((True, False)))
    assert [integrating[name, "u"].offset for name in "ab"] == [True, False]
    for channel, said in (
        (("b", "v"), "does not affect this output"),
        (("c", "u"), "output='c': there is no such output; there are a, b"),
        (("a", "x"), "input='x': there is no such input; there are u, v, w"),
        ("a", r"which input\?; there are u, v, w"),
    ):
        with pytest.raises(InputError, match=said):
            fit[channel]  # type: ignore[index]


def test_the_joint_response_contains_the_response_of_each_channel() -> None:
    fit, omega = fit_of_form(apart()), np.array([0.5, 9.0])

    G, step = fit.frequency_response(omega), fit.step_response(7)
    rate = fit.step_response(6, rate=True)

    for i, j, channel in fit.channels():
        own, alone = channel.frequency_response(omega), channel.step_response(7)
        np.testing.assert_array_equal(G.G[:, i, j], own.G)
        np.testing.assert_array_equal(G.std_magnitude[:, i, j], own.std_magnitude)
        np.testing.assert_array_equal(G.std_phase[:, i, j], own.std_phase)
        np.testing.assert_array_equal(step.y[:, i, j], alone.y)
        np.testing.assert_array_equal(step.std[:, i, j], alone.std)
        np.testing.assert_allclose(rate.y[:, i, j], np.diff(alone.y) / 0.1, atol=1e-12)
        np.testing.assert_allclose(rate.t, channel.step_response(6, rate=True).t)
    np.testing.assert_allclose(step.t, 0.1 * np.arange(7))
    assert (step.rate, rate.rate) == (False, True)
    assert not G.G[:, 1, 1].any()
    assert (fit.ny, fit.nu) == (2, 3)
    assert fit.std_robust == pytest.approx(2 * fit.std)


def test_the_text_of_several_signals_has_a_line_for_each_output_and_the_poles() -> None:
    fit = fit_of_form(
        apart(), findings=(warning("x", "doubtful"),), search=Minimisation(converged=False)
    )

    first, a, b, noise, poles, doubt = repr(fit).splitlines()

    assert first == "BJ(nb=2, nf=2, nk=1): u [V], v [A], w to 2 outputs, Ts 0.1 s, 18 parameters"
    assert a == (
        "  a [rad]  fit  80.50 % one step ahead, loss 0.05, N 90, residuals white (p = 0.500, "
        "portmanteau)"
    )
    assert b.startswith(
        "  b [m]    fit  -3.25 % one step ahead, loss 0.1, N 95, residuals coloured"
    )
    assert noise == "  correlation of the noise: a and b -0.50"
    assert poles.startswith("  poles: 0.5000 (std ")
    assert "0.3000 ± 0.3317i (std " in poles
    assert doubt == "  warning: doubtful"


def test_poles_of_equal_denominators_count_once() -> None:
    own = fit_of_form(apart()).poles().values
    same = fit_of_form(replace(apart(), F=vectors([(1, -0.5)] * 3, [(1, -0.5)] * 3))).poles()
    shared = replace(fit_of_form(apart((True, False))), shared=True).poles().values
    coupled = fit_of_form(joined()).poles().values

    assert np.sort(own.real) == pytest.approx(np.sort([0.5, 0.3, 0.3, 0.3, 0.8, 0.5, -0.6]))
    assert same.values == pytest.approx([0.5])
    assert same.std == pytest.approx([fit_of_form(apart())["a", "u"].poles().std[0]])
    assert shared[0] == 1.0
    (a, ab), (ba, b) = joined().A
    determinant = np.pad(np.convolve(a, b), (0, 1)) - np.pad(np.convolve(ab, ba), (0, 1))
    found = coupled[np.abs(coupled) > 1e-6]
    np.testing.assert_allclose(np.poly(found), determinant[:4], atol=1e-9)


def noise_free(system: StateSpace, N: int = 60) -> tuple[Signals, Array]:
    """Return outputs from another initial state, a third of them missing, a from sample 4 on."""
    rng = np.random.default_rng(5)
    u = rng.standard_normal((N, system.B.shape[1]))
    x, y = rng.standard_normal(system.order), np.empty((N, 2))
    if system.noise_states:
        x[-system.noise_states :] = 0.0
    for t in range(N):
        y[t] = system.C @ x + system.D @ u[t]
        x = system.A @ x + system.B @ u[t]
    valid = rng.random(y.shape) > 0.3
    valid[:4, 0], valid[4, 0] = False, True
    names: dict[str, Any] = {"inputs": ["u", "v", "w"], "outputs": ["a", "b"]}
    return Signals(u=u, y=np.where(valid, y, 50.0), Ts=0.1, valid=valid, **names), y


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("horizon", [1, 3, None])
def test_without_noise_a_prediction_is_exact_over_missing_samples(
    name: str, horizon: int | None
) -> None:
    """A prediction is not known before an output is first measured, except from u alone.

    An ARX model, which has a finite memory, also predicts no sample that sets its first state.
    """
    form: Any = FORMS[name]()
    system = form.innovations_form()
    data, whole = noise_free(system)

    found = fit_of_form(form).predict(data, horizon)

    unknown = np.cumsum(data.valid, axis=0) == 0
    begun = 10 if name == "joined" else 0
    lost = np.isnan(found)
    assert lost[begun:].tolist() == (unknown & (horizon is not None)).tolist()[begun:]
    assert lost[:begun].any() == bool(begun and horizon)
    known = ~(lost | unknown)
    np.testing.assert_allclose(found[known], whole[known], atol=1e-4)


def test_a_prediction_ahead_leaves_the_noise_of_its_horizon() -> None:
    """x(t+1) = A x + B u + K e: e(t) + C K e(t - 1) + C A K e(t - 2) for three samples."""
    form = matrices()
    system = form.innovations_form()
    rng = np.random.default_rng(6)
    N = 80
    u, e = rng.standard_normal((N, 3)), 0.1 * rng.standard_normal((N, 2))
    x, y = np.zeros(system.order), np.empty((N, 2))
    for t in range(N):
        y[t] = system.C @ x + system.D @ u[t] + e[t]
        x = system.A @ x + system.B @ u[t] + system.K @ e[t]
    data = Signals(u=u, y=y, Ts=0.1, inputs=["u", "v", "w"], outputs=["a", "b"])

    left = data.y - fit_of_form(form).predict(data, 3)

    h = [np.eye(2), system.C @ system.K, system.C @ system.A @ system.K]
    expected = sum(np.vstack([np.zeros((k, 2)), e[: N - k]]) @ m.T for k, m in enumerate(h))
    np.testing.assert_allclose(left[40:], expected[40:], atol=1e-3)


@pytest.mark.parametrize(("level", "offset"), [(0.0, False), (7.0, True)])
def test_the_ramp_of_an_integrating_output_and_a_level_are_estimated_with_the_model(
    level: float, offset: bool
) -> None:
    """An offset of the inputs makes the ramp in a, and a level in b if the model has an offset."""
    form = apart((True, False))
    u = np.random.default_rng(7).standard_normal((60, 3))
    clean = form.innovations_form().deterministic.simulated(u)
    trend = np.column_stack([3.0 + 0.5 * np.arange(60), np.full(60, level)])
    data = Signals(u=u, y=clean + trend, Ts=0.1, inputs=["u", "v", "w"], outputs=["a", "b"])
    fit = fit_of_form(form, offset=offset)

    for horizon in (1, 4, None):
        np.testing.assert_allclose(fit.predict(data, horizon)[4:], data.y[4:], atol=1e-6)
    without = fit_of_form(form).predict(data, None)
    assert (np.abs(without - data.y).max() > 0.1) == offset
    with pytest.raises(InputError, match="horizon=0 must be an integer >= 1"):
        fit.predict(data, 0)
    with pytest.raises(InputError, match=r"u has shape \(5, 2\); give \(N, 3\), .* u, v, w"):
        fit.simulate(np.zeros((5, 2)))
    np.testing.assert_allclose(fit.simulate(u), clean)
    # Each row from filters alone.
    rows = zip(form.B, form.F, strict=True)
    expected = np.column_stack(
        [sum(apply_filter(b, f, x) for b, f, x in zip(*row, u.T, strict=True)) for row in rows]
    )
    np.testing.assert_allclose(clean, expected, atol=1e-9)


def test_signals_with_other_names_are_refused() -> None:
    fit = fit_of_form(apart())
    u, y = np.zeros((5, 3)), np.zeros((5, 2))
    names: dict[str, Any] = {"inputs": ["u", "v", "w"], "outputs": ["a", "b"]}

    for changed, said in (
        ({"Ts": 0.2}, r"the model has Ts=0.1 s and the data have Ts=0.2 s"),
        ({"outputs": ["b", "a"]}, "the model's outputs are a, b and the data have b, a"),
        ({"inputs": ["u", "w", "v"]}, "the model's inputs are u, v, w and the data have u, w, v"),
    ):
        with pytest.raises(InputError, match=said):
            fit.predict(Signals(u=u, y=y, **({"Ts": 0.1} | names | changed)))
    with pytest.raises(TypeError, match="data is a list: give Signals with a, b and u, v, w"):
        fit.predict([1.0])  # type: ignore[arg-type]
