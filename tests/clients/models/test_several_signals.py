"""Models of several signals made by hand: their channels, predictions, texts and files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig.data.finding import warning
from armrig.data.signals import Signals
from armrig.data.step import MEAN, Step, codes_of
from armrig.models.estimate import Start
from armrig.models.multivariable.comparison import SignalsComparisonTable, compare
from armrig.models.multivariable.fit import MultivariableFit
from armrig.models.multivariable.matrices import Matrices
from armrig.models.multivariable.model_file import load_fit
from armrig.models.multivariable.model_writing import model_text
from armrig.models.multivariable.polynomials import Polynomials
from armrig.models.multivariable.state_space import StateSpace, predicted
from armrig.numerics.inference import OutputQuality
from armrig.numerics.polynomial import Array, filtered
from armrig.numerics.whiteness import Whiteness
from armrig_core.errors import FileError, InputError

ONE = np.ones(1)


def vectors(*rows: Any) -> Any:
    return tuple(tuple(np.array(p, float) for p in row) for row in rows)


def apart(integrators: tuple[bool, bool] = (False, False)) -> Polynomials:
    """Return Box-Jenkins rows: three inputs, of which v does not reach b."""
    F = vectors([(1, -0.5), (1, -0.6, 0.2), (1, -0.3)], [(1, -0.8), (1,), (1, 0.1, -0.3)])
    if integrators[0]:
        F = (tuple(np.convolve([1, -1], f) for f in F[0]), F[1])
    return Polynomials(
        A=vectors([ONE, (0,)], [(0,), ONE]),
        B=vectors([(0, 1, 0.5), (0.7,), (0, 0, 0, 2)], [(0, 0, 0.3), (0,), (0, -1, 0.2)]),
        C=(np.array([1, 0.4]), ONE),
        D=(np.array([1, -0.7, 0.1]), np.array([1, 0.3])),
        F=F,
        nk=((1, 0, 3), (2, 1, 1)),
        integrators=integrators,
    )


def joined() -> Polynomials:
    """Return ARX rows whose outputs affect each other; w reaches a by b alone."""
    return Polynomials(
        A=vectors([(1, -0.8, 0.2), (0, 0.3)], [(0, -0.2, 0.1), (1, -0.5)]),
        B=vectors([(0, 1, 0.5), (0, 0, 0.7), (0, 0)], [(0, 0, 0.3), (0.4,), (0, 0, 0, 1)]),
        C=(ONE, ONE),
        D=(ONE, ONE),
        F=vectors([ONE] * 3, [ONE] * 3),
        nk=((1, 2, 2), (2, 0, 3)),
        integrators=(False, False),
    )


def matrices() -> Matrices:
    """Return three states, three inputs with delays of their own, two outputs."""
    rng = np.random.default_rng(1)
    A = np.diag([0.8, 0.5, -0.4]) + 0.1 * rng.standard_normal((3, 3))
    B, C = rng.standard_normal((3, 3)), rng.standard_normal((2, 3))
    D = np.array([[0.0, 0.3, 0.0], [0.0, -0.2, 0.0]])
    return Matrices(A=A, B=B, C=C, D=D, K=0.2 * rng.standard_normal((3, 2)), nk=(1, 0, 3))


def fit_of(form: Any, **fields: Any) -> MultivariableFit:
    """Return a model with the inputs u, v, w and the outputs a, b."""
    d = form.theta.size
    P = np.diag(np.square(0.001 * np.arange(1, d + 1)))
    values: dict[str, Any] = {
        "structure": "bj",
        "orders": "nb=2, nf=2, nk=1",
        "form": form,
        "inputs": ("u", "v", "w"),
        "outputs": ("a", "b"),
        "input_units": ("V", "A", ""),
        "units": ("rad", "m"),
        "Ts": 0.1,
        "covariance": P,
        "covariance_robust": 4 * P,
        "noise_covariance": np.array([[0.04, -0.03], [-0.03, 0.09]]),
        "quality": (
            OutputQuality(
                loss=0.05, N=90, fit_percent=80.5, white=Whiteness(p_value=0.5, test="portmanteau")
            ),
            OutputQuality(
                loss=0.1, N=95, fit_percent=-3.25, white=Whiteness(p_value=1e-4, test="Ljung-Box")
            ),
        ),
    }
    return MultivariableFit(**(values | fields))


FORMS = {"apart": apart, "joined": joined, "matrices": matrices}


@pytest.mark.parametrize("name", FORMS)
def test_each_channel_and_its_derivatives_equal_those_of_the_state_space(name: str) -> None:
    form: Any = FORMS[name]()
    z = np.exp(1j * np.array([0.2, 1.0, 2.8]))

    whole = form.realised().frequency_response(z)

    for i in range(2):
        for j in range(3):
            if not form.has(i, j):
                assert (whole[:, i, j] == 0).all()
                continue
            channel = form.channel(i, j)
            p = channel.polynomials
            ratio = np.polyval(p["B"][::-1], 1 / z)
            for below in (p["A"], p["F"]):
                ratio = ratio / np.polyval(below[::-1], 1 / z)
            np.testing.assert_allclose(whole[:, i, j], ratio, atol=1e-9)
            assert not p["B"][: channel.nk].any()
            assert abs(p["B"][channel.nk]) > 1e-6

            def free(theta: Array, i: int = i, j: int = j) -> Array:
                moved = form.replaced(theta).channel(i, j)
                q, nk = moved.polynomials, moved.nk
                parts = (q["A"][1:], q["B"][nk:], q["C"][1:], q["D"][1:], q["F"][1:])
                return np.concatenate(parts)

            J = np.empty((free(form.theta).size, form.theta.size))
            for k in range(form.theta.size):
                h = np.zeros(form.theta.size)
                h[k] = 1e-6
                J[:, k] = (free(form.theta + h) - free(form.theta - h)) / 2e-6
            np.testing.assert_allclose(channel.J, J, atol=1e-6)


def without_denominators() -> Polynomials:
    """Return the rows of `apart` without A and F: FIR with a noise model."""
    return replace(apart(), F=vectors([ONE] * 3, [ONE] * 3))


@pytest.mark.parametrize("form", [apart(), joined(), without_denominators()])
def test_the_noise_spectra_of_state_space_and_polynomials_are_equal(form: Polynomials) -> None:
    """H = 1 + C inv(q - A) K in the innovations form, and inv(A) C/D of the rows."""
    model = form.realised()
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

    system = form.realised()

    assert system.order == 3 + 2  # two more samples for w
    u = np.zeros((8, 3))
    u[0, 2] = 1.0
    y = system.simulated(u)
    assert not y[:3].any()
    np.testing.assert_allclose(y[3], form.C @ form.B[:, 2])
    np.testing.assert_allclose(y[4], form.C @ form.A @ form.B[:, 2])


def test_a_channel_has_the_signals_and_numbers_of_its_output_and_input() -> None:
    fit = fit_of(apart())
    form, P = fit.form, fit.covariance

    for i, j, channel in fit.channels():
        assert (channel.output, channel.unit) == (("a", "rad"), ("b", "m"))[i]
        assert channel.input_unit == ("V", "A", "")[j]
        assert channel.noise_variance == (0.04, 0.09)[i]
        q = fit.quality[i]
        assert (channel.loss, channel.N, channel.fit_percent) == (q.loss, q.N, q.fit_percent)
        assert channel.whiteness == q.white.p_value
        assert channel.nk == form.channel(i, j).nk
        np.testing.assert_array_equal(channel.B, form.channel(i, j).polynomials["B"])
        J = form.channel(i, j).J
        np.testing.assert_allclose(channel.covariance, J @ P @ J.T)
        np.testing.assert_allclose(channel.covariance_robust, 4 * channel.covariance)
        assert channel.structure == "bj"
    assert [(i, j) for i, j, _ in fit.channels()] == [(0, 0), (0, 1), (0, 2), (1, 0), (1, 2)]
    assert fit_of(joined())["b", "u"].structure == "channel"
    for channel, said in (
        (("b", "v"), "does not affect this output"),
        (("c", "u"), "output 'c': there is no such output; the model has a, b"),
        (("a", "x"), "input 'x': there is no such input; the model has u, v, w"),
        ("a", r"which input\?; the model has u, v, w"),
    ):
        with pytest.raises(InputError, match=said):
            fit[channel]  # type: ignore[index]


def test_the_joint_response_contains_the_response_of_each_channel() -> None:
    fit, omega = fit_of(apart()), np.array([0.5, 9.0])

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


def test_poles_of_equal_denominators_count_once() -> None:
    own = fit_of(apart()).poles().values
    same = fit_of(replace(apart(), F=vectors([(1, -0.5)] * 3, [(1, -0.5)] * 3))).poles()
    shared = replace(fit_of(apart((True, False))), shared=True).poles().values
    coupled = fit_of(joined()).poles().values

    assert np.sort(own.real) == pytest.approx(np.sort([0.5, 0.3, 0.3, 0.3, 0.8, 0.5, -0.6]))
    assert same.values == pytest.approx([0.5])
    assert same.std == pytest.approx([fit_of(apart())["a", "u"].poles().std[0]])
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
    """Only before an output is first measured is its prediction not known, except from u alone."""
    form: Any = FORMS[name]()
    system = form.realised()
    data, whole = noise_free(system)

    found = predicted(
        system, data, horizon=horizon, integrating=form.integrators, noise_std=np.ones(2)
    )

    unknown = np.cumsum(data.valid, axis=0) == 0
    assert np.isnan(found).tolist() == (unknown & (horizon is not None)).tolist()
    np.testing.assert_allclose(found[~unknown], whole[~unknown], atol=1e-4)


def test_a_prediction_ahead_leaves_the_noise_of_its_horizon() -> None:
    """x(t+1) = A x + B u + K e: e(t) + C K e(t - 1) + C A K e(t - 2) for three samples."""
    form = matrices()
    system = form.realised()
    rng = np.random.default_rng(6)
    N = 80
    u, e = rng.standard_normal((N, 3)), 0.1 * rng.standard_normal((N, 2))
    x, y = np.zeros(system.order), np.empty((N, 2))
    for t in range(N):
        y[t] = system.C @ x + system.D @ u[t] + e[t]
        x = system.A @ x + system.B @ u[t] + system.K @ e[t]
    data = Signals(u=u, y=y, Ts=0.1, inputs=["u", "v", "w"], outputs=["a", "b"])

    left = data.y - fit_of(form).predict(data, 3)

    h = [np.eye(2), system.C @ system.K, system.C @ system.A @ system.K]
    expected = sum(np.vstack([np.zeros((k, 2)), e[: N - k]]) @ m.T for k, m in enumerate(h))
    np.testing.assert_allclose(left[40:], expected[40:], atol=1e-3)


def test_the_ramp_of_an_integrating_output_is_estimated_with_the_model() -> None:
    """An offset of the inputs makes the ramp in a alone."""
    form = apart((True, False))
    rng = np.random.default_rng(7)
    u = rng.standard_normal((60, 3))
    clean = form.realised().deterministic.simulated(u)
    ramp = np.column_stack([3.0 + 0.5 * np.arange(60), np.zeros(60)])
    data = Signals(u=u, y=clean + ramp, Ts=0.1, inputs=["u", "v", "w"], outputs=["a", "b"])
    fit = fit_of(form)

    for horizon in (1, 4, None):
        np.testing.assert_allclose(fit.predict(data, horizon)[4:], data.y[4:], atol=1e-6)
    with pytest.raises(InputError, match="horizon=0 must be an integer >= 1"):
        fit.predict(data, 0)
    with pytest.raises(InputError, match=r"u has shape \(5, 2\); give \(N, 3\), .* u, v, w"):
        fit.simulate(np.zeros((5, 2)))
    np.testing.assert_allclose(fit.simulate(u), clean)
    # Each row from filters alone.
    rows = zip(form.B, form.F, strict=True)
    expected = np.column_stack(
        [sum(filtered(b, f, x) for b, f, x in zip(*row, u.T, strict=True)) for row in rows]
    )
    np.testing.assert_allclose(clean, expected, atol=1e-9)


def test_signals_with_other_names_are_refused() -> None:
    fit = fit_of(apart())
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


class Constant:
    """A model that predicts the same numbers always."""

    label = "constant"

    def __init__(self, *y: float) -> None:
        self.y = np.array(y)

    def predict(self, data: Signals, horizon: int | None = 1) -> Array:
        return np.tile(self.y, (data.u.shape[0], 1))

    def estimated_from(self, data: Signals) -> bool:
        """Return whether the first number is 0."""
        return bool(self.y[0] == 0)


def compared() -> SignalsComparisonTable:
    """Return a comparison of two models over outputs with missing samples."""
    y = np.array([[1.0, 2.0], [3.0, 4.0], [99.0, 6.0], [5.0, 99.0]])
    valid = np.array([[1, 1], [1, 1], [0, 1], [1, 0]], dtype=bool)
    data = Signals(
        u=np.zeros((4, 1)), y=y, Ts=0.5, valid=valid, outputs=["a", "long"], units=["rad", ""]
    )
    models: Any = Constant(3.0, 0.0), Constant(0.0, 4.0)
    return compare(data, *models, labels=("first", "second"), horizon=2)


def test_outputs_are_compared_at_their_measured_samples() -> None:
    """The outputs are 1, 3, 5 and 2, 4, 6."""
    first, second = compared()
    spread = np.sqrt(8.0)

    assert first.rms_error == pytest.approx((np.sqrt(8 / 3), np.sqrt(56 / 3)))
    assert first.fit_percent == pytest.approx((0.0, 100 * (1 - np.sqrt(56) / spread)))
    assert second.rms_error == pytest.approx((np.sqrt(35 / 3), np.sqrt(8 / 3)))
    assert second.fit_percent == pytest.approx((100 * (1 - np.sqrt(35) / spread), 0.0))
    assert (first.on_estimation_data, second.on_estimation_data) == (False, True)
    assert [f.about for f in compared().findings] == ["own data"]
    unbounded: Any = Constant(np.inf, 0.0)
    row = compare(compared().data, unbounded)[0]
    assert (row.fit_percent[0], row.rms_error[0]) == (-np.inf, np.inf)
    assert np.isfinite(row.rms_error[1])


def test_a_panel_for_each_output_has_the_fits_of_its_models() -> None:
    table = compared()

    panels = table.plot().axes

    texts = [[text.get_text() for text in panel.texts] for panel in panels]
    assert "fit 0.0 %, -109.2 %" in texts[0]
    assert "fit -164.6 %, 0.0 %" in texts[1]
    for i, panel in enumerate(panels):
        measured, *models = panel.lines[:3]
        shown = np.asarray(measured.get_ydata(), float)
        valid = table.data.valid[:, i]
        np.testing.assert_array_equal(shown[valid], table.data.y[valid, i])
        for line, row in zip(models, table.rows, strict=True):
            np.testing.assert_array_equal(line.get_ydata(), row.y[:, i])
    assert "rad" in panels[0].get_ylabel()
    assert panels[1].get_xlim() == (0.0, 1.5)


@pytest.mark.parametrize("name", FORMS)
def test_a_file_keeps_each_field_of_each_form(name: str, tmp_path: Path) -> None:
    fit = fit_of(
        FORMS[name](),
        shared=True,
        output_weights=(1.5, 2.5),
        converged=False,
        starts=(Start(name="x", loss=float("inf"), iterations=3, converged=False),),
        findings=(warning("overlap", "text", "order", start=1.5, stop=float("inf")),),
        source="ab12",
        history=(Step("removed the mean", MEAN),),
        digest="cd34",
    )
    fit.save(tmp_path / "m.json")

    loaded = load_fit(tmp_path / "m.json")

    assert isinstance(loaded, MultivariableFit)
    assert repr(loaded) == repr(fit)
    assert model_text(loaded) == model_text(fit)
    for field in ("findings", "starts", "output_weights", "shared", "converged", "digest"):
        assert getattr(loaded, field) == getattr(fit, field)
    assert codes_of(loaded.history) == [MEAN]
    np.testing.assert_array_equal(loaded.theta, fit.theta)
    np.testing.assert_array_equal(loaded.covariance_robust, fit.covariance_robust)
    assert [(q.loss, q.N, q.white) for q in loaded.quality] == [
        (q.loss, q.N, q.white) for q in fit.quality
    ]
    assert loaded.form.integrators == fit.form.integrators


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"version": 2, "armrig": "9.9"}, "format version 2, this armrig reads 1.* armrig 9.9"),
        ({"covariance": [[1.0]]}, "damaged model: .* parameters, and covariances of another size"),
        ({"covariance_robust": [[1.0]]}, "damaged model: .* covariances of another size"),
        ({"quality": []}, "is a damaged model"),
        ({"form": {"kind": "matrices"}}, "is a damaged model"),
        ({"format": "x"}, "is a model of several signals|is no model file"),
    ],
)
def test_a_file_of_another_kind_of_model_is_refused(
    change: dict[str, Any], said: str, tmp_path: Path
) -> None:
    path = tmp_path / "m.json"
    path.write_text(json.dumps(json.loads(model_text(fit_of(apart()))) | change))

    with pytest.raises(FileError, match=f"m.json .*{said}"):
        load_fit(path)
