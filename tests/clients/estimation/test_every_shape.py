"""Models with several inputs and outputs: what is true, what is equal, and what is refused."""

from __future__ import annotations

from typing import Any

import armrig
import numpy as np
import pytest
from armrig import Signals
from armrig.estimation.search import rank_ends
from armrig.numerics.polynomial import Array, apply_filter
from armrig_core.errors import InputError

from tests.plants import chassis_and_arm
from tests.sampling import sampled

N = 900
F = [[[1, -1.2, 0.5], [1, -0.7]], [[1, -0.3, 0.1], [1, -1.5, 0.7]]]
B = [[[0, 1, 0.5], [0, 0, 2, 1]], [[0, 0.3], [0, 0.2, 0.1]]]
ORDERS: dict[str, Any] = {
    "nb": [[2, 2], [1, 2]],
    "nf": [[2, 1], [2, 2]],
    "nk": {("a", "v"): 2},
}
LAMBDA = np.array([[0.04, 0.03], [0.03, 0.05]])


def inputs(rng: np.random.Generator, nu: int = 2) -> Array:
    return np.repeat(np.sign(rng.standard_normal((N // 2, nu))), 2, axis=0)


def noise(rng: np.random.Generator, C: Any = (1,), D: Any = (1,)) -> Array:
    """Return correlated noise of both outputs, filtered by C/D."""
    e = rng.multivariate_normal([0, 0], LAMBDA, N)
    return np.column_stack([apply_filter(C, D, x) for x in e.T])


def plant(
    seed: int = 1, scale: float = 1.0, missing: float = 0.0, C: Any = (1,), D: Any = (1,)
) -> Signals:
    rng = np.random.default_rng(seed)
    u = inputs(rng)
    y = np.column_stack(
        [sum(apply_filter(B[i][j], F[i][j], u[:, j]) for j in range(2)) for i in range(2)]
    )
    y += scale * noise(rng, C, D)
    valid = rng.random(y.shape) >= missing
    return Signals(u=u, y=y, Ts=0.1, valid=valid, outputs=["a", "b"], inputs=["u", "v"])


def coupled(seed: int = 1, scale: float = 1.0) -> Signals:
    """Return data of an ARX model whose outputs affect each other."""
    rng = np.random.default_rng(seed)
    u, e, y = inputs(rng), scale * noise(rng), np.zeros((N, 2))
    for t in range(2, N):
        y[t, 0] = 0.8 * y[t - 1, 0] - 0.2 * y[t - 2, 0] - 0.1 * y[t - 1, 1]
        y[t, 0] += u[t - 1, 0] + 0.4 * u[t - 2, 1] + e[t, 0]
        y[t, 1] = 0.5 * y[t - 1, 1] + 0.2 * y[t - 1, 0] - 0.1 * y[t - 2, 0]
        y[t, 1] += 0.7 * u[t - 1, 1] + e[t, 1]
    return Signals(u=u, y=y, Ts=0.1, outputs=["a", "b"], inputs=["u", "v"])


COUPLED: dict[str, Any] = {
    "na": [[2, 1], [2, 1]],
    "nb": [[1, 1], [0, 1]],
    "nk": [[1, 2], [1, 1]],
}
COUPLED_THETA = [-0.8, 0.2, 0.1, 1.0, 0.4, -0.2, 0.1, -0.5, 0.7]


ORDERS_OF: dict[str, dict[str, Any]] = {
    "arx": {"na": 2},
    "oe": {"nf": 2},
    "armax": {"na": 2, "nc": 1},
    "bj": {"nc": 1, "nd": 1, "nf": 2},
    "ararx": {"na": 2, "nd": 1},
    "pem": {"na": 1, "nc": 1, "nf": 1},
}
OPTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "offset": {"offset": True},
    "stable": {"stable": True},
    "integrator": {"integrator": True},
    "at rest": {"initial": "zero"},
    "auto": {"initial": "auto"},
    "few": {"starts": "few"},
    "gaps": {},
}
CASES = [
    (name, option)
    for name in ORDERS_OF
    for option in OPTIONS
    if option in ("plain", "gaps", "stable")
    or not (name == "arx" or (name == "pem" and option == "integrator"))
]


def unequal(option: str) -> Signals:
    """Return data of two experiments, in which each output depends on one of the inputs."""
    rng = np.random.default_rng(2)
    u, e = inputs(rng) + 0.1, noise(rng, (1, 0.4), (1, -0.8))
    y = np.column_stack([apply_filter([0, 1, 0.5], [1, -1.5, 0.7], x) for x in u.T]) + e
    y = np.cumsum(y, axis=0) if option == "integrator" else y
    valid = rng.random(y.shape) > (0.02 if option == "gaps" else 0.0)
    names: dict[str, Any] = {"outputs": ["a", "b"], "inputs": ["u", "v"]}
    return Signals(u=u, y=y, Ts=0.1, starts=(0, 150), valid=valid, **names)[:400]


@pytest.mark.parametrize(("name", "option"), sampled(CASES, 12))
def test_an_output_with_one_input_has_the_estimate_of_its_dataset(name: str, option: str) -> None:
    """Another input that has no effect, and another output, change nothing."""
    few = {} if name == "arx" or option == "plain" else {"starts": "few"}
    data, options = unequal(option), few | OPTIONS[option] | ORDERS_OF[name]
    estimator = getattr(armrig, name)
    if name == "arx":
        options["na"] = np.diag([2, 2])
    both = estimator(data, nb=np.diag([2, 2]), **options)
    for output, input in (("a", "u"), ("b", "v")):
        known = estimator(data.dataset(output, input), **({"nb": 2} | options | ORDERS_OF[name]))
        alone = estimator(
            data.channels(output),
            nb=[[2 * (x == input) for x in "uv"]],
            **(options | ORDERS_OF[name]),
        )
        weighted = name == "arx"  # by the covariance of both outputs
        for fit in [alone[output, input]] + [both[output, input]] * (not weighted):
            np.testing.assert_allclose(fit.theta, known.theta, rtol=1e-6, atol=1e-7)
            np.testing.assert_allclose(fit.covariance, known.covariance, rtol=1e-4, atol=1e-9)
            assert fit.noise_variance == pytest.approx(known.noise_variance, rel=1e-8)
            assert fit.whiteness == pytest.approx(known.whiteness, rel=1e-4, abs=1e-12)
            assert fit.fit_percent == pytest.approx(known.fit_percent)
            assert fit.integrator == known.integrator
        fit = alone[output, input]
        np.testing.assert_allclose(
            fit.covariance_robust, known.covariance_robust, rtol=1e-3, atol=1e-9
        )


def test_signals_of_one_input_and_output_are_estimated_as_their_dataset() -> None:
    signals = plant().channels("a", "u")

    assert repr(armrig.oe(signals, nb=2, nf=2)) == repr(armrig.oe(signals.dataset(), nb=2, nf=2))


def integrated(seed: int, missing: float = 0.0) -> Signals:
    """Return data of an ARMAX model whose first output integrates the inputs and the noise."""
    rng = np.random.default_rng(seed)
    u = inputs(rng)[:300] + 0.05
    e = 0.1 * rng.standard_normal((300, 2))
    A = np.convolve([1, -1], [1, -0.7])
    y = np.column_stack(
        [
            apply_filter([0, 0.5, 0.2], A, u[:, 0])
            + apply_filter([0, 0.3], A, u[:, 1])
            + apply_filter([1, 0.5], A, e[:, 0]),
            apply_filter([0, 1], [1, -0.8], u[:, 0]) + apply_filter([1, 0.3], [1, -0.8], e[:, 1]),
        ]
    )
    valid = rng.random(y.shape) >= missing
    return Signals(
        u=u, y=y + np.array([3, 0]), Ts=0.1, valid=valid, outputs=["a", "b"], inputs=["u", "v"]
    )


def test_an_armax_model_has_a_fixed_integrator_in_one_output() -> None:
    true = [-1.7, 0.7, 0.5, 0.2, 0.3, 0.5, -0.8, 1.0, 0.3]

    fit = armrig.armax(integrated(1), na=[2, 1], nb=[[2, 1], [1, 0]], nc=1, integrator="a")

    assert np.max(np.abs(fit.theta - true) / fit.std) < 4
    assert fit["a", "u"].A.sum() == pytest.approx(0, abs=1e-12)
    assert 1.0 in fit.poles().values
    tests = armrig.residuals(fit, integrated(2))
    assert not tests.rejects


@pytest.mark.exhaustive
def test_a_shared_denominator_of_an_armax_model_may_have_an_integrator() -> None:
    data = integrated(1)

    fit = armrig.armax(data, na=1, nb=2, nc=1, integrator="a", shared="denominator")

    A = fit["b", "u"].A
    np.testing.assert_allclose(fit["a", "u"].A, np.convolve([1, -1], A), atol=1e-12)
    with pytest.raises(InputError, match="na must be at least 1 with an integrator"):
        armrig.armax(data, na=[0, 1], nb=1, nc=0, integrator="a")


@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_noise_free_data_give_back_the_plant(missing: float) -> None:
    fit = armrig.oe(plant(scale=0.0, missing=missing), **ORDERS)

    for i, output in enumerate(("a", "b")):
        for j, input in enumerate(("u", "v")):
            channel = fit[output, input]
            np.testing.assert_allclose(channel.F, F[i][j], atol=1e-6)
            np.testing.assert_allclose(channel.B, B[i][j], atol=1e-6)


@pytest.mark.exhaustive
@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_estimates_lie_within_their_deviations(missing: float) -> None:
    truth = np.concatenate([*(B[0][0][1:], B[0][1][2:], [0.4], [-0.8], F[0][0][1:], F[0][1][1:])])

    data = plant(missing=missing, C=(1, 0.4), D=(1, -0.8))
    fit = armrig.bj(data, nc=1, nd=1, **ORDERS)

    z = (fit.theta[: truth.size] - truth) / fit.std[: truth.size]
    assert np.abs(z).max() < 3.5
    assert all(not q.white.coloured for q in fit.quality)
    np.testing.assert_allclose(fit.noise_covariance, LAMBDA, rtol=0.2)


def test_rows_are_weighted_by_the_covariance_of_their_noise() -> None:
    """Rows with fewer regressors have smaller deviations."""
    fit = armrig.arx(coupled(), **COUPLED)

    assert np.abs((fit.theta - COUPLED_THETA) / fit.std).max() < 3.5
    alone = armrig.arx(coupled(), na=[[2, 1], [2, 1]], nb=2)
    assert fit.std[0] < alone.std[0]


def test_an_arx_model_with_equal_regressors_is_ordinary_least_squares() -> None:
    data = coupled()
    fit = armrig.arx(data, na=2, nb=2)
    past = [data.y[1:-1], data.y[:-2], data.u[1:-1], data.u[:-2]]
    X = np.hstack(past)
    theta = np.linalg.lstsq(X, data.y[2:], rcond=None)[0]

    names = [(letter, k, lag) for letter, i, k, lag in fit.form.names if i == 0]
    order = [(n, k, lag) for n in "ab" for lag in (1, 2) for k in (0, 1)]
    signs = np.array([-1.0] * 4 + [1.0] * 4)
    expected = dict(zip(order, signs * theta[:, 0], strict=True))
    np.testing.assert_allclose(fit.theta[: len(names)], [expected[n] for n in names], rtol=1e-8)


@pytest.mark.exhaustive
def test_a_shared_denominator_gains_from_the_second_output() -> None:
    drawn = chassis_and_arm(5)
    data = drawn.signals(N, 0.0, (5, N, 0))

    fit = drawn.fit(data)
    alone = armrig.oe(data.dataset("chassis"), nb=4, nf=4, integrator=True)

    np.testing.assert_array_equal(fit["chassis"].F, np.convolve([1, -1], fit["arm"].F))
    np.testing.assert_allclose(fit["arm"].F, np.real(np.poly(drawn.poles)), atol=0.05)
    both, one = (f.poles().std.sum() for f in (fit["chassis"], alone))
    assert both < 0.95 * one
    assert len(fit.poles()) == 4


def test_an_armax_model_may_share_its_denominator() -> None:
    rng = np.random.default_rng(8)
    u = inputs(rng)
    A = np.array([1.0, -1.3, 0.6])
    e = noise(rng)
    y = np.column_stack(
        [
            apply_filter([0, 1], A, u[:, 0]) + apply_filter([0, 0.5], A, u[:, 1]),
            apply_filter([0, 0.3], A, u[:, 0]) + apply_filter([0, -1], A, u[:, 1]),
        ]
    ) + np.column_stack([apply_filter([1, c], A, x) for c, x in zip((0.5, -0.4), e.T, strict=True)])
    data = Signals(u=u, y=y, Ts=0.1)

    fit = armrig.armax(data, na=2, nb=1, nc=1, shared="denominator")
    own = armrig.armax(data, na=2, nb=1, nc=1)

    np.testing.assert_array_equal(fit["y1", "u1"].A, fit["y2", "u2"].A)
    np.testing.assert_allclose(fit["y1", "u1"].A, A, atol=0.05)
    assert fit["y1", "u1"].std[0] < own["y1", "u1"].std[0]
    assert len(fit.poles()) == 2
    assert len(own.poles()) == 4


@pytest.mark.parametrize(
    ("orders", "message"),
    [
        ({"nb": 1, "nf": 1, "nk": {("a", "x"): 2}}, r"nk: there is no \('a', 'x'\)"),
        ({"nb": [[0, 0], [1, 1]], "nf": 1}, "nb is 0 for all inputs of a"),
        ({"nb": 1, "nf": 0, "integrator": True}, "nf must be at least 1 with an integrator"),
        ({"nb": 1, "nf": 1, "integrator": "c"}, "there is no output 'c'"),
        ({"nb": 1, "nf": [[1, 2], [1, 1]], "shared": "denominator"}, "need one order nf"),
        ({"nb": 1, "nf": 1, "shared": "F"}, "shared='F' must be"),
        ({"nb": 1, "nf": 1, "initial": "x"}, "initial='x' must be"),
        ({"nb": 400, "nf": 1}, "needs at least"),
    ],
)
def test_orders_that_do_not_fit_are_refused(orders: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        armrig.oe(plant(), **orders)


def test_data_without_information_are_refused() -> None:
    rng = np.random.default_rng(1)
    u, y = inputs(rng), rng.normal(size=(N, 2))
    copies = Signals(u=np.column_stack([u, u[:, 0] - u[:, 1]]), y=y, Ts=1.0)
    still = Signals(u=u, y=np.column_stack([y[:, 0], np.full(N, 2.5)]), Ts=1.0)
    idle = Signals(u=np.column_stack([u[:, 0], np.ones(N)]), y=y, Ts=1.0)

    for data, message in (
        (copies, "the 3 inputs have rank 2"),
        (still, "y2 is always 2.5"),
        (idle, "u2 is always 1"),
    ):
        with pytest.raises(InputError, match=message):
            armrig.arx(data, na=1, nb=1)


def test_searches_that_end_at_one_minimum_keep_their_order() -> None:
    """A search may end lower than another by rounding only, differently on each processor."""
    ends = {"first": 2.0 + 1e-9, "higher": 2.1, "second": 2.0, "none": float("nan")}

    assert rank_ends(ends, ends.__getitem__) == ["first", "second", "higher", "none"]


def test_the_output_of_an_integrator_is_constant_without_an_input() -> None:
    rng = np.random.default_rng(3)
    u = inputs(rng, 1)[:, 0] + 0.2
    y = apply_filter([0, 0.1, 0.05], np.convolve([1, -1], [1, -0.9]), u) + 0.02 * rng.normal(size=N)
    fit = armrig.oe(Signals(u=u, y=y, Ts=0.1), nb=2, nf=2, integrator="y")
    pulse = np.zeros((100_000, 1))
    pulse[0] = 1.0

    simulated = fit.form.innovations_form().simulated(pulse)[:, 0]

    assert np.ptp(simulated[1000:]) < 1e-14 * abs(simulated[-1])


def test_few_samples_without_a_gap_before_them_leave_finite_deviations() -> None:
    """An autoregression of high order has no error that depends on no missing sample."""
    drawn = chassis_and_arm(14)

    fit = drawn.fit(drawn.signals(500, 0.2, (14, 500, 9)))

    assert np.isfinite(fit.covariance_robust).all()
    np.testing.assert_allclose(fit.std_robust[:4], fit.std[:4], rtol=0.2)


def test_the_best_minimum_is_chosen_with_the_covariance_of_the_noise() -> None:
    """With the variances of the outputs as weights, a pole of -0.99 has the least cost."""
    drawn = chassis_and_arm(14)

    fit = drawn.fit(drawn.signals(500, 0.2, (14, 500, 10)))

    assert fit.poles().values.real.min() > 0.2


def test_a_shared_denominator_leaves_a_local_minimum() -> None:
    """All starts from ARX models end at a pole of -0.92; a moved mode reaches the lower minimum."""
    drawn = chassis_and_arm(19)

    fit = drawn.fit(drawn.signals(500, 0.0, (19, 500, 0)))

    assert fit.search.starts[0].name == "chassis, arm: moved mode"
    assert fit.poles().values.real.min() > 0.2
