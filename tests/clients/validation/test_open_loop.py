"""The test for open loop: its verdicts and their rates."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from typing import TYPE_CHECKING

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.excitation import multisine, prbs, telegraph
from armrig.numerics.polynomial import apply_filter
from armrig.validation.feedback_and_delay.sims import Sims, sims
from armrig_core.rig.arm import ArmParameters, arm_matrices, zero_order_hold
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant

Vector = NDArray[np.float64]
Draw = Callable[[np.random.Generator], Vector]


def under_feedback(seed: int, K: float = 3.0, N: int = 1000, std: float = 0.05) -> Dataset:
    """Return the arm under u = -K theta_1 + d, d a telegraph of ±2.5 V."""
    rng = np.random.default_rng([seed, 3])
    d = telegraph(N, 0.05, 0.0, 5.0, seed=rng) - 2.5
    return controlled(lambda k, y: d[k] - K * y, std * rng.standard_normal(N))


def controlled(law: Callable[[int, float], float], noise: Vector) -> Dataset:
    """Return the arm under u(k) = law(k, y(k))."""
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, 0.01)
    x, u, y = np.zeros(4), np.empty(noise.size), np.empty(noise.size)
    for k in range(noise.size):
        y[k] = C[0] @ x + noise[k]
        u[k] = law(k, y[k])
        x = Phi @ x + Gamma[:, 0] * u[k]
    return Dataset(u=u, y=y, Ts=0.01, output="theta_1", unit="rad")


def replayed(plant: HandoutPlant, u: Vector, rng: np.random.Generator, std: float) -> Dataset:
    """Return the arm's response to this u in open loop."""
    y = plant.angle(u) + std * rng.standard_normal(u.size)
    return Dataset(u=u, y=y, Ts=0.01, output="theta_1", unit="rad")


@pytest.mark.parametrize(
    "draw",
    [
        lambda rng: prbs(1000, 5, 0.0, 5.0, seed=rng),
        lambda rng: np.repeat(rng.choice([0.0, 5.0], 143), 7)[:1000],
        lambda rng: apply_filter([1.0], [1.0, -1.7, 0.73], rng.standard_normal(1000)),
        lambda rng: rng.choice([-2.5, 2.5], 1000),
    ],
    ids=["prbs", "held", "low-pass", "zero mean"],
)
def test_open_loop_data_are_rejected_at_the_nominal_level(plant: HandoutPlant, draw: Draw) -> None:
    """100 runs of each at 5 %; Granger's test rejects 27, 47, 17 and 30 % of them."""
    rng = np.random.default_rng(1)
    p = np.array([sims(replayed(plant, draw(rng), rng, 5e-3)).p_value for _ in range(100)])

    assert np.count_nonzero(p < 0.05) <= 12
    assert 0.35 < np.mean(p < 0.5) < 0.65


def test_feedback_is_detected_and_its_replay_in_open_loop_is_not(plant: HandoutPlant) -> None:
    closed = [under_feedback(seed) for seed in range(20)]
    rng = np.random.default_rng(2)

    found = [sims(data).p_value < 0.05 for data in closed]
    replays = [sims(replayed(plant, data.u, rng, 0.05)).p_value < 0.05 for data in closed]

    assert sum(found) >= 18
    assert sum(replays) <= 4


def test_the_test_accounts_for_inputs_of_long_ago(plant: HandoutPlant) -> None:
    """A regulator's u has no mean power at 0 Hz, so later samples depend on u p samples ago.

    At 20 % 8 of 40 are expected; without the sums of old input there are twice as many.
    """
    rng = np.random.default_rng(5)

    def regulated() -> Vector:
        return controlled(lambda _, y: -3.0 * y, 0.05 * rng.standard_normal(3000)).u

    inputs = [regulated() for _ in range(40)]
    p = [sims(replayed(plant, u, rng, 0.05)).p_value for u in inputs]

    assert np.count_nonzero(np.array(p) < 0.2) <= 12


def test_missing_outputs_keep_the_level_and_the_power(plant: HandoutPlant) -> None:
    """Three of ten outputs are missing at random; a PRBS in open loop, and a controller."""
    rng = np.random.default_rng(4)

    def holed(data: Dataset) -> Dataset:
        return data.replaced(valid=rng.random(data.N) > 0.3, step=None)

    p = [
        sims(holed(replayed(plant, prbs(1000, 5, 0.0, 5.0, seed=rng), rng, 5e-3))).p_value
        for _ in range(40)
    ]
    found = [sims(holed(under_feedback(seed, N=3000))).p_value < 0.05 for seed in range(5)]

    assert np.count_nonzero(np.array(p) < 0.05) <= 7
    assert sum(found) == 5


def test_a_missing_output_removes_only_its_row(plant: HandoutPlant) -> None:
    whole = plant.dataset(3)
    rows = sims(whole).N

    def with_gap(length: int) -> Sims:
        valid = np.ones(whole.N, dtype=bool)
        valid[1000 : 1000 + length] = False
        return sims(whole.replaced(valid=valid, step=None))

    assert (rows - with_gap(1).N, rows - with_gap(5).N) == (1, 5)
    half = sims(whole).p // 2
    assert rows - with_gap(half).N == half
    assert rows - with_gap(half + 1).N > 3 * half
    long = with_gap(500)
    assert whole.N - 500 - 2 * (long.p + 4) == long.N


