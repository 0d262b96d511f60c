"""Delays and tests for feedback made by hand: their words, and the numbers in them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import armrig
import numpy as np
import pytest
from armrig import telegraph
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.numerics.polynomial import Array, apply_filter
from armrig.validation.feedback_and_delay.delay import (
    _hiding_time_s,
    count_determined_lags,
    delay,
)
from armrig.validation.feedback_and_delay.lag_tests import LEVEL, LagTests, _average_input, possible
from armrig.validation.feedback_and_delay.open_loop import _is_exact, _remarks, open_loop
from armrig.validation.feedback_and_delay.sims import FUTURE, sims
from armrig_core.errors import InputError
from scipy.special import ndtr


def of_lags(p_values: Any, coefficient: Any, std: Any, answer: Any, first: int = 0) -> LagTests:
    arrays = [np.array(x, float) for x in (p_values, coefficient, std, answer)]
    return LagTests(
        first=first, p_values=arrays[0], p_without_one=arrays[0], coefficient=arrays[1],
        std=arrays[2], loss=np.ones(len(p_values)), responses=(arrays[3],), A=np.ones(1),
        effect=np.diag(1 / arrays[2]), N=100,
    )  # fmt: skip


@pytest.mark.parametrize("first", [0, 1])
def test_the_bound_of_an_overlooked_coefficient_is_a_share_of_later_ones(first: int) -> None:
    """At lag k the bound is the largest of g(k + n)/(1 + 3 n), if the onset is not smoother."""
    p, b, std = [0.5, 0.4, 1e-6, 1e-9], [0.01, 0.02, 1.0, 4.0], [0.1, 0.2, 0.1, 0.1]
    g = [0.0] * (2 + first) + [2.0, 3.0, 16.0, 1.0]
    tests = of_lags(p, b, std, g, first)

    before = tests.before(first + 1)

    # s = 2, 5, 21: log s rises by log(21/5)/log(4/3) at most; s(shown)/2^d.
    d = max(np.log(5 / 2) / np.log(3 / 2), np.log(21 / 5) / np.log(4 / 3))
    least = min(max(2 / 4, 3 / 7, 16 / 10, 1 / 13), 2 / 2**d)
    assert tests.shown == first + 2
    assert (before.k, before.found) == (first + 1, pytest.approx(0.02 / 0.2))
    assert before.predicted == pytest.approx(least / 0.2)
    assert before.p_value == pytest.approx(ndtr(before.found - before.predicted))
    steep = of_lags(p, b, std, [0.0] * (2 + first) + [2.0, 0.5, 0.1], first).before(first + 1)
    assert steep.predicted == pytest.approx(min(2 / 4, 2 / 2) / 0.2)


def test_lags_are_ruled_out_in_turn_below_the_first_significant_lag() -> None:
    p, g = [0.5, 0.4, 0.3, 1e-6], [0.0, 0.0, 0.0, 4.0, 4.0, 4.0]

    for std, least in (([0.01] * 4, 3), ([0.01, 0.01, 2.0, 0.1], 2), ([0.01, 2.0, 2.0, 0.1], 1)):
        tests = of_lags(p, [0.0, 0.0, 0.0, 4.0], std, g)
        assert (tests.shown, tests.least(), tests.none_shown) == (3, least, False)
    wide = of_lags(p, [0.0] * 4, [2.0] * 4, g)
    assert wide.least() == 0
    later = of_lags(p[1:], [0.0] * 3, [2.0] * 3, g, first=1)
    assert (later.shown, later.least()) == (3, 1)
    nothing = of_lags([0.5, 0.001], [0.0] * 2, [1.0] * 2, [0.0] * 4)
    assert (nothing.shown, nothing.none_shown) == (2, True)


def test_an_onset_that_no_single_lag_rules_out_is_ruled_out_by_all_of_them() -> None:
    tests = of_lags([0.5, 0.4, 0.3, 1e-6], [0.0, 0.0, 0.0, 4.0], [0.35] * 4, [0.0] * 3 + [4.0] * 3)

    # s = 4, 8, 12 from lag 3 on: the onset at lag 1 is 4 ((j/3)^d), d = log(2)/log(4/3).
    d = np.log(2) / np.log(4 / 3)
    mean = 4 * np.diff([0, (1 / 3) ** d, (2 / 3) ** d]) / 0.35
    assert min(tests.before(k).p_value for k in (0, 1, 2)) > LEVEL
    assert tests._p_value_of_onset(1) == pytest.approx(float(ndtr(-np.linalg.norm(mean))))
    assert tests.least() == 2


def test_the_interval_of_a_dead_time_is_short_and_contains_the_truth() -> None:
    inside = short = 0
    for seed in range(20):
        rng = np.random.default_rng([187, seed])
        nk, poles = int(rng.integers(1, 80)), rng.uniform(0.3, 0.9, 2)
        u = telegraph(1500, 0.1, seed=seed)
        late = np.concatenate([np.full(nk, u[0]), u[:-nk]]) - u.mean()
        y = apply_filter(np.array([1.0, 0.5]), np.poly(poles), late)
        y += np.std(y) / 5 * rng.standard_normal(u.size)
        first, last = delay(Dataset(u=u, y=y, Ts=1.0)).interval
        inside += first <= nk <= last
        short += last - first < 3

    assert inside >= 19
    assert short >= 12  # 8 if each lag is tested alone


@pytest.mark.parametrize("smooth", ["slew", "lag"])
def test_a_smooth_input_shows_no_dead_time_that_is_not_there(smooth: str) -> None:
    """Three poles respond slowly; later lags of a smooth input take the part of earlier ones."""
    F = np.poly(np.exp([-0.1, -0.15, -0.2]))
    wrong = 0
    for seed in range(20):
        rng = np.random.default_rng([87, seed])
        u = np.repeat(rng.choice([0.0, 4.0], 40), 25)
        if smooth == "lag":
            u = apply_filter([0.1], [1, -0.9], u)
        else:
            for k in range(1, u.size):
                u[k] = u[k - 1] + np.clip(u[k] - u[k - 1], -0.2, 0.2)
        y = apply_filter([0.0, 1.0, 3.6, 0.8], F, u)
        y += 0.02 * np.std(y) * rng.standard_normal(u.size)
        first, last = delay(Dataset(u=u, y=y, Ts=0.1)).interval
        wrong += not first <= 1 <= last

    assert wrong <= 2


@pytest.mark.parametrize(
    ("misfit", "expected"),
    [
        ({1: 2.0, 2: 50.0}, (1, 1)),
        ({1: 9.2, 2: 1.0, 3: 9.3}, (1, 2)),
        ({1: 19.0, 2: 2.0, 3: 17.0}, (2, 3)),
        ({0: 300.0, 1: 95.0, 2: 40.0, 3: 30.0, 4: 271.0}, (1, 3)),
        ({2: 12.0, 3: 12.0}, (2, 3)),
    ],
)
def test_a_lag_is_possible_below_its_limit_or_near_the_best(
    misfit: dict[int, float], expected: tuple[int, int]
) -> None:
    """Chi² below 9.21, or below nine times the least."""
    assert possible(misfit) == expected


def test_a_smooth_onset_averages_within_each_experiment() -> None:
    parts = [Dataset(u=u, y=np.zeros(3), Ts=1.0) for u in ([1.0, 3.0, 7.0], [10.0, 20.0, 0.0])]

    averaged = _average_input(merge(parts))

    assert averaged.u.tolist() == [1.0, 2.0, 5.0, 10.0, 15.0, 10.0]


def test_quantisation_hides_an_angle_until_its_largest_response_passes_a_step() -> None:
    """The response passes the step 0.5 at its third sample, 0.3 s after the change of u."""
    rise = np.array([0.2, 0.4, 0.6, 1.8, 5.4])
    for output in ("theta_1", "alpha", "speed"):
        data = Dataset(u=np.zeros(9), y=np.zeros(9), Ts=0.1, output=output)

        hidden = _hiding_time_s(data, rise, 0.5)

        expected = None if output == "speed" else pytest.approx(0.3 * np.sqrt(0.5 / 0.6))
        assert hidden == expected
        assert _hiding_time_s(data, rise, 0.0) is None


def test_missing_samples_are_not_enough_samples() -> None:
    valid = np.arange(60) >= 11
    data = Dataset(u=np.zeros(60), y=np.zeros(60), Ts=1.0, valid=valid)

    with pytest.raises(InputError, match="needs at least 50 samples, got 49: record longer"):
        armrig.delay(data)


def test_an_input_of_few_sines_determines_few_lags() -> None:
    rng = np.random.default_rng(2)
    t = np.arange(800)
    sines = sum(np.cos(w * t + w) for w in np.linspace(0.2, 3.0, 16))

    assert count_determined_lags(Dataset(u=rng.standard_normal(800), y=t * 0.0, Ts=1.0), 60) == 60
    found_ = count_determined_lags(Dataset(u=5.0 + np.asarray(sines), y=t * 0.0, Ts=1.0), 60)
    assert found_ in (32, 33)
    few = sum(np.cos(w * t + w) for w in np.linspace(0.2, 3.0, 5))
    with pytest.raises(InputError, match="u determines 10 lags only: the band of u is too narrow"):
        count_determined_lags(Dataset(u=np.asarray(few), y=t * 0.0, Ts=1.0), 60)


@pytest.mark.parametrize(
    ("p", "later", "exact", "direct"),
    [
        (0.002, 0.05, False, True),
        (0.002, 0.0499, False, False),
        (0.05, 0.3, False, False),
        (0.002, 0.3, True, False),
    ],
)
def test_a_direct_term_may_be_the_cause_if_no_later_input_depends_on_y(
    p: float, later: float, exact: bool, direct: bool
) -> None:
    u, y = np.random.default_rng(4).standard_normal((2, 400))
    found = open_loop(Dataset(u=u, y=y, Ts=1.0))
    s: Any = replace(found.sims, p_value=p, p_later=later)  # type: ignore[type-var]

    assert replace(found, sims=s, exact=exact).may_be_direct_term is direct
    remarks = _remarks(s, 0.05, exact=exact)
    assert any("nk = 0" in remark for remark in remarks) is direct
    assert any("P controller" in remark for remark in remarks) is exact


def test_an_exact_relation_need_not_hold_at_missing_samples() -> None:
    rng = np.random.default_rng(3)
    y = rng.standard_normal(50)
    valid = np.arange(50) % 7 != 3
    u = np.where(valid, 2.0 - 3.0 * y, 9.0)

    assert _is_exact(Dataset(u=u, y=np.where(valid, y, 77.0), Ts=1.0, valid=valid))
    assert not _is_exact(Dataset(u=u, y=y, Ts=1.0))
    assert not _is_exact(Dataset(u=np.ones(50), y=y, Ts=1.0))
    assert not _is_exact(Dataset(u=u, y=np.ones(50), Ts=1.0))


@pytest.mark.parametrize(("levels", "few"), [(2, True), (20, True), (21, False)])
def test_an_input_of_at_most_20_levels_has_few(levels: int, few: bool) -> None:
    rng = np.random.default_rng(4)
    u = rng.permutation(np.tile(np.arange(levels), 400)[:400]).astype(float)

    test = open_loop(Dataset(u=u, y=rng.standard_normal(400), Ts=1.0, unit="rad", input_unit="V"))

    assert test.few_levels is few
    assert (test.unit, test.input_unit, test.Ts) == ("rad", "V", 1.0)


def regressors(data: Dataset, p: int) -> tuple[Array, Array]:
    """Return the regressors of Sims' test as its docstring has them, and y, in its rows."""
    rows, left = [], []
    parts = list(data.experiments())
    for i, part in enumerate(parts):
        u = part.u
        sums = []
        for k in (0.0, 1 / 3, 1.0):
            w = np.zeros(part.N)
            for t in range(1, part.N):
                w[t] = (1 - k / p) * w[t - 1] + u[t - 1] - u.mean()
            sums.append(w)
        y = np.interp(np.arange(part.N), np.flatnonzero(part.valid), part.y[part.valid])
        for t in range(p, part.N - FUTURE + 1):
            if not part.valid[t]:
                continue
            rows.append(
                [
                    *(float(i == j) for j in range(len(parts))),
                    *(y[t - k] for k in range(1, p + 1)),
                    *(u[t - k] for k in range(1, p + 1)),
                    *(w[t - p] for w in sums),
                    *(u[t + k] for k in range(FUTURE)),
                ]
            )
            left.append(part.y[t])
    return np.array(rows), np.array(left)


