"""State-space models of several signals: prediction error and projections."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig import Dataset, Signals
from armrig.estimation.ss import _Criterion, _End, _improve
from armrig.estimation.state_space_gaps import (
    GapProblem,
    filter_parts,
    scale_part_errors,
    search_with_gaps,
)
from armrig.estimation.state_space_problem import (
    StateSpaceProblem,
    parts_of,
    reflect_eigenvalues,
    tangent,
)
from armrig.estimation.state_space_responses import Predictor, ScaledExperiment, output_normal
from armrig.estimation.subspace import windows
from armrig.estimation.subspace_estimate import least_squares_predictor, without_weights
from armrig.estimation.subspace_horizon import InnovationsForm
from armrig.numerics.covariance import whitening
from armrig.numerics.polynomial import Array, apply_filter
from armrig.numerics.recursion import recursion, varying_recursion
from armrig_core.errors import InputError
from numpy.typing import NDArray

from tests.sampling import sampled

ss = import_module("armrig.estimation.ss")
n4sid = import_module("armrig.estimation.n4sid")

N = 1200
A = np.array([[0.9, 0.2, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.0, 0.5]])
B = np.array([[1.0, 0.0], [0.5, -0.3], [0.2, 1.0]])
C = np.array([[1.0, 0.0, 0.5], [0.0, 0.8, -1.0]])
K = np.array([[0.4, 0.0], [-0.1, 0.3], [0.1, -0.2]])
LAMBDA = np.array([[0.04, 0.02], [0.02, 0.05]])
POLES = np.linalg.eigvals(A)


def data(seed: int = 1, scale: float = 1.0, missing: float = 0.0, D: float = 0.0) -> Signals:
    rng = np.random.default_rng(seed)
    u = np.sign(rng.standard_normal((N, 2)))
    e = scale * rng.multivariate_normal([0, 0], LAMBDA, N)
    x = recursion(A, u @ B.T + e @ K.T, np.array([1.0, -2.0, 0.5]))[:-1]
    y = x @ C.T + e + D * u[:, ::-1]
    return Signals(u=u, y=y, Ts=0.1, valid=rng.random(y.shape) >= missing)


def nearest(found: Array, truth: Array = POLES) -> Array:
    """Return, for each true pole, the estimated pole nearest to it."""
    return np.array([found[np.argmin(np.abs(found - z))] for z in truth])


def problem(noise: bool, direct: bool, missing: float) -> StateSpaceProblem:
    signals = data(missing=missing)
    parts = []
    for at in (slice(0, 70), slice(70, 200)):
        rows = signals.valid[at]
        y = np.where(rows, signals.y[at], 0.0)
        weights = whitening(LAMBDA, rows)
        parts.append(ScaledExperiment(u=signals.u[at], y=y, rows=rows, weights=weights))
    return StateSpaceProblem(parts=tuple(parts), order=3, direct=direct, noise=noise)


@pytest.mark.parametrize(
    ("noise", "direct", "missing"), [(True, False, 0.0), (True, True, 0.0), (False, True, 0.2)]
)
def test_the_gradient_is_the_slope_of_the_cost(noise: bool, direct: bool, missing: float) -> None:
    p = problem(noise, direct, missing)
    Abar, c = output_normal(A - K @ C, C)
    V = np.eye(Abar.size + c.size)
    h = 1e-6

    linear, J = p.linearise_along(Abar, c, V)
    gradient = -2 * J.T @ linear.e

    def cost(step: Array) -> float:
        e = p.linear(Abar + step[:9].reshape(3, 3), c + step[9:].reshape(2, 3)).e
        return float(e @ e)

    assert linear.e.size == 400
    slopes = [(cost(h * v) - cost(-h * v)) / (2 * h) for v in V]
    np.testing.assert_allclose(gradient, slopes, atol=1e-4 * np.abs(slopes).max())


def test_tangent_directions_are_orthogonal_to_changes_of_coordinates() -> None:
    V = tangent(A, C)
    S = np.random.default_rng(0).normal(size=(3, 3))
    change = np.concatenate([(S @ A - A @ S).ravel(), (-C @ S).ravel()])

    assert V.shape == (15, 6)
    np.testing.assert_allclose(V.T @ change, 0, atol=1e-12)


def test_output_normal_form_is_the_same_model() -> None:
    a, c = output_normal(A, C)

    np.testing.assert_allclose(a.T @ a + c.T @ c, np.eye(3), atol=1e-10)
    np.testing.assert_allclose(nearest(np.linalg.eigvals(a)), POLES, atol=1e-10)


def predictor(experiments: int) -> Predictor:
    """Return the predictor of the model above, with different first states."""
    x0 = tuple(np.array([1.0, -2.0, 0.5]) * (i + 1) for i in range(experiments))
    return Predictor(Abar=A - K @ C, Bbar=B, C=C, D=np.zeros((2, 2)), K=K, x0=x0)


def sought(
    order: int, *, direct: bool, parts: tuple[ScaledExperiment, ...] = ()
) -> StateSpaceProblem:
    return StateSpaceProblem(parts=parts, order=order, direct=direct, noise=True)


def gap_problem(parts: Sequence[ScaledExperiment], *, direct: bool) -> GapProblem:
    return GapProblem(problem=sought(3, direct=direct, parts=tuple(parts)), Lambda=LAMBDA)


def test_with_outputs_missing_the_errors_give_the_likelihood_of_the_measured_outputs() -> None:
    rng = np.random.default_rng(7)
    parts = []
    for n, share in ((9, 0.4), (7, 0.0)):
        rows = rng.random((n, 2)) >= share
        rows[3:5] = share == 0  # an instant without any output
        y = np.where(rows, rng.standard_normal((n, 2)), 0.0)
        parts.append(
            ScaledExperiment(
                u=rng.standard_normal((n, 2)), y=y, rows=rows, weights=whitening(LAMBDA, rows)
            )
        )
    model = predictor(2)

    found = [
        gap_problem(parts, direct=False).errors(model, innovations=only)[:2]
        for only in (True, False)
    ]

    quadratic = determinant = 0.0
    for part, x0 in zip(parts, model.x0, strict=True):
        n = part.y.shape[0]
        mean = recursion(A, part.u @ B.T, x0)[:-1] @ C.T
        noise = [np.eye(2), *(C @ np.linalg.matrix_power(A, k) @ K for k in range(n - 1))]
        zero = np.zeros((2, 2))
        H = np.block([[noise[i - j] if j <= i else zero for j in range(n)] for i in range(n)])
        known = part.rows.ravel()
        S = (H @ np.kron(np.eye(n), LAMBDA) @ H.T)[np.ix_(known, known)]
        error = (part.y - mean).ravel()[known]
        quadratic += error @ np.linalg.solve(S, error)
        determinant += np.linalg.slogdet(S)[1]
        determinant -= sum(np.linalg.slogdet(LAMBDA[np.ix_(r, r)])[1] for r in part.rows if r.any())
    for z, log in found:
        np.testing.assert_allclose(np.sum(z**2), quadratic, rtol=1e-9)
        np.testing.assert_allclose(log * sum(p.rows.sum() for p in parts), determinant, rtol=1e-9)


def test_the_filter_of_a_subspace_estimate_has_the_errors_of_the_search() -> None:
    """Its gains and roots whiten the errors in the same way."""
    signals, model = data(missing=0.1)[:300], predictor(1)
    measured = [(signals.u, signals.y)]
    gaps = gap_problem(parts_of(measured, LAMBDA), direct=False)

    (part,) = filter_parts(measured, A, C, K, LAMBDA)
    left = np.where(part.rows, signals.y - model.predicted(part, 0), 0.0)

    z = (part.weights @ left[:, :, None])[:, :, 0]
    white = gaps.errors(model, innovations=True)[0]
    np.testing.assert_allclose(z, white.reshape(2, -1).T, atol=1e-9)
    scaled = scale_part_errors(part, left, LAMBDA)
    np.testing.assert_allclose(scaled, gaps.residuals(white)[0], atol=1e-9)


def test_the_covariance_of_the_noise_is_estimated_along_with_the_gaps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The search begins with a covariance that is nine times too large."""
    rng = np.random.default_rng(4)
    u, e = rng.standard_normal((2, 60, 1))
    x = recursion(np.array([[0.7]]), u + 0.4 * e, np.zeros(1))[:-1]
    y = np.where(rng.random((60, 1)) < 0.1, np.nan, x + e)
    one, zero = np.ones((1, 1)), np.zeros((1, 1))
    at = Predictor(Abar=0.3 * one, Bbar=one, C=one, D=zero, K=0.4 * one, x0=(np.zeros(1),))

    found = search_with_gaps(sought(1, direct=False), [(u, y)], at, 9.0 * one)

    left = np.vstack(found.residuals)
    assert found.converged
    assert found.iterations > 0
    assert found.problem.Lambda[0, 0] == pytest.approx(np.nanmean(left**2), rel=1e-2)
    assert found.problem.Lambda[0, 0] == pytest.approx(1.0, abs=0.5)

    monkeypatch.setattr("armrig.estimation.state_space_gaps._MAX_STEPS", 1)
    assert not search_with_gaps(sought(1, direct=False), [(u, y)], at, 9.0 * one).converged


