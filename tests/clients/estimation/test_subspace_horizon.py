"""Length of past and future: bounds by the order and the length, and the choice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation import subspace
from armrig.estimation.state_space_problem import scale_signals
from armrig.estimation.subspace import (
    Realisation,
    autoregressive_order,
    order_by_mdl,
    projection,
    shorten_windows,
    visible_states,
    windows,
)
from armrig.estimation.subspace_horizon import (
    InnovationsForm,
    _longest_stretches,
    _squares,
    companion,
    least_loss,
    longest_horizon,
    usable_windows,
)
from armrig.numerics.least_squares import cholesky_factor
from armrig.numerics.polynomial import apply_filter, impulse, lag_columns
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

Vector = NDArray[np.float64]


def columns(u: Vector, y: Vector) -> tuple[Vector, Vector]:
    return u[:, None], y[:, None]


def signals(N: int, noise: float = 0.1) -> list[tuple[Vector, Vector]]:
    """Return u and y of a plant of one pole, noise through it."""
    u, e = np.random.default_rng(1).standard_normal((2, N))
    y = apply_filter([0.0, 1.0], [1.0, -0.5], u) + apply_filter([noise], [1.0, -0.5], e)
    return [columns(u, y)]


@pytest.mark.parametrize(
    ("N", "order", "horizon"),
    [
        (2000, None, 10),  # an ARX model of order 1 would do
        (2000, 4, 10),
        (2000, 7, 16),  # 2 (order + 1)
        (96, None, 8),  # one for 12 samples
        (96, 7, 9),  # and never less than order + 2
    ],
)
def test_the_horizon_is_bounded_by_order_and_length(
    N: int, order: int | None, horizon: int
) -> None:
    assert longest_horizon(signals(N), N, order) == horizon


def test_a_long_memory_takes_a_long_horizon() -> None:
    """The horizon has at most 30 samples."""
    u, e = np.random.default_rng(1).standard_normal((2, 4000))
    y = apply_filter([0.0, 1.0], [1.0, -0.98], u) + 2 * e

    assert 10 < longest_horizon([columns(u, y)], 4000, None) <= 30


def test_models_are_compared_on_the_longest_stretches() -> None:
    u = np.arange(3000.0)
    y = u.copy()
    y[[500, 2200]] = np.nan  # 500, 1699 and 799 samples
    short = np.arange(100.0)

    parts = _longest_stretches([columns(short, short), columns(u, y)])

    assert [y.size for _, y in parts] == [1699, 301]
    assert [y[0] for _, y in parts] == [501.0, 2201.0]
    assert all(np.array_equal(u, y) for u, y in parts)


def innovations(A: Vector, C: Vector) -> InnovationsForm:
    """Return the observer form of A y = B u + C e."""
    n = A.size - 1
    return InnovationsForm(
        A=companion(A),
        C=np.eye(1, n),
        K=(C - A)[1:, None],
        horizon=n + 2,
        singular_values=np.ones(n),
        steady=True,
    )


def test_the_model_of_least_loss_is_chosen_or_the_first_without_noise() -> None:
    true, other = (innovations(np.array([1.0, a]), np.array([1.0, 0.0])) for a in (-0.5, 0.3))

    for models, best in (((true, other), 0), ((other, true), 1)):
        assert least_loss(signals(1000), models, direct=False) == best
    assert least_loss(signals(1000, noise=1e-9), (true, true), direct=False) == 0


def test_shortened_windows_are_the_middle_of_the_long_ones() -> None:
    """The windows begin 3 samples later and end 3 samples earlier."""
    [(u, y)] = signals(90)

    short = shorten_windows(windows([(u, y)], past=7, future=7), 4)

    direct = windows([(u[3:-3], y[3:-3])], past=4, future=4)
    assert (short.past, short.future, short.N) == (4, 4, direct.N)
    np.testing.assert_allclose(short.R.T @ short.R, direct.R.T @ direct.R, atol=1e-8)


@pytest.mark.parametrize("noise", [1e-6, 1e-9])
def test_windows_whose_squares_lose_digits_are_decomposed(noise: float) -> None:
    """With little noise the windows are nearly dependent, and the square loses digits of R."""
    parts = signals(2000, noise)

    w = windows(parts, past=8, future=8)

    (u, y) = (sliding_window_view(x[:, 0], 16) for x in parts[0])
    M = np.hstack([x - x.mean(axis=0) for x in (u, y)])
    assert cholesky_factor(M.T @ M) is None
    rest = np.abs(np.diag(w.R)[-4:]) / np.sqrt(w.N)
    assert ((rest > noise / 10) & (rest < 10 * noise)).all()


def test_the_memory_of_the_predictor_minimises_aic() -> None:
    """A lag has two parameters, one of u and one of y."""
    orders = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        u, e = rng.standard_normal((2, 130))
        y = apply_filter([0, 0.4], [1, -0.6, 0.2, -0.25], u) + apply_filter(
            [1], [1, -0.6, 0.2, -0.25], e
        )
        w = windows([columns(u, y)], past=9, future=1)
        criterion = []
        for n in range(1, 10):
            rows = np.hstack(
                [np.ones((130, 1)), lag_columns(u, range(n + 1)), lag_columns(y, range(1, n + 1))]
            )
            sse = np.linalg.lstsq(rows[9:], y[9:], rcond=None)[1][0]
            criterion.append(121 * np.log(sse) + 2 * 2 * n)
        orders.append(1 + int(np.argmin(criterion)))

        assert autoregressive_order(w) == orders[-1]
    assert len(set(orders)) > 2


def test_a_state_counts_as_three_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second state is worth 3 log N = 20.7 for 1000 windows."""
    w = windows(signals(1009), past=5, future=5)
    found = projection(w, "cva")

    for gain, order in ((17.0, 1), (24.0, 2)):
        losses = np.exp([0.0, -gain / 1000, -gain / 1000])
        monkeypatch.setattr(subspace, "one_step_losses", lambda *_, losses=losses: losses)
        assert order_by_mdl(w, found, 3) == order


