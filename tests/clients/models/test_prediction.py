"""Predictions and simulations against sums and conditional means that are written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armrig.data.dataset import Dataset, Signals
from armrig.data.merging import merge
from armrig.models.fit import Fit
from armrig.models.prediction import structure_of
from armrig.models.predictor import prediction_errors
from armrig.numerics.polynomial import Array, apply_filter
from armrig_core.errors import InputError
from numpy.typing import NDArray

from tests.clients.models.made_fits import apart, fit_of_form, made


def conditional_means(fit: Fit, data: Dataset) -> Array:
    """Return E[y(t) | y known before t] by Gaussian conditioning, from the first na samples on.

    With L e = y - m, from na known samples on, the y have the covariance L L^T.
    """
    na, N = fit.A.size - 1, data.N
    driven = apply_filter(fit.B, [1.0], data.u)
    responses = np.zeros((N, N))
    for k in range(na, N):
        e = np.zeros(N)
        e[k] = 1.0
        responses[:, k] = apply_filter([1.0], fit.A, e)
    mean = np.where(np.arange(N) < na, data.y, 0.0)
    for t in range(na, N):
        mean[t] = driven[t] - sum(fit.A[j] * mean[t - j] for j in range(1, na + 1))
    P = responses @ responses.T
    found = np.full(N, np.nan)
    for t in range(na, N):
        known = [s for s in range(na, t) if data.valid[s]]
        gain = np.linalg.solve(P[np.ix_(known, known)], P[known, t]) if known else np.zeros(0)
        found[t] = mean[t] + gain @ (data.y[known] - mean[known])
    return found


@pytest.mark.parametrize("na", [1, 2, 3])
def test_an_arx_model_predicts_the_conditional_mean_over_gaps(na: int) -> None:
    """Two gaps with measured samples between them, fewer and more than na."""
    A = np.real(np.poly([0.9, 0.7 + 0.3j, 0.7 - 0.3j][3 - na :] if na != 2 else [0.9, -0.5]))
    fit = made(A=A.tolist(), B=(0, 0.5, -0.2), structure="arx", output="y", unit="")
    for seed, missing in enumerate([(8, 9, 14), (7, 10, 11, 12, 20), (9, 11, 13)]):
        u, e = np.random.default_rng(seed).standard_normal((2, 26))
        valid = np.ones(26, dtype=bool)
        valid[list(missing)] = False
        data = Dataset(u=u, y=apply_filter(fit.B, fit.A, u) + apply_filter([1.0], fit.A, e), Ts=0.1)

        found = fit.predict(data.replaced(valid=valid, step=None))

        expected = conditional_means(fit, data.replaced(valid=valid, step=None))
        begin = max(na, 2)
        np.testing.assert_allclose(found[begin:], expected[begin:], atol=1e-9)
        assert np.isnan(found[:begin]).all()


@pytest.mark.parametrize("horizon", [1, 3, 9])
def test_the_prediction_errors_of_a_noise_model_are_its_innovations(horizon: int) -> None:
    """The error is the sum of h(j) e(t - j), j < horizon; h is the response of C/(A D)."""
    fit = made(
        A=(1, -0.4), B=(0, 0, 0.5), C=(1, 0.5), D=(1, -0.7), F=(1, -0.6), nk=2, output="y", unit=""
    )
    u, e = np.random.default_rng(1).standard_normal((2, 120))
    y = apply_filter(fit.B, fit.denominator, u) + apply_filter(fit.C, np.convolve(fit.A, fit.D), e)

    left = y - fit.predict(Dataset(u=u, y=y, Ts=0.1), horizon)

    h = apply_filter(fit.C, np.convolve(fit.A, fit.D), np.eye(1, 120)[0])[:horizon]
    expected = apply_filter(h, [1.0], e)
    np.testing.assert_allclose(left[80:], expected[80:], atol=1e-4)


@pytest.mark.parametrize(("offset", "integrator"), [(True, False), (False, False), (False, True)])
def test_an_input_offset_is_estimated_if_the_model_has_one(offset: bool, integrator: bool) -> None:
    """Two experiments with offsets of their own and some missing samples."""
    F = np.convolve([1, -1], [1, -0.6]) if integrator else np.array([1, -1.2, 0.5])
    fit = made(
        B=(0, 0.5, 0.2), F=F.tolist(), offset=offset, integrator=integrator, output="y", unit=""
    )
    rng = np.random.default_rng(2)
    parts = []
    for level in (3.0, -1.0):
        u = rng.standard_normal(80)
        valid = rng.random(80) > 0.1
        y = apply_filter(fit.B, fit.denominator, u - level * (offset or integrator))
        parts.append(Dataset(u=u, y=np.where(valid, y, 99.0), Ts=0.1, valid=valid))
    data = merge(parts)

    for horizon in (None, 1):
        error = (data.y - fit.predict(data, horizon))[data.valid]
        np.testing.assert_allclose(error, 0, atol=1e-8)
    if not integrator:
        other = replace(fit, offset=not offset)
        off = np.abs((data.y - other.predict(data, None))[data.valid]).max()
        assert (off > 0.1) == offset


def test_a_mismatch_of_signals_names_those_of_the_model_first() -> None:
    fit, u = replace(made(), inputs=("lamp",), input_units=("V",)), np.zeros(5)

    for data, said in (
        (
            Dataset(u=u, y=u, Ts=0.1, output="theta_1", unit="rad"),
            r"alpha \[rad\].*theta_1 \[rad\]",
        ),
        (Dataset(u=u, y=u, Ts=0.1, output="alpha", unit="°"), r"alpha \[rad\].*alpha \[°\]"),
        (Dataset(u=u, y=u, Ts=0.1, input="fan"), r"input is lamp \[V\].*fan \[V\]"),
        (Dataset(u=u, y=u, Ts=0.1, input_unit="%"), r"input is lamp \[V\].*u \[%\]"),
        (Dataset(u=u, y=u, Ts=0.1000001, output="alpha"), r"Ts=0.1 s and the data have Ts=0.1 s"),
    ):
        with pytest.raises(ValueError, match=f"the model.*{said}"):
            fit.predict(data)
    assert np.isfinite(fit.predict(Dataset(u=u, y=u, Ts=0.1, output="alpha"), None)).all()
    assert np.isfinite(fit.predict(Dataset(u=u, y=u, Ts=0.1, unit="rad"), None)).all()
    for horizon in (2.0, -1, "3"):
        with pytest.raises(ValueError, match=f"horizon={horizon!r} must be an integer >= 1"):
            fit.predict(Dataset(u=u, y=u, Ts=0.1), horizon)  # type: ignore[arg-type]


def test_the_structure_of_a_model_does_not_count_its_integrator() -> None:
    in_f = structure_of(made(B=(0, 0, 1), nk=2, F=(1, -1.5, 0.5), D=(1, 0.2), integrator=True))
    in_a = structure_of(made(A=(1, -1.5, 0.5), C=(1, 0.1, 0.2), integrator=True, offset=True))

    assert (in_f.nb, in_f.nk, in_f.nf, in_f.nd, in_f.integrator) == ((1,), (2,), (1,), 1, "f")
    assert (in_a.na, in_a.nc, in_a.nf, in_a.integrator, in_a.offset) == (1, 2, (0,), "a", True)


def sums(fit: Fit, data: Dataset) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the equation errors A y - B u, and where all of their samples are known."""
    na, last = fit.A.size - 1, fit.B.size - 1
    y = np.where(data.valid, data.y, np.nan)
    e = np.full(data.N, np.nan)
    for t in range(max(na, last), data.N):
        e[t] = fit.A @ y[t - np.arange(na + 1)] - fit.B @ data.u[t - np.arange(last + 1)]
    return e, np.isfinite(e)