def test_the_slopes_with_gaps_are_the_differences_of_the_errors() -> None:
    """Those of the innovations, and of the log determinant, in two experiments."""
    with_gaps = problem(noise=True, direct=True, missing=0.3)
    gaps = gap_problem(with_gaps.parts, direct=True)
    at = replace(predictor(2).balance(), D=0.1 * np.eye(2))
    by = gaps.directions(at)
    d, h = len(by.A), 1e-5

    e, _, of_filter = gaps.errors(at, innovations=True)
    slopes, by_log = gaps.slopes(at, of_filter)
    z, _, projected = gaps.errors(at)
    J, by_log_det = gaps.slopes(at, projected)

    np.testing.assert_allclose(by_log_det, by_log, atol=1e-9)
    np.testing.assert_allclose(J.T @ z, slopes.T @ e, rtol=1e-7, atol=1e-9)
    for k in range(d + 6):
        found = []
        for sign in (1, -1):
            step = sign * h * np.eye(d + 6)[k]
            x0 = tuple(x + dx for x, dx in zip(at.x0, step[d:].reshape(2, 3), strict=True))
            found.append(gaps.errors(replace(by.moved(at, step[:d]), x0=x0), innovations=True)[:2])
        (z, log), (z_, log_) = found
        np.testing.assert_allclose(slopes[:, k], (z_ - z) / (2 * h), atol=1e-7)
        assert by_log[k] == pytest.approx((log - log_) / (2 * h), abs=1e-7)