def test_the_predictor_is_that_of_the_riccati_equation() -> None:
    rng = np.random.default_rng(2)
    A = np.array([[0.9, 0.2, 0.0], [-0.3, 0.7, 0.1], [0.0, 0.2, 0.5]])
    C, M = np.array([[1.0, -0.5, 0.3]]), rng.standard_normal((4, 6))
    covariance = M @ M.T
    space = Realisation(A=A, C=C, covariance=covariance)

    z = space.predictor_poles()

    Q, S, r = covariance[:3, :3], covariance[:3, 3:], covariance[3:, 3:]
    P = solve_discrete_are(A.T, C.T, Q, r, s=S)
    K = (A @ P @ C.T + S) / (C @ P @ C.T + r)
    expected = np.linalg.eigvals(A - K @ C)
    np.testing.assert_allclose(space.gain(), K, atol=1e-9)
    assert z is not None
    np.testing.assert_allclose(np.sort_complex(z), np.sort_complex(expected), atol=1e-9)
    silent = covariance.copy()
    silent[3] = silent[:, 3] = 0.0
    assert replace(space, covariance=silent).predictor_poles() is None


def test_the_real_pole_nearest_1_becomes_the_integrator() -> None:
    """A pair of poles nearer to 1 stays."""
    pair = [0.99 + 0.02j, 0.99 - 0.02j]
    A = np.real(np.poly([*pair, 0.95, -0.99, 0.3]))
    before = innovations(A, np.append(1.0, np.zeros(5)))

    after = before.integrating()

    found = np.sort_complex(np.linalg.eigvals(after.A))
    np.testing.assert_allclose(found, np.sort_complex([*pair, 1.0, -0.99, 0.3]), atol=1e-9)
    np.testing.assert_allclose(after.Abar, before.Abar, atol=1e-12)


