"""Whether the rig ran in open loop: what is called feedback, how often, and what is not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset, merge
from armrig.excitation import telegraph
from armrig.validation.feedback_and_delay.granger import granger
from armrig_core.arm import ArmParameters, arm_matrices, zero_order_hold

if TYPE_CHECKING:
    from handout_plant import HandoutPlant


def under_feedback(seed: int, K: float = 1.0, N: int = 1500) -> Dataset:
    """Return the arm under u = -K theta_1 + d, d a telegraph of ±2.5 V."""
    rng = np.random.default_rng([seed, 3])
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, 0.01)
    d = telegraph(N, 0.05, 0.0, 5.0, seed=rng) - 2.5
    noise = 5e-3 * rng.standard_normal(N)
    x, u, y = np.zeros(4), np.empty(N), np.empty(N)
    for k in range(N):
        y[k] = C[0] @ x + noise[k]
        u[k] = d[k] - K * y[k]
        x = Phi @ x + Gamma[:, 0] * u[k]
    return Dataset(u=u, y=y, Ts=0.01, output="theta_1", unit="rad")


def test_open_loop_is_called_closed_as_often_as_the_level_says(plant: HandoutPlant) -> None:
    """200 runs at 5 %: 10 alarms are meant, and half of the p values lie below one half.

    The level over 5000 runs is measured by tests/benchmarks/open_loop_and_delay.py.
    """
    p = np.array([granger(plant.dataset(seed, N=1500)).p_value for seed in range(200)])

    assert 3 <= np.count_nonzero(p < 0.05) <= 22
    assert 0.4 < np.mean(p < 0.5) < 0.6


def test_feedback_of_the_angle_is_found() -> None:
    """Twenty of twenty, with a dither of the size of the open loop's input."""
    found = [granger(under_feedback(seed)).p_value < 0.05 for seed in range(20)]

    assert sum(found) == 20


def test_one_test_decides_and_the_others_stand_beside_it(plant: HandoutPlant) -> None:
    """The decision is that of the F-test at the level asked for, whatever the others say."""
    data = plant.dataset(1)
    p = granger(data).p_value

    for level in (0.999 * p, 1.001 * p):
        found = armrig.open_loop(data, level)
        assert found.p_value == p
        assert found.feedback == (level > p)
        assert [0 <= t.p_value <= 1 for t in found.others] == [True] * 3


def test_an_explanation_says_what_was_found_and_its_limits(plant: HandoutPlant) -> None:
    """Both ways."""
    free, fed = armrig.open_loop(plant.dataset(2)), armrig.open_loop(under_feedback(2))

    assert "nothing speaks against open loop" in free.explain()
    assert "no proof" in free.explain()
    assert "there is feedback" in fed.explain()
    assert "do not decide" in fed.explain()


def test_missing_samples_cost_only_the_rows_that_they_touch(plant: HandoutPlant) -> None:
    """One hole takes the row after it; its own row needs no y."""
    whole = plant.dataset(3)
    valid = np.ones(whole.N, dtype=bool)
    valid[1000] = False
    holed = Dataset(u=whole.u, y=whole.y, Ts=whole.Ts, valid=valid, output="theta_1", unit="rad")

    assert granger(whole).lags == granger(holed).lags == 1
    assert granger(holed).N == granger(whole).N - 1


def test_nothing_is_carried_from_one_experiment_to_the_next(plant: HandoutPlant) -> None:
    """Neither where each began to count its angle matters, nor the level of its input."""
    parts = [plant.dataset(seed, N=1000) for seed in (4, 5)]
    moved = parts[1].replaced(y=parts[1].y + 1000.0, u=parts[1].u + 100.0, step=None)

    together, apart = granger(merge(parts)), granger(merge([parts[0], moved]))

    assert 2 * (1000 - together.lags) == together.N
    assert apart.p_value == pytest.approx(together.p_value, rel=1e-6)


def test_an_input_that_follows_from_its_own_past_is_refused(plant: HandoutPlant) -> None:
    """Of a sine nothing is left that y could explain."""
    u = 2.5 + np.sin(0.05 * np.arange(1000))
    data = Dataset(u=u, y=plant.angle(u), Ts=0.01, output="theta_1")

    with pytest.raises(ValueError, match="u follows from its own past"):
        armrig.open_loop(data)


def test_too_few_samples_are_refused(plant: HandoutPlant) -> None:
    """With the number that is needed."""
    with pytest.raises(ValueError, match=r"needs 105 such"):
        granger(plant.dataset(1, N=100))


def test_an_impossible_level_is_refused(plant: HandoutPlant) -> None:
    """It is a probability."""
    with pytest.raises(ValueError, match=r"level=5 must lie between 0 and 1"):
        armrig.open_loop(plant.dataset(1), level=5)


def test_an_angle_without_a_steady_turn_is_told() -> None:
    """The F distribution rests on the ramp."""
    rng = np.random.default_rng(1)
    u = rng.standard_normal(1000)
    y = np.cumsum(u) * 0.01 + 0.001 * rng.standard_normal(1000)
    still = Dataset(u=u - u.mean(), y=y - np.linspace(0, y[-1], 1000), Ts=0.01, output="theta_1")

    assert any("does not turn" in r for r in armrig.open_loop(still).remarks)


def test_a_rate_is_told_to_be_the_wrong_output(plant: HandoutPlant) -> None:
    """What a controller of the angle feeds back is hardly in it."""
    data = plant.dataset(1, N=500)
    rate = np.diff(data.y, prepend=data.y[0]) / data.Ts
    found = armrig.open_loop(data.replaced(y=rate, output="velocity", unit="rad/s", step=None))

    assert any("test theta_1" in r for r in found.remarks)