def test_without_a_gap_the_errors_are_those_of_the_constant_gain() -> None:
    whole = problem(noise=True, direct=True, missing=0.0)
    linear = whole.linear(A - K @ C, C)
    at = linear.at.balance()

    gaps = gap_problem(whole.parts, direct=True)

    z, log, _ = gaps.errors(at)
    np.testing.assert_allclose(z, linear.e, atol=1e-9)
    np.testing.assert_array_equal(log, 0)
    for found, e in zip(gaps.residuals(z), whole.residuals(linear.at), strict=True):
        np.testing.assert_allclose(found, e, atol=1e-9)


def test_a_start_value_is_stable() -> None:
    inside = reflect_eigenvalues(np.diag([1.5, 0.5]))

    np.testing.assert_allclose(np.sort(np.linalg.eigvals(inside)), [0.5, 1 / 1.5])


def test_noise_free_data_give_back_the_plant() -> None:
    for fit in (
        armrig.ss(data(scale=0.0), order=3, noise=False),
        armrig.n4sid(data(scale=1e-7), 3, replicates=0),
    ):
        np.testing.assert_allclose(nearest(fit.poles().values), POLES, atol=1e-5)
        G = fit.frequency_response([2.0]).G[0]
        z = np.exp(0.2j)
        np.testing.assert_allclose(G, C @ np.linalg.solve(z * np.eye(3) - A, B), atol=1e-4)


@pytest.mark.parametrize(("seed", "missing"), sampled([(0, 0.0), (1, 0.0), (2, 0.0), (3, 0.2)], 2))
def test_estimates_lie_within_their_deviations(seed: int, missing: float) -> None:
    fit = armrig.ss(data(seed=seed, missing=missing), order=3)

    poles = fit.poles()
    order = [int(np.argmin(np.abs(poles.values - z))) for z in POLES]
    z = np.abs(poles.values[order] - POLES) / poles.std[order]
    assert z.max() < 3.5
    assert fit.search.converged
    np.testing.assert_allclose(fit.noise_covariance, LAMBDA, rtol=0.25)
    omega = np.array([0.5, 5.0, 20.0])
    answer = fit.frequency_response(omega)
    truth = np.array([C @ np.linalg.solve(np.exp(0.1j * w) * np.eye(3) - A, B) for w in omega])
    off = (np.abs(answer.G) - np.abs(truth)) / answer.std_magnitude
    assert np.abs(off).max() < 4.5
    assert all(not q.white.coloured for q in fit.quality)


