"""Inputs that follow y(t), and held inputs whose changes y does not explain."""

from __future__ import annotations

from collections.abc import Callable

import armrig
import numpy as np
import pytest
from armrig.validation.feedback_and_delay.held_input import may_follow_output
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import lfilter

N = 1000
Vector = NDArray[np.float64]


def _with_direct_term(u: Vector, rng: Generator) -> armrig.Dataset:
    y = np.zeros(N)
    for t in range(N):
        y[t] = (0.9 * y[t - 1] if t else 0.0) + 0.1 * u[t]
    return armrig.Dataset(u=u, y=y + 0.05 * rng.standard_normal(N), Ts=1.0)


def _under_a_relay(rng: Generator) -> armrig.Dataset:
    y, u, x, side = np.zeros(N), np.zeros(N), 0.0, 1.0
    for t in range(N):
        y[t] = x + 0.03 * rng.standard_normal()
        wanted = 0.5 if t % 200 < 100 else -0.2
        if abs(y[t] - wanted) > 0.1:
            side = float(np.sign(wanted - y[t]))
        u[t], x = side, 0.95 * x + 0.1 * side
    return armrig.Dataset(u=u, y=y, Ts=1.0)


def _under_a_controller(rng: Generator) -> armrig.Dataset:
    y, u, x = np.zeros(N), np.zeros(N), 0.0
    for t in range(N):
        y[t] = x + 0.1 * rng.standard_normal()
        u[t] = 2.0 * ((t // 100) % 2 - y[t])
        x = 0.9 * x + 0.1 * u[t]
    return armrig.Dataset(u=u, y=y, Ts=1.0)


@pytest.mark.parametrize("name", ["telegraph", "prbs", "held"])
def test_an_input_that_is_held_without_y_is_free(name: str) -> None:
    """At the level 1 %, two of 20 free inputs are called doubtful in 2 % of all runs."""
    found = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        u = {
            "telegraph": armrig.telegraph(N, 0.1, 0.0, 1.0, seed=seed),
            "prbs": armrig.prbs(N, 5, 0.0, 1.0, seed=seed + 1),
            "held": np.repeat(rng.uniform(-1, 1, N // 10), 10),
        }[name]
        found.append(may_follow_output(_with_direct_term(u, rng)))

    assert sum(found) <= 2


@pytest.mark.parametrize("loop", [_under_a_relay, _under_a_controller])
def test_an_input_that_follows_y_is_not_free(loop: Callable[[Generator], armrig.Dataset]) -> None:
    assert sum(may_follow_output(loop(np.random.default_rng(seed))) for seed in range(20)) >= 19


def test_an_input_with_few_changes_may_follow_y() -> None:
    u = armrig.step(N, at=100)

    assert may_follow_output(_with_direct_term(u, np.random.default_rng(1)))


def test_a_search_in_a_closed_loop_tries_neither_a_direct_term_nor_iv4() -> None:
    """A PI controller with noise of an autoregression: its y(t) looks like a direct term."""
    rng, x, total = np.random.default_rng([92, 1]), 0.0, 0.0
    wanted = np.repeat(rng.choice([-1.0, 0.0, 1.0], 20), 40)
    v = lfilter([0.05], [1, -0.9], rng.standard_normal(800))
    u, y = np.zeros(800), np.zeros(800)
    for t in range(800):
        y[t] = x + v[t]
        total += 0.15 * (wanted[t] - y[t])
        u[t] = 2 * (wanted[t] - y[t]) + total
        x = 0.9 * x + 0.1 * u[t]
    data = armrig.Dataset(u=u, y=y, Ts=0.01)

    found = armrig.search(data, orders=[1])
    allowed = armrig.search(data, families=["arx"], orders=[1, 2], open_loop=True)

    assert "nk=0" not in found.fit.heading
    assert not any("IV4" in model.candidate.name for model in found.ranked)
    assert any("nk = 0 was not tried" in note for note in found.notes)
    assert not any("nk = 0 was not tried" in note for note in allowed.notes)


def test_all_data_decide_whether_a_search_tries_a_direct_term(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The half that estimates has too few changes of u for the tests."""
    sizes, rng = list[int](), np.random.default_rng(2)

    def free(data: armrig.Dataset) -> bool:
        sizes.append(data.N)
        return False

    data = _with_direct_term(np.repeat(rng.uniform(-1, 1, N // 10), 10), rng)
    monkeypatch.setattr("armrig.validation.model_search.may_follow_output", free)

    found = armrig.search(data, families=["arx"], orders=[1])

    assert sizes == [N]
    assert found.fit.heading == "ARX(na=1, nb=1, nk=0)"
