"""Validation of models of several signals: residuals, search, delay and feedback by channel."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import armrig
import numpy as np
import pytest
from armrig import MultivariableFit, Signals
from armrig.estimation import prediction_error
from armrig.numerics.polynomial import filtered
from armrig.validation.multivariable import feedback_and_delay
from armrig.validation.multivariable.projection import parts_of, projection
from armrig.validation.multivariable.residuals import residuals as residuals_of_several
from armrig_core.errors import InputError

from tests.plants import chassis_and_arm
from tests.sampling import sampled

N = 400


def plant(seed: int, *, missing: float = 0.0, cross: float = 0.5) -> Signals:
    """Return two outputs of two inputs; u2 reaches y1 one sample later than the other channels."""
    rng = np.random.default_rng([41, seed])
    u = np.repeat(np.sign(rng.standard_normal((N // 2, 2))), 2, axis=0)
    y = np.column_stack(
        [
            filtered([0, 1.0, 0.5], [1, -1.2, 0.5], u[:, 0]),
            filtered([0, 0.3], [1, -0.3], u[:, 0]) + filtered([0, 0.8], [1, -0.7], u[:, 1]),
        ]
    )
    y[:, 0] += cross * filtered([0, 0, 1.0], [1, -0.7], u[:, 1])
    y += rng.multivariate_normal([0, 0], [[0.04, 0.02], [0.02, 0.03]], N)
    valid = rng.random(y.shape) >= missing
    return Signals(u=u, y=y, Ts=0.1, valid=valid, inputs=["u1", "u2"], outputs=["y1", "y2"])


@cache
def estimated(seed: int, missing: float = 0.0, *, nk_12: int = 2) -> MultivariableFit:
    """Return the OE model of a plant, with the delay from u2 to y1."""
    orders: dict[str, Any] = {
        "nb": [[2, 1], [1, 1]],
        "nf": [[2, 1], [1, 1]],
        "nk": {("y1", "u2"): nk_12},
    }
    return armrig.oe(plant(seed, missing=missing), **orders)  # type: ignore[return-value]


def joint(test: Any) -> list[float]:
    return [test.white.p_value, test.missing_dynamics, test.feedback]


@pytest.mark.parametrize("missing", sampled([0.0, 0.2]))
def test_the_tests_of_a_true_model_pass(missing: float) -> None:
    p = []
    for seed in range(4):
        fit = estimated(seed, missing)
        for data in (plant(seed, missing=missing), plant(seed + 100, missing=missing)):
            p += joint(armrig.residuals(fit, data))

    assert min(p) > 0.0005
    assert 0.2 < np.mean(p) < 0.8


def test_the_residuals_of_a_joint_estimate_have_no_part_that_was_estimated() -> None:
    """Rows with orders of their own and correlated noise are weighted together."""
    data = plant(0)
    fit: Any = armrig.arx(data, na=[[2, 1], [0, 1]], nb=[[2, 1], [1, 2]])  # type: ignore[arg-type]
    (part,) = parts_of(fit, data)
    projected = projection([part], own=True)
    (B,), (WB,) = projected.B, projected.WB

    np.testing.assert_allclose(np.einsum("tir,tik->rk", B, WB), np.eye(projected.rank), atol=1e-9)
    # A part of the noise would be about 1. The initial state is the difference from 0.
    left = np.einsum("tir,ti->r", WB, np.nan_to_num(part.e))
    assert np.abs(left).max() < 0.05


@pytest.mark.parametrize("run", [10, 60])
def test_a_sum_that_the_estimate_determines_is_not_tested(run: int) -> None:
    """The poles are so quick that B nearly fits each lag. A rest of the ramp would be p < 1e-40."""
    drawn = chassis_and_arm(23)
    data = drawn.signals(500, 0.0, (23, 500, run, 0))

    found = armrig.residuals(drawn.fit(data), data)

    assert min(found.missing_dynamics_by_pair.ravel()) > 0.01


def test_several_experiments_are_tested_together() -> None:
    parts = [plant(seed)[: N // 2] for seed in (0, 1)]
    data = armrig.merge(parts)
    fit: Any = armrig.oe(data, nb=[[2, 1], [1, 1]], nf=[[2, 1], [1, 1]], nk={("y1", "u2"): 2})  # type: ignore[arg-type]

    found = armrig.residuals(fit, data)

    # No product of samples of two experiments is in a sum.
    e = [found.e[: N // 2], found.e[N // 2 :]]
    lag_3 = sum(x[3:].T @ x[:-3] for x in e) / np.sum(found.e**2, axis=0).prod() ** 0.5
    assert found.autocorrelation[0, 1, 3] == pytest.approx(lag_3[0, 1])
    for white, quality in zip(found.white_by_output, fit.quality, strict=True):
        assert white.p_value == pytest.approx(quality.white.p_value, rel=0.02)
    assert min(joint(found)) > 0.001


def test_a_delay_too_long_shows_only_in_its_pair() -> None:
    found = armrig.residuals(estimated(0, nk_12=3), plant(100))

    assert found.missing_dynamics < 1e-6
    p = found.missing_dynamics_by_pair
    assert p[0, 1] < 1e-6
    assert min(p[0, 0], p[1, 0], p[1, 1]) > 1e-3
    assert "u2 to y1: dynamics missing (p < 0.001)" in repr(found)
    pair = found["y1", "u2"]
    assert pair.missing_dynamics == p[0, 1]
    np.testing.assert_array_equal(pair.correlation, found.cross_correlation[0, 1])
    with pytest.raises(InputError, match="no channel; give an output of y1 and y2 and an input of"):
        found["u2", "y1"]


def test_only_the_joint_test_rejects_delayed_common_noise() -> None:
    """y2 contains the noise of y1 three samples later: each output alone is white."""
    data, other = plant(0), plant(100)
    rng = np.random.default_rng(5)
    parts = []
    for signals in (data, other):
        e = 0.4 * rng.standard_normal(N + 3)
        y = signals.y + np.column_stack([e[3:], e[:N]])
        parts.append(signals.replaced(step=None, y=y))
    nk = {("y1", "u2"): 2}
    fit: Any = armrig.oe(parts[0], nb=[[2, 1], [1, 1]], nf=[[2, 1], [1, 1]], nk=nk)  # type: ignore[arg-type]

    found = armrig.residuals(fit, parts[1])

    assert found.white.p_value < 1e-6
    assert all(white.p_value > 0.01 for white in found.white_by_output)


def test_an_input_that_follows_an_output_shows_as_feedback() -> None:
    rng = np.random.default_rng(8)
    e = 0.5 * rng.standard_normal(N)
    u = np.sign(rng.standard_normal((N, 2)))
    v = filtered([1.0], [1, -0.8], e)
    u[:, 1] += np.append(0.0, v[:-1])  # u2 follows the noise of y
    y = filtered([0, 1.0], [1, -0.5], u[:, 0]) + filtered([0, 0.5], [1, -0.5], u[:, 1]) + v
    data = Signals(u=u, y=y[:, None], Ts=0.1, inputs=["u1", "u2"], outputs=["y"])
    fit: Any = armrig.oe(data, nb=1, nf=1)

    found = armrig.residuals(fit, data)

    assert found.feedback_by_pair[0, 1] < 1e-4
    assert found.feedback_by_pair[0, 0] > 1e-3
    assert armrig.open_loop(data)["y", "u2"].feedback  # type: ignore[index]
    assert not armrig.open_loop(data)["y", "u1"].feedback  # type: ignore[index]


def test_the_prediction_error_of_a_long_angle_is_its_noise() -> None:
    """Its initial state and ramp are a million times its noise, so that each digit counts."""
    rng = np.random.default_rng(3)
    n = 2000
    u = np.repeat(rng.choice([0.0, 5.0], n // 10), 10)
    B, F = [0, 0.004, 0.003], np.poly([0.91 + 0.16j, 0.91 - 0.16j, 0.69]).real
    rate = filtered(B, F, u)
    y = np.column_stack([np.cumsum(rate), rate])
    y += 1e-4 * rng.standard_normal(y.shape)
    data = Signals(u=u[:, None], y=y, Ts=0.01, inputs=["u"], outputs=["angle", "rate"])
    fit: Any = armrig.oe(data, nb=2, nf=3, integrator="angle", shared="denominator")  # type: ignore[call-arg, arg-type]

    later = data[137:]  # in the middle of a movement
    e = later.y - fit.predict(later, None)

    np.testing.assert_allclose(np.std(e, axis=0), 1e-4, rtol=0.1)


def test_each_channel_has_a_separate_delay() -> None:
    found = armrig.delay(plant(1))

    nk = {name: found[name].nk for name in found}  # type: ignore[attr-defined, index]
    assert nk == {("y1", "u1"): 1, ("y1", "u2"): 2, ("y2", "u1"): 1, ("y2", "u2"): 1}
    assert repr(found).startswith("u1 to y1: nk = 1")


def test_a_channel_without_a_response_has_a_reason() -> None:
    found: Any = armrig.delay(plant(1, cross=0.0))

    assert len(found) == 3
    with pytest.raises(InputError, match="u2 to y1: "):
        found["y1", "u2"]
    with pytest.raises(InputError, match="there is no such channel"):
        found["y9", "u2"]


def test_the_search_chooses_the_order_of_the_plant() -> None:
    data = plant(2, cross=0.0)  # poles: a pair, 0.3, 0.7
    done: list[str] = []

    found: Any = armrig.search(
        data,
        plant(102, cross=0.0),  # type: ignore[arg-type]
        families=["ss"],  # type: ignore[list-item]
        orders=(3, 4, 5),
        progress=lambda k, n, name: done.append(f"{k} of {n} {name}"),
    )

    assert found.chosen.name == "ss of order 4"
    assert found.fit.estimated_from(data)
    assert done == [
        "0 of 3 ss of order 3",
        "1 of 3 ss of order 4",
        "2 of 3 ss of order 5",
        "3 of 3 ",
    ]
    assert "  chosen" in repr(found)


@pytest.mark.parametrize("missing", [0.0, 0.1])
def test_a_state_space_has_no_k_if_samples_are_missing(missing: float) -> None:
    found: Any = armrig.search(plant(2, missing=missing), families=["ss"], orders=[2])

    assert found.fit.form.K.any() == (not missing)


@pytest.mark.exhaustive
def test_the_search_finds_the_integrator_of_one_output() -> None:
    rng = np.random.default_rng(3)
    u = np.repeat(np.sign(rng.standard_normal(N // 4)), 4)
    rate = filtered([0, 0.4, 0.2], np.poly([0.8, 0.5]), u)
    y = np.column_stack([np.cumsum(rate), rate]) + 0.05 * rng.standard_normal((N, 2))
    data = Signals(u=u[:, None], y=y, Ts=0.1, outputs=["angle", "rate"])

    found: Any = armrig.search(data, integrator="angle", orders=(1, 2, 3))  # type: ignore[arg-type]

    assert found.chosen.name == "oe of order 2"
    assert found.fit.form.integrators == (True, False)


def test_every_family_of_a_search_has_all_orders_of_an_iterator() -> None:
    found: Any = armrig.search(plant(0), families=["n4sid", "oe"], orders=iter((1, 2)))

    tried = {(c.family, c.order) for c in (*found.ranked, *found.failed)}
    assert tried == {("n4sid", 1), ("n4sid", 2), ("oe", 1), ("oe", 2)}


def test_unknown_families_and_too_high_orders_are_refused() -> None:
    with pytest.raises(InputError, match="families has 'arx'; each must be one of ss, n4sid, oe"):
        armrig.search(plant(0), families=["arx"])
    with pytest.raises(InputError, match="none of the models could be estimated"):
        armrig.search(plant(0)[:20], orders=[9])


def test_a_search_needs_every_input_to_change_in_both_parts() -> None:
    data = plant(0)
    u = np.column_stack([data.u[:, 0], np.where(np.arange(data.N) < 9, 0.0, 1.0), data.u[:, 1:]])
    rests = Signals(u=u, y=data.y, Ts=1.0)

    with pytest.raises(InputError, match="u moves in one part of the data only"):
        armrig.search(rests, families=["oe"], orders=[1])


def test_each_output_has_separate_orders() -> None:
    rng = np.random.default_rng(6)
    u = rng.standard_normal((N, 2))
    y = np.column_stack(
        [
            filtered([0, 1.0], [1, -1.2, 0.5], u[:, 0])
            + filtered([0, 0.5], [1, -1.2, 0.5], u[:, 1])
            + filtered([0.2], [1, -1.2, 0.5], rng.standard_normal(N)),
            filtered([0, 0, 1.0, 0.5], [1, -0.7], u[:, 1])
            + filtered([0, 0, 0.3], [1, -0.7], u[:, 0])
            + filtered([0.2], [1, -0.7], rng.standard_normal(N)),
        ]
    )
    data = Signals(u=u, y=y, Ts=0.1, outputs=["a", "b"])

    found: Any = armrig.select_orders(data, range(1, 5), range(1, 5), range(4))

    assert found.best("mdl") == {
        "na": [[2, 0], [0, 1]],
        "nb": [[1, 1], [2, 2]],
        "nk": [[1] * 2, [2] * 2],
    }
    fit: Any = armrig.arx(data, **found.best("mdl"))  # type: ignore[arg-type]
    table = found["b"]
    at = int(np.flatnonzero((table.na == 1) & (table.nb == 2) & (table.nk == 2))[0])
    np.testing.assert_allclose(table.loss[at], fit.quality[1].loss, rtol=0.02)
    assert table.parameters[at] == 5
    assert len(found) == 2
    assert repr(found).startswith("a:\n- chosen")


@pytest.mark.parametrize("seed", [1])
def test_with_few_samples_one_output_has_the_whiteness_test_of_a_dataset(seed: int) -> None:
    """To the digits, on the estimation data and on others."""
    parts = []
    for k in (seed, seed + 10):
        rng = np.random.default_rng(k)
        u = rng.standard_normal(50)
        y = filtered([0, 1, 0.5], [1, -1.2, 0.6], u) + 0.5 * rng.standard_normal(50)
        parts.append(
            (armrig.Dataset(u=u, y=y, Ts=1.0), Signals(u=u[:, None], y=y[:, None], Ts=1.0))
        )
    fit, several = (
        armrig.oe(parts[0][0], nb=2, nf=2),
        prediction_error.estimated(parts[0][1], "oe", {"nb": 2, "nf": 2, "nk": 1}),
    )

    for one, signals in parts:
        white = residuals_of_several(several, signals, 6).white

        assert white.p_value == pytest.approx(armrig.residuals(fit, one, 6).whiteness, rel=1e-6)


@pytest.mark.parametrize("factor", [100.0])
def test_the_allowance_is_a_factor_of_deviations(factor: float) -> None:
    """The variance of the parameters is added to that of the noise."""
    fit, data = estimated(0), plant(100)
    wide = replace(fit, covariance_robust=factor * fit.covariance_robust)

    sure, unsure = (armrig.residuals(one, data).allowance for one in (fit, wide))

    assert unsure**2 - 1 == pytest.approx(factor * (sure**2 - 1), rel=1e-3)


def test_sums_and_deviations_of_each_pair_are_those_of_its_signals() -> None:
    """Correlation of e_i(t) with u_j(t - k), and its deviation about 1/sqrt(N) for white e."""
    fit, data = estimated(0), plant(100)

    found = armrig.residuals(fit, data, 5)

    e, u = np.nan_to_num(found.e), data.u - data.u.mean(axis=0)
    for i, j, k in ((0, 1, 3), (1, 0, -4), (0, 0, 0), (1, 1, 5)):
        late, early = max(k, 0), max(-k, 0)
        x, z = e[late : N - early, i], u[early : N - late, j]
        expected = (x @ z) / np.sqrt(np.sum(e[:, i] ** 2) * np.sum(u[:, j] ** 2))
        at = int(np.flatnonzero(found.cross_lags == k)[0])
        assert found.cross_correlation[i, j, at] == pytest.approx(expected, abs=1e-9)
    np.testing.assert_allclose(found.cross_std, 1 / np.sqrt(N), rtol=0.5)


def test_given_weights_of_the_outputs_are_those_of_the_projection() -> None:
    """The estimator minimised the sum of w_i e_i²."""
    fit = replace(estimated(0), output_weights=(2.0, 8.0))

    (part,) = parts_of(fit, plant(0))

    weights = np.einsum("tij,tik->tjk", part.G, part.G)
    np.testing.assert_allclose(weights, np.broadcast_to(np.diag([2.0, 8.0]), weights.shape))


def test_a_model_of_all_inputs_has_at_most_a_fifth_of_its_rows_as_parameters() -> None:
    """As many parameters as rows fit noise exactly, and would be chosen for it."""
    rng = np.random.default_rng(1)
    data = Signals(u=rng.standard_normal((60, 2)), y=rng.standard_normal((60, 1)), Ts=0.1)

    (block,) = feedback_and_delay._best_blocks([*data.experiments()], "y1")

    assert block.shape[1] - 1 <= 60 / 5
    with pytest.raises(InputError, match="too few samples of y1 for an ARX model"):
        feedback_and_delay._best_blocks([data[:24]], "y1")