def test_units_of_signals_change_no_state_space_model() -> None:
    signals = data()
    other = Signals(u=signals.u * [1e3, 1.0], y=signals.y * [1.0, 1e-6], Ts=0.1)

    ours, theirs = armrig.ss(signals, order=3), armrig.ss(other, order=3)

    np.testing.assert_allclose(
        nearest(theirs.poles().values, ours.poles().values), ours.poles().values, atol=1e-5
    )
    assert theirs["y2", "u1"].B[1] == pytest.approx(1e-9 * ours["y2", "u1"].B[1], rel=1e-3)


def test_one_input_and_output_give_the_armax_model() -> None:
    rng = np.random.default_rng(4)
    u = np.sign(rng.standard_normal(N))
    a = np.array([1.0, -1.4, 0.65])
    y = apply_filter([0, 1.0, 0.5], a, u) + apply_filter(
        [1, 0.5, 0.2], a, 0.3 * rng.standard_normal(N)
    )
    known = armrig.armax(Dataset(u=u, y=y, Ts=1.0), na=2, nb=2, nc=2)

    fit = armrig.ss(Signals(u=u, y=y, Ts=1.0), order=2)

    np.testing.assert_allclose(fit.A, known.A, atol=2e-5)
    np.testing.assert_allclose(fit.B, known.B, atol=2e-5)
    np.testing.assert_allclose(fit.C, known.C, atol=2e-5)
    np.testing.assert_allclose(fit.std, known.std, rtol=1e-3)
    assert fit.quality[0].loss == pytest.approx(known.loss, rel=1e-8)


def test_a_direct_term_and_a_delay_are_estimated() -> None:
    direct = armrig.ss(data(D=0.7), order=3, nk=0)
    signals = data()
    u = np.column_stack([np.roll(signals.u[:, 0], -2), signals.u[:, 1]])
    late = Signals(u=u[:-2], y=signals.y[:-2], Ts=0.1)
    fit = armrig.ss(late, order=3, nk=[3, 1])

    np.testing.assert_allclose(direct.state_space()[3], 0.7 * np.eye(2)[::-1], atol=0.1)
    assert fit["y1", "u1"].nk == 3
    np.testing.assert_allclose(fit["y1", "u1"].B[:3], 0.0)
    np.testing.assert_allclose(fit.simulate(late.u)[200:], fit.predict(late, None)[200:], atol=1e-3)
    system = fit.to_control()
    z = np.exp(0.3j)
    np.testing.assert_allclose(fit.frequency_response([3.0]).G[0], system(z), rtol=1e-8)


def test_missing_outputs_of_an_output_error_model_are_left_out() -> None:
    fit = armrig.ss(data(scale=0.3, missing=0.2), order=3, noise=False)

    np.testing.assert_allclose(nearest(fit.poles().values), POLES, atol=0.03)


def test_a_subspace_estimate_worse_than_the_mean_is_reported() -> None:
    signals = armrig.example_recording().signals()
    poor, good = (armrig.n4sid(signals, n, replicates=0) for n in (1, 4))

    (found,) = (x for x in poor.findings if x.about == "poor_fit")
    assert found.level == "warning"
    assert found.text.startswith("the model predicts alpha worse than the mean of alpha does")
    assert found.numbers["fit_percent"] == poor.quality[1].fit_percent < 0
    assert [x.about for x in good.findings] == ["bound"]


def test_a_subspace_estimate_predicts_the_missing_outputs() -> None:
    """theta_1 is far from 0 where it is missing, and K leads its errors to alpha."""
    fit = armrig.n4sid(armrig.example_recording().signals(), 4, replicates=0)

    assert [found.fit_percent for found in fit.quality] == pytest.approx([99.99, 97.6], abs=0.1)
    # A, C, B and K of four states, and the initial state, are fitted to the two outputs.
    expected = [q.loss * q.N / (q.N - (8 + 4 + 8 + 4) / 2) for q in fit.quality]
    np.testing.assert_allclose(np.diag(fit.noise_covariance), expected)
    np.testing.assert_allclose(fit.noise_covariance, fit.noise_covariance.T)