@pytest.mark.parametrize("integrator", [False, True])
def test_unstable_poles_are_reflected_and_an_integrator_is_kept(integrator: bool) -> None:
    def of(*poles: float) -> InnovationsForm:
        A = np.poly([*poles, *[1.0] * integrator])
        found = innovations(A, np.append(1.0, np.full(A.size - 1, 0.1)))
        return found.integrating() if integrator else found

    outside, inside = of(1.3, -0.4), of(0.6, -0.4)

    moved = outside.stabilised()

    expected = np.append([-0.4, 1 / 1.3], [1.0] if integrator else [])
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(moved.A).real), expected, atol=1e-12)
    np.testing.assert_allclose(moved.Abar, outside.Abar, atol=1e-12)
    assert abs(1 - np.sum(moved.A[:, 0])) < 1e-14 or not integrator
    assert inside.stabilised() is inside


@pytest.mark.parametrize("nk", [0, 1, 3])
def test_a_delayed_input_acts_one_sample_later(nk: int) -> None:
    u = np.arange(20.0)
    data = Dataset(u=u, y=-u, Ts=1.0, starts=(0, 12)).signals()

    parts, su, sy = scale_signals(data, (nk,))

    for (late, y), part in zip(parts, data.experiments(), strict=True):
        lost = max(nk - 1, 0)
        np.testing.assert_allclose(late * su, part.u[: part.N - lost])
        np.testing.assert_allclose(y * sy, part.y[lost:])


def test_a_horizon_has_room_for_the_order_and_enough_windows() -> None:
    """Eleven windows in a row take 20 samples, if each has 10."""
    parts = signals(60)
    parts[0][1][[17, 30, 35]] = np.nan

    for order, horizon, least in ((None, 2, 3), (4, 5, 6)):
        with pytest.raises(ValueError, match=f"horizon={horizon} must be an integer >= {least}"):
            usable_windows(parts, order, horizon)
    assert windows(parts, past=5, future=5).N == 8 + 3 + 15
    got = (
        "horizon=5, with windows of 10 samples without a gap of more than 5, needs at least 32 "
        "samples, got"
    )
    for N, measured in ((30, 20), (7, 7)):
        with pytest.raises(ValueError, match=f"{got} {measured}"):
            usable_windows([(u[:N], y[:N]) for u, y in parts], None, 5)
    assert usable_windows(parts, None, 5).N == 26


def test_data_without_noise_show_the_states_of_their_system() -> None:
    [(u, y)] = signals(200, noise=0.0)
    y = y + apply_filter([0.0, 0.0, 1.0], [1.0, -1.2, 0.8], u[:, 0])[:, None]

    assert visible_states(windows([(u, y)], past=6, future=6)) == 3


@pytest.mark.parametrize("N", [60, 12])
@pytest.mark.parametrize("direct", [False, True])
def test_the_loss_equals_that_of_least_squares(direct: bool, N: int) -> None:
    """Fewer than 4 n + 4 samples are left out."""
    rng = np.random.default_rng(5)
    u, y = rng.standard_normal((2, N))
    A, C = np.array([1.0, -1.2, 0.5]), np.array([1.0, 0.3, 0.1])
    pulse, filtered_u = impulse(C, N), apply_filter([1.0], C, u)
    Phi = np.column_stack(
        [
            lag_columns(filtered_u, range(not direct, 3)),
            lag_columns(pulse, range(2)),
            np.cumsum(pulse),
        ]
    )
    v = apply_filter(A, C, y)

    squares = _squares(*columns(u, y), innovations(A, C), direct=direct)

    best = Phi @ np.linalg.lstsq(Phi, v, rcond=None)[0]
    assert squares[0, 0] == pytest.approx(float(np.sum((v - best) ** 2)), rel=1e-6)
    assert not _squares(*columns(u[:11], y[:11]), innovations(A, C), direct=direct).any()