@pytest.mark.parametrize(
    ("u", "why"),
    [
        (np.full(1000, 2.5), "u follows from its own past"),
        (2.5 + np.sin(0.05 * np.arange(1000)), "u follows from its own past"),
        (multisine(1000, range(1, 6), 0.0, 5.0), "u follows from its own past"),
    ],
    ids=["constant", "sine", "few lines"],
)
def test_an_input_that_follows_from_its_own_past_gives_no_verdict(
    plant: HandoutPlant, u: Vector, why: str
) -> None:
    found = armrig.open_loop(replayed(plant, u, np.random.default_rng(1), 5e-3))

    assert found.feedback is None
    assert np.isnan(found.p_value)
    assert repr(found).startswith("no decision on feedback")
    assert why in found.explain()
    found.plot()


def test_data_without_noise_give_no_verdict_on_feedback(plant: HandoutPlant) -> None:
    """A controller could have calculated its feedback of a noise-free y in advance."""
    u = telegraph(1000, 0.05, 0.0, 5.0, seed=1)
    found = armrig.open_loop(Dataset(u=u, y=plant.angle(u), Ts=0.01))

    assert found.feedback is None
    assert "without noise" in found.explain()


def test_the_verdict_uses_the_requested_level(plant: HandoutPlant) -> None:
    data = plant.dataset(1)
    p = sims(data).p_value

    for level in (0.999 * p, 1.001 * p):
        found = armrig.open_loop(data, level)
        assert found.p_value == p
        assert found.feedback == (level > p)


def test_a_response_within_the_sample_is_reported_to_look_like_feedback(
    plant: HandoutPlant,
) -> None:
    rng = np.random.default_rng(1)
    u = rng.standard_normal(1000)
    direct = replayed(plant, u, rng, 0.05)
    direct = direct.replaced(y=direct.y + 0.1 * u, step=None)
    noise, seen = 0.05 * rng.standard_normal(1000), [0.0]

    def late(k: int, y: float) -> float:
        seen.append(y)
        return float(u[k] - 3 * seen[-2])

    assert "nk = 0" in armrig.open_loop(direct).explain()
    assert "not held" in armrig.open_loop(controlled(late, noise)).remarks[0]
    assert armrig.open_loop(controlled(late, noise)).feedback


@pytest.mark.exhaustive
def test_memory_does_not_grow_with_the_regression() -> None:
    """100 000 samples would need 70 MB of regressors."""
    rng = np.random.default_rng(1)
    u = rng.standard_normal(100_000)
    data = Dataset(
        u=u, y=apply_filter([0.0, 1.0], [1.0, -0.9], u) + rng.standard_normal(u.size), Ts=1
    )

    tracemalloc.start()
    sims(data)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert peak < 30e6


@pytest.mark.parametrize(("N", "why"), [(60, "at least 85"), (200, "with a complete past")])
def test_too_few_samples_are_refused(plant: HandoutPlant, N: int, why: str) -> None:
    data = plant.dataset(1, N=N)
    valid = np.arange(N) % 24 < 12 if N == 200 else np.ones(N, dtype=bool)

    with pytest.raises(ValueError, match=why):
        sims(data.replaced(valid=valid, step=None))


def test_an_impossible_level_is_refused(plant: HandoutPlant) -> None:
    with pytest.raises(ValueError, match=r"level=5 must lie between 0 and 1"):
        armrig.open_loop(plant.dataset(1), level=5)


def test_a_u_made_of_y_alone_is_reported_as_such() -> None:
    data = controlled(lambda _, y: -3.0 * y, 0.05 * np.random.default_rng(1).standard_normal(1000))

    for digits in (16, 7):
        found = armrig.open_loop(
            Dataset(u=np.round(data.u, digits), y=np.round(data.y, digits), Ts=0.01)
        )
        assert found.exact
        assert not found.may_be_direct_term
        assert "u(t) follows from y(t) exactly" in found.explain()
        assert "show the controller, not the rig" in repr(found)
    assert not armrig.open_loop(under_feedback(1)).exact


def test_the_inputs_after_u_t_have_a_separate_test() -> None:
    """For a white u the coefficients are independent: F is the mean of their squares over std."""
    from scipy.special import fdtrc

    for seed in (1, 4, 11):  # of small F, where the degrees of freedom matter most
        u, e = np.random.default_rng(seed).standard_normal((2, 10_000))
        found = sims(Dataset(u=u, y=apply_filter([0, 1.0], [1.0, -0.5], u) + e, Ts=1.0))
        later = found.lags < 0
        z = found.coefficients[later] / found.std[later]

        assert np.count_nonzero(later) == found.q - 1
        p = fdtrc(z.size, found.degrees, np.mean(z**2))
        assert found.p_later == pytest.approx(p, abs=0.01)