@pytest.mark.exhaustive
def test_output_weights_choose_the_output_that_a_simple_model_fits() -> None:
    signals = data()
    by_noise = armrig.ss(signals, order=1)
    weighted = armrig.ss(signals, order=1, output_weights=[1, 100])

    assert by_noise.output_weights == ()
    assert weighted.output_weights == (1.0, 100.0)
    assert weighted.quality[1].loss < by_noise.quality[1].loss
    cost = [fit.quality[0].loss + 100 * fit.quality[1].loss for fit in (weighted, by_noise)]
    assert cost[0] < cost[1]
    assert (
        np.linalg.slogdet(weighted.noise_covariance)[1]
        > (np.linalg.slogdet(by_noise.noise_covariance)[1])
    )
    assert weighted.search.starts[0].loss == pytest.approx(
        (weighted.quality[0].loss + 100 * weighted.quality[1].loss) / 2
    )


def test_the_weight_of_a_single_output_changes_no_estimate(tmp_path: Path) -> None:
    alone = data().channels(["y1"], ["u1", "u2"])
    weighted = armrig.ss(alone, order=3, output_weights=[7.0])
    by_noise = armrig.ss(alone, order=3)

    np.testing.assert_allclose(
        np.sort_complex(weighted.poles().values), np.sort_complex(by_noise.poles().values), 1e-5
    )
    np.testing.assert_allclose(weighted.quality[0].loss, by_noise.quality[0].loss, 1e-7)
    weighted.save(tmp_path / "model.json")
    assert armrig.load_fit(tmp_path / "model.json").output_weights == (7.0,)


def test_a_search_leaves_a_local_minimum(
    reference: Callable[[str], NDArray[np.float64]],
) -> None:
    """All subspace starts of order 2 end at real poles; the minimum has a complex pair.

    The fit of 79.4 and 79.7 % is that of MATLAB's pem in I. Markovsky's software report on `ident`.
    """
    table = reference("CD_player_arm.dat")
    table = table - table.mean(axis=0)
    signals = Signals(u=table[:, :2], y=table[:, 2:], Ts=1.0)
    cut = int(np.ceil(0.7 * signals.N))

    fit = armrig.ss(signals[:cut], order=2, nk=0, noise=False, output_weights=[1, 1])

    for part, expected in ((signals[:cut], 79.4), (signals[cut:], 79.7)):
        e = part.y - fit.predict(part, None)
        spread = part.y - part.y.mean(axis=0)
        assert 100 * (1 - np.linalg.norm(e) / np.linalg.norm(spread)) == pytest.approx(
            expected, abs=0.1
        )


@pytest.mark.parametrize(
    ("most", "sizes"), [(60, [60]), (70, [70]), (100, [70, 30]), (500, [70, 130])]
)
def test_the_search_on_long_data_starts_with_their_first_samples(
    most: int, sizes: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ss, "_PART_SAMPLES", most)
    whole = problem(noise=True, direct=False, missing=0.2)

    part = ss._part(whole)

    assert [x.u.shape[0] for x in part.parts] == sizes
    for found, of, n in zip(part.parts, whole.parts, sizes, strict=False):
        for name in ("u", "y", "rows", "weights"):
            np.testing.assert_array_equal(getattr(found, name), getattr(of, name)[:n])
    assert (part.order, part.direct, part.noise) == (3, False, True)