@pytest.mark.parametrize(("na", "nk"), [(1, 1), (2, 4), (3, 1)])
def test_an_equation_error_depends_only_on_the_samples_of_its_row(na: int, nk: int) -> None:
    """Late input is known during a gap, so that after the gap na errors are lost."""
    A = np.real(np.poly([0.5, -0.3, 0.7][:na]))
    fit = made(A=A.tolist(), B=[0.0] * nk + [0.5, 0.25], nk=nk, output="y", unit="")
    rng = np.random.default_rng(3)
    valid = np.ones(60, dtype=bool)
    valid[[20, 21, 30, 32]] = False
    u, y = rng.standard_normal((2, 60))
    data = Dataset(u=u, y=y, Ts=0.1, valid=valid)

    found = prediction_errors(fit, data)[0].e[:, 0]

    expected, known = sums(fit, data)
    np.testing.assert_array_equal(np.isfinite(found), known)
    np.testing.assert_allclose(found[known], expected[known], atol=1e-12)


def test_signals_of_one_input_and_output_are_predicted_as_their_dataset() -> None:
    rng = np.random.default_rng(4)
    fit = made(A=(1, -0.8), B=(0, 1.0), C=(1, 0.3), std=(0.1, 0.1, 0.1))
    signals = Signals(u=rng.standard_normal(50), y=rng.standard_normal(50), Ts=0.1, outputs="alpha")

    for horizon in (1, 3, None):
        expected = fit.predict(signals.dataset(), horizon)
        np.testing.assert_array_equal(fit.predict(signals, horizon), expected)
    with pytest.raises(InputError, match="horizon=True must be an integer >= 1"):
        fit.predict(signals, True)
    with pytest.raises(TypeError, match="data is a list: give a Dataset"):
        fit.predict([1.0])  # type: ignore[arg-type]


def test_the_fields_of_one_channel_are_refused_for_a_model_of_several_signals() -> None:
    fit = fit_of_form(apart())

    for name in ("A", "B", "C", "D", "F", "nk", "loss", "N", "white", "names", "output", "unit"):
        with pytest.raises(InputError, match=r"2 outputs and 3 inputs: choose .* fit\['b', 'w'\]"):
            getattr(fit, name)
    for method in (fit.zeros, fit.summary, fit.latex, fit.noise_to_control):
        with pytest.raises(InputError, match="choose one of each"):
            method()