def test_sims_test_is_the_regression_of_its_docstring() -> None:
    """Two experiments of other lengths and levels, with short gaps."""
    from scipy.stats import f

    parts = []
    for seed, N in ((1, 150), (2, 120)):
        rng = np.random.default_rng(seed)
        u = rng.standard_normal(N)
        y = 5.0 * seed + apply_filter([0.3, 1.0], [1.0, -0.6], u) + rng.standard_normal(N)
        valid = np.ones(N, dtype=bool)
        valid[[70, 71, 90]] = False
        parts.append(Dataset(u=u, y=y, Ts=1.0, valid=valid))
    data = merge(parts)

    found_ = sims(data)

    Phi, y = regressors(data, found_.p)
    d = Phi.shape[1] - FUTURE
    assert (found_.N, found_.q) == (y.size, FUTURE)
    degrees = y.size - Phi.shape[1]
    rss = {}
    for k in (d, d + 1, Phi.shape[1]):
        theta = np.linalg.lstsq(Phi[:, :k], y, rcond=None)[0]
        rss[k] = float(np.sum((y - Phi[:, :k] @ theta) ** 2))
    V = rss[Phi.shape[1]] / degrees
    F = (rss[d] - rss[Phi.shape[1]]) / FUTURE / V
    F_later = (rss[d + 1] - rss[Phi.shape[1]]) / (FUTURE - 1) / V
    assert found_.degrees == degrees
    assert pytest.approx(F, rel=1e-7) == found_.F
    assert found_.p_value == pytest.approx(f.sf(F, FUTURE, degrees), rel=1e-6)
    assert found_.p_later == pytest.approx(f.sf(F_later, FUTURE - 1, degrees), rel=1e-6)
    assert found_.explained == pytest.approx(1 - rss[Phi.shape[1]] / rss[d])
    assert found_.lags.tolist() == list(range(-4, found_.p + 1))
    std = np.sqrt(V * np.diag(np.linalg.inv(Phi.T @ Phi)))
    begin = len(parts) + found_.p
    order = [*range(Phi.shape[1] - 1, d - 1, -1), *range(begin, begin + found_.p)]
    np.testing.assert_allclose(found_.coefficients, theta[order], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found_.std, std[order], rtol=1e-6)