def test_replicates_have_the_missing_samples_of_the_data(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replicates are estimated in the same way as the model."""
    seen: list[list[Array]] = []
    estimated = n4sid.estimate_subspace_model

    def watched(signals: Any, options: Any) -> Any:
        seen.append([np.isfinite(y) for _, y in signals])
        return estimated(signals, options)

    monkeypatch.setattr(n4sid, "estimate_subspace_model", watched)
    whole = data(missing=0.02)[:400]

    armrig.n4sid(whole.replaced(starts=(0, 150), step=None), 3, replicates=2, horizon=6)

    assert len(seen) == 3
    for of_one in seen:
        assert [x.shape[0] for x in of_one] == [150, 250]
        np.testing.assert_array_equal(np.vstack(of_one), whole.valid)


def test_a_search_for_a_worse_minimum_ends_early() -> None:
    """The criterion of a better end is out of reach after a few rounds."""
    p = problem(noise=True, direct=False, missing=0.0)
    z = np.diag([0.1, -0.2, 0.3])
    begun = _End(name="far", Abar=z, C=C, Lambda=LAMBDA, criterion=np.inf)

    alone = _improve(p, begun, _Criterion(given=None), np.inf)
    given_up = _improve(p, begun, _Criterion(given=None), alone.criterion - 50)

    assert alone.converged
    assert not given_up.converged
    assert given_up.iterations < alone.iterations / 2


@pytest.mark.parametrize(
    ("offset", "scale", "missing", "most"),
    [(0.0, 1.0, 0.0, None), (1e4, 1.0, 0.0, None), (0.0, 1e-9, 0.0, None)]
    + [(1.0, 1.0, 0.01, most) for most in (None, 30, 300)],
)
def test_the_factor_of_windows_has_their_squares(
    offset: float, scale: float, missing: float, most: int | None
) -> None:
    """It is that of the first `most` windows [U_f U_p Y_p Y_f] without a missing sample."""
    signals, p, f = data(scale=scale, missing=missing), 8, 6
    whole = np.where(signals.valid, signals.y, np.nan)
    parts = [(signals.u[at] + offset, whole[at] - offset) for at in (slice(300), slice(300, N))]

    w = windows(parts, past=p, future=f, most=most)

    rows = [
        np.concatenate([*u[t + p : t + p + f], *u[t : t + p], *y[t : t + p], *y[t + p : t + p + f]])
        for u, y in parts
        for t in range(len(y) - p - f + 1)
    ]
    M = np.array([row for row in rows if np.isfinite(row).all()][:most])
    M -= M.mean(axis=0)
    assert M.shape[0] == w.N
    assert np.allclose(np.tril(w.R, -1), 0)
    np.testing.assert_allclose(w.R.T @ w.R, M.T @ M, atol=1e-9 * np.abs(M.T @ M).max())


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", [1, 2])
def test_missing_outputs_are_estimated_until_they_settle(seed: int) -> None:
    whole, gaps = (armrig.n4sid(data(seed, missing=m), 3, replicates=0) for m in (0.0, 0.2))
    found, expected = (nearest(fit.poles().values) for fit in (gaps, whole))

    # Interpolated values alone move the real pole by 0.05.
    assert np.abs(found - expected).max() < 0.003
    assert gaps.search.converged
    assert not any(f.about == "search" for f in gaps.findings)


def test_a_predictor_does_not_need_the_value_of_a_missing_output() -> None:
    rng = np.random.default_rng(3)
    u, y = rng.standard_normal((40, 2)), rng.standard_normal((40, 2))
    y[[0, 5, 6, 7, 31], [0, 1, 1, 0, 1]] = np.nan
    model = InnovationsForm(A=A, C=C, K=K, horizon=5, singular_values=np.ones(3), steady=True)
    at, (predicted,), _ = least_squares_predictor(without_weights([(u, y)]), model, direct=True)

    x, by_hand = at.x0[0], []
    for now, measured in zip(u, y, strict=True):
        by_hand.append(C @ x + at.D @ now)
        e = np.where(np.isfinite(measured), measured - by_hand[-1], 0.0)
        x = A @ x + (at.Bbar + K @ at.D) @ now + K @ e

    np.testing.assert_allclose(predicted, by_hand, atol=1e-9)


def test_the_matrices_change_at_every_step_of_a_recursion() -> None:
    rng = np.random.default_rng(5)
    Phi, w, x = (
        0.5 * rng.standard_normal((30, 3, 3)),
        rng.standard_normal((30, 2, 3)),
        [np.eye(2, 3)],
    )
    for step, driven in zip(Phi, w, strict=True):
        x.append(x[-1] @ step.T + driven)

    np.testing.assert_allclose(varying_recursion(Phi, w, x[0]), x, atol=1e-12)


def test_the_replicates_have_the_deviations_of_many_runs() -> None:
    fits = [armrig.n4sid(data(seed=s), 3, replicates=0) for s in range(60)]
    values = np.array([nearest(f.poles().values) for f in fits])
    spread = np.sqrt(np.var(values.real, axis=0) + np.var(values.imag, axis=0))

    fit = armrig.n4sid(data(seed=7), 3)

    poles = fit.poles()
    order = [int(np.argmin(np.abs(poles.values - z))) for z in POLES]
    assert np.abs(poles.std[order] / spread - 1).max() < 0.45
    assert not any(f.about == "bound" for f in fit.findings)


OF_SHAPES: dict[str, tuple[list[str], list[str]]] = {
    "1x1": (["y1"], ["u1"]),
    "2x1": (["y1"], ["u1", "u2"]),
    "2x2": (["y1", "y2"], ["u1", "u2"]),
}


@pytest.mark.parametrize("shape", OF_SHAPES)
def test_a_model_for_simulation_is_stable_and_simulates_better(shape: str) -> None:
    """Three states in the data, and two in the model."""
    signals = data(scale=0.3).channels(*OF_SHAPES[shape])

    ahead, simulated = (
        armrig.n4sid(signals, 2, focus=focus, replicates=0)
        for focus in ("prediction", "simulation")
    )

    rms = [
        float(np.mean((signals.y - fit.predict(signals, None).reshape(signals.y.shape)) ** 2))
        for fit in (simulated, ahead)
    ]
    assert rms[0] < rms[1]
    assert np.abs(simulated.poles().values).max() < 1
    losses = [sum(q.loss for q in fit.quality) for fit in (ahead, simulated)]
    assert losses[0] < losses[1]


@pytest.mark.parametrize("focus", ["prediction", "simulation"])
@pytest.mark.parametrize("shape", OF_SHAPES)
def test_an_integrator_is_exact_and_an_input_offset_does_not_matter(shape: str, focus: Any) -> None:
    signals = data(scale=0.1).channels(*OF_SHAPES[shape])
    y = np.column_stack([np.cumsum(signals.y[:, 0]), signals.y[:, 1:]])
    summed = signals.replaced(step=None, y=y)
    offset = summed.replaced(step=None, u=summed.u + 0.4)
    order = 3 if shape == "1x1" else 4  # the second input moves a further state

    fits = [
        armrig.n4sid(x, order, integrator=True, focus=focus, replicates=0) for x in (summed, offset)
    ]

    one, other = (fit.poles() for fit in fits)
    nearest_1 = int(np.argmin(np.abs(one.values - 1)))
    assert abs(one.values[nearest_1] - 1) < 1e-9
    assert one.std[nearest_1].max() < 1e-6
    np.testing.assert_allclose(
        np.sort_complex(other.values), np.sort_complex(one.values), atol=1e-5
    )


@pytest.mark.parametrize("shape", OF_SHAPES)
def test_gaps_hardly_increase_the_error(shape: str) -> None:
    """A tenth of the samples is missing."""
    errors = []
    for missing in (0.0, 0.1):
        fits = [
            armrig.n4sid(data(seed, missing=missing).channels(*OF_SHAPES[shape]), 3, replicates=0)
            for seed in range(5)
        ]
        found = np.array([nearest(fit.poles().values, POLES[:2]) for fit in fits])
        errors.append(float(np.sqrt(np.mean(np.abs(found - POLES[:2]) ** 2))))

    assert errors[1] < 1.6 * errors[0]


def test_arguments_that_do_not_match_the_data_are_refused() -> None:
    with pytest.raises(InputError, match="needs at least"):
        armrig.ss(data()[:30], order=8)
    with pytest.raises(InputError, match="2 delays are needed, one for each input"):
        armrig.ss(data(), order=2, nk=[1, 1, 1])
    for weights in ([1.0], [1, 0], [1, -1], [1, np.nan]):
        with pytest.raises(InputError, match="must be 2 positive numbers, one for each output of"):
            armrig.ss(data(), order=2, output_weights=weights)
    with pytest.raises(InputError, match="weights of outputs and an estimated K need complete"):
        armrig.ss(data(missing=0.2), order=2, output_weights=[1, 1])
    with pytest.raises(InputError, match="a direct term needs nk=0 for all inputs"):
        armrig.ss(data(), order=2, nk=[0, 1])
    with pytest.raises(InputError, match="weights='pls' must be one of"):
        armrig.n4sid(data(), 2, "pls")
    often = data()
    often = often.replaced(step=None, valid=often.valid & (np.arange(N) % 16 > 11)[:, None])
    with pytest.raises(InputError, match="20 samples without a gap of more than 10, needs at leas"):
        armrig.n4sid(often, 3, horizon=10)
