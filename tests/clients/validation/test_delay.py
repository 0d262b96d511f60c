"""At which lag the input acts first, and what only looks like a delay."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import armrig
import numpy as np
import pytest
from armrig import Signals
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.numerics.criteria import mdl
from armrig.numerics.polynomial import apply_filter, impulse
from armrig.numerics.regressors import best_arx
from armrig.validation.feedback_and_delay.by_channel import without_other_inputs
from armrig.validation.feedback_and_delay.delay import _least_nk_by_steps
from armrig.validation.feedback_and_delay.lag_tests import _least_without_one, lag_tests
from armrig_core.errors import InputError
from armrig_core.rig.arm import ArmParameters, arm_matrices, zero_order_hold
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import f

from tests.clients.validation.plants import two_outputs
from tests.sampling import sampled

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant

Vector = NDArray[np.float64]
FAST, LSB = 0.002, np.deg2rad(352.0) / 1024


def late(data: Dataset, samples: int) -> Dataset:
    """Return the data with the output so many samples later."""
    y = np.concatenate([np.full(samples, data.y[0]), data.y[: data.N - samples]])
    return data.replaced(y=y, step=None)


@pytest.mark.parametrize("level", [0.0, 3.0])
def test_few_samples_are_tested_with_their_degrees_of_freedom(level: float) -> None:
    """F_k of 100 samples against least squares written out: N - d and the level of y count."""
    rng = np.random.default_rng(2)
    u = rng.standard_normal(100)
    y = level + apply_filter([0.0, 0.0, 0.4, 0.3], [1.0, -0.5], u) + 0.3 * rng.standard_normal(100)
    data = Dataset(u=u, y=y, Ts=1.0)

    response = armrig.impulse_response(data, 10, kernel=None)
    tests = lag_tests(data, response, 70)

    na, nb, n = tests.na, tests.p_values.size, np.arange(response.lags.size - 1, 100)
    assert na > 0
    past = [y[n - k] for k in range(1, na + 1)]
    inputs = [u[n - k] for k in range(nb)]

    def fitted(first: int) -> tuple[Vector, float]:
        Phi = np.column_stack([*inputs[first:], *past, np.ones(n.size)])
        theta = np.linalg.lstsq(Phi, y[n], rcond=None)[0]
        return theta, float(np.sum((y[n] - Phi @ theta) ** 2))

    degrees = n.size - na - nb - 1
    V = [fitted(k)[1] for k in range(nb)] + [fitted(nb)[1]]
    F = [(V[k + 1] - V[0]) / (k + 1) / (V[0] / degrees) for k in range(nb)]
    assert n.size == tests.N
    np.testing.assert_allclose(tests.p_values, f.sf(F, np.arange(1, nb + 1), degrees), rtol=1e-6)
    np.testing.assert_allclose(tests.loss, np.array(V[:-1]) / n.size, rtol=1e-9)
    np.testing.assert_allclose(tests.coefficient, [fitted(k)[0][0] for k in range(nb)], rtol=1e-7)
    Phi = np.column_stack([*inputs, *past, np.ones(n.size)])
    std = np.sqrt(V[0] / degrees * np.linalg.inv(Phi.T @ Phi)[0, 0])
    assert tests.std[0] == pytest.approx(std, rel=1e-7)


def unnamed(data: Dataset) -> Dataset:
    """Return the data with an uninformative name of the output."""
    return data.replaced(output="y", step=None)


@pytest.mark.parametrize("samples", [0, 1, 5])
def test_the_delay_is_found(plant: HandoutPlant, samples: int) -> None:
    """The nk is one more, because of the hold."""
    found = armrig.delay(late(plant.dataset(1), samples))

    assert found.delay == samples
    assert found.nk == samples + 1
    assert found.interval == (samples + 1, samples + 1)
    assert found.p_values[found.nk] < 0.001 <= found.p_values[found.nk - 1]


def test_a_direct_term_is_a_delay_of_minus_one() -> None:
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], 1000)
    y = apply_filter([0.5, 0.3], [1.0, -0.7], u) + 0.1 * rng.standard_normal(1000)

    found = armrig.delay(Dataset(u=u, y=y, Ts=1.0))

    assert (found.nk, found.delay) == (0, -1)
    assert "direct term" in repr(found)


def resonant(seed: int, N: int = 2000, noise: float = 1.0) -> Dataset:
    """Return a plant of order 6 with nk = 4, white noise on it as a share of the output."""
    rng = np.random.default_rng([5, seed])
    z = [rng.uniform(0.5, 0.97) * np.exp(1j * rng.uniform(0.2, 2.8)) for _ in range(3)]
    F = np.real(np.poly([*z, *np.conj(z)]))
    g = np.zeros(1)
    while abs(g[0]) <= 0.25 * np.abs(g).max():
        B = rng.standard_normal(6)
        g = apply_filter(B, [1.0], impulse(F, 400))
    u = rng.standard_normal(N)
    y = apply_filter(np.append(np.zeros(4), B), F, u)
    return Dataset(u=u, y=y + noise * np.std(y) * rng.standard_normal(N), Ts=1.0)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_the_delay_is_found_for_plants_of_other_orders_at_0_db(seed: int) -> None:
    """A model of the arm's order gave nk = 5 for the first of these plants."""
    found = armrig.delay(resonant(seed))

    assert found.interval[0] <= 4 <= found.interval[1]
    assert found.nk <= 4


@pytest.mark.parametrize("integrates", [False, True])
def test_data_without_noise_give_the_delay_exactly(integrates: bool) -> None:
    for seed in range(4):
        data = resonant(seed, 400, noise=0.0)
        y = np.cumsum(data.y) if integrates else data.y

        found = armrig.delay(data.replaced(y=y, step=None))

        assert (found.nk, found.interval) == (4, (4, 4))


@pytest.mark.parametrize("Ts", sampled([0.02, 0.01, 0.005], 2))
def test_an_unnamed_output_that_integrates_is_recognised(Ts: float) -> None:
    data = unnamed(arm(1, Ts=Ts, N=3000))

    found = armrig.delay(data)

    assert (found.nk, found.interval) == (1, (1, 1))
    assert found.integrator
    assert found.response.integrator
    assert "behaves as an integrating output" in repr(found)
    assert "integrator=False" in found.explain()


def test_many_short_experiments_determine_the_delay() -> None:
    rng = np.random.default_rng(3)
    parts = []
    for _ in range(12):
        u = rng.standard_normal(60)
        y = apply_filter([0, 0, 0.5, 0.3], [1.0, -0.8], u) + 0.1 * rng.standard_normal(60)
        parts.append(Dataset(u=u, y=y, Ts=1.0))

    found = armrig.delay(merge(parts))

    assert (found.nk, found.interval) == (2, (2, 2))


def test_with_three_samples_in_ten_missing_the_impulse_response_is_tested() -> None:
    """Hardly a row then has all of its past outputs."""
    rng = np.random.default_rng(2)
    u = rng.standard_normal(1500)
    y = apply_filter([0, 0, 0, 0.5, 0.3], [1.0, -0.8], u) + 0.3 * rng.standard_normal(1500)
    data = Dataset(u=u, y=y, Ts=1.0, valid=rng.random(1500) > 0.3)

    found = armrig.delay(data)

    assert (found.nk, found.interval, found.na) == (3, (3, 3), 0)
    assert lag_tests(data, found.response, 70).N == found.response.N > 1000


def test_the_time_hidden_by_quantisation_is_reported_separately(plant: HandoutPlant) -> None:
    """t_q = sqrt(2 LSB / (b Δu)) with the handout's b of 98.4 rad/s² per V, a step of 5 V."""
    found = armrig.delay(plant.through_potentiometer(plant.dataset(1), 1))

    assert found.quantum == pytest.approx(LSB)
    assert found.t_q == pytest.approx(np.sqrt(2 * LSB / (98.4 * 5.0)), rel=0.1)
    assert found.delay == 0
    assert "Quantisation is no delay" in found.explain()


def test_an_input_that_follows_from_its_own_past_is_refused() -> None:
    """A constant, a sine, and twenty sines in a narrow band."""
    t, k = np.arange(1000), np.arange(1, 21)
    twenty = np.cos(2 * np.pi * np.outer(t, k) / 100 + k**2).sum(axis=1)
    noise = np.random.default_rng(1).standard_normal(1000)

    for u in (np.ones(1000), np.sin(0.3 * t), twenty):
        with pytest.raises(ValueError, match="too narrow to find a delay"):
            armrig.delay(Dataset(u=u, y=apply_filter([0, 0.5], [1, -0.8], u) + noise, Ts=1.0))


def test_a_prbs_of_a_short_period_determines_the_delay() -> None:
    """A PRBS of 31 samples determines 30 lags, which A and B share."""
    rng = np.random.default_rng(6)
    u = armrig.prbs(1000, register=5)
    y = apply_filter([0, 0, 0.5, 0.3], [1.0, -0.8], u) + 0.1 * rng.standard_normal(1000)

    found = armrig.delay(Dataset(u=u, y=y, Ts=1.0))

    assert (found.nk, found.interval) == (2, (2, 2))


def test_an_input_without_effect_is_reported() -> None:
    rng = np.random.default_rng(1)
    data = Dataset(u=rng.standard_normal(200), y=rng.standard_normal(200), Ts=1.0)

    with pytest.raises(ValueError, match="no response to u above the noise"):
        armrig.delay(data)


def angle(u: Vector, Ts: float, finer: int = 1) -> Vector:
    """Return theta_1 every Ts, for u held over Ts / `finer`."""
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, Ts / finer)
    x, y = np.zeros(4), np.empty(u.size)
    for k in range(u.size):
        y[k] = C[0] @ x
        x = Phi @ x + Gamma[:, 0] * u[k]
    return y[::finer]


def arm(seed: int, *, Ts: float = FAST, N: int = 4000, delayed: float = 0.0) -> Dataset:
    """Return the arm's angle under a telegraph, so many samples late (in halves), white noise."""
    rng = np.random.default_rng([23, seed])
    u = armrig.telegraph(N, 5 * Ts, 0.0, 5.0, seed=rng)
    held = np.concatenate([np.zeros(round(2 * delayed)), np.repeat(u, 2)])[: 2 * u.size]
    y = angle(held, Ts, 2) + 5e-3 * rng.standard_normal(u.size)
    return Dataset(u=u, y=y, Ts=Ts, output="theta_1", unit="rad")


@pytest.mark.exhaustive
@pytest.mark.parametrize("samples", sampled([0, 2]))
def test_at_a_short_sampling_time_the_shape_of_the_onset_decides(samples: int) -> None:
    found = armrig.delay(arm(1, delayed=samples) if samples else unnamed(arm(1)))

    assert found.told
    assert found.delay == samples
    assert found.misfit[samples + 1] < 0.01 * min(
        chi2 for k, chi2 in found.misfit.items() if k != samples + 1
    )


@pytest.mark.exhaustive
def test_a_delay_of_half_a_sample_leaves_both_neighbours_possible() -> None:
    found = armrig.delay(arm(2, delayed=1.5))

    assert found.interval == (2, 3)
    assert found.delay == 1
    assert "nk between 2 and 3: not determined at this Ts and noise" in repr(found)


def test_an_onset_within_the_noise_is_not_reported_without_its_shape() -> None:
    found = armrig.delay(unnamed(arm(1)), integrator=False)

    assert not found.told
    assert found.interval[0] <= 1 < found.interval[1]
    assert found.nk == 1


@pytest.mark.exhaustive
@pytest.mark.parametrize(("Ts", "at", "high"), sampled([(0.002, 161, 4.5), (0.001, 157, 1.5)]))
def test_one_step_with_quantised_readings_shows_no_delay(Ts: float, at: int, high: float) -> None:
    u = np.where(np.arange(round(3 / Ts)) < at, 0.5, high)
    y = (np.floor(angle(u, Ts) / LSB) + 0.5) * LSB

    found = armrig.delay(Dataset(u=u, y=y, Ts=Ts, output="theta_1", unit="rad"))

    assert found.interval[0] <= 1 <= found.interval[1]
    assert found.delay <= 0


def test_feedback_is_not_a_direct_term() -> None:
    """A P controller's u(t) depends on y(t), which shows at lag 0; the rig acts from lag 1 on."""
    rng, N = np.random.default_rng(5), 1500
    r, e = np.repeat(rng.uniform(-1, 1, N // 50), 50), 0.1 * rng.standard_normal(N)
    x, u, y = np.zeros((3, N))
    for t in range(N):
        x[t] = 0.9 * x[t - 1] + 0.5 * u[t - 1] if t else 0.0
        y[t] = x[t] + e[t]
        u[t] = 0.5 * (r[t] - y[t])

    found = armrig.delay(Dataset(u=u, y=y, Ts=0.02))

    assert (found.nk, found.interval) == (1, (1, 1))
    assert [*found.p_values] == [1]
    assert "as under feedback" in repr(found)
    assert "lag 1: its coefficient" in found.explain()
    assert "lags 0" not in found.explain()


def test_a_direct_term_and_feedback_without_delay_look_the_same() -> None:
    """A direct term is assumed for an input of two levels; any other input leaves it open."""
    rng = np.random.default_rng(1)

    for u, nk in ((rng.choice([-1.0, 1.0], 1000), 0), (rng.standard_normal(1000), 1)):
        y = apply_filter([0.5, 0.3], [1.0, -0.8], u) + 0.1 * rng.standard_normal(1000)
        found = armrig.delay(Dataset(u=u, y=y, Ts=1.0))
        assert (found.nk, found.interval) == (nk, (0, nk))
        assert "feedback looks the same as a direct term" in repr(found)


@pytest.mark.parametrize(
    ("changes", "t_q", "low"),
    [(3, 0.025, 2), (3, 0.045, 1), (3, 0.2, 1), (10, 0.2, 2), (3, None, 2)],
    ids=["3 samples", "5 samples", "all", "many changes", "not read in steps"],
)
def test_lags_hidden_by_quantisation_are_not_ruled_out(
    changes: int, t_q: float | None, low: int
) -> None:
    """Lags 2 to 6 at 10 ms; if u changes often, the error of a reading averages out."""
    found, remarks = _least_nk_by_steps(2, 6, changes, t_q, 0.01)

    assert found == low
    assert bool(remarks) == (changes < 10 and t_q is not None)


@pytest.mark.parametrize("seed", range(5))
def test_a_plant_of_relative_degree_four_has_no_dead_time(seed: int) -> None:
    """1/(s + 1)^4 at Ts 0.2 s begins 1 : 15 : 65, so the data do not show one sample of delay."""
    rng = np.random.default_rng([seed, 28])
    u = armrig.telegraph(2000, 0.05, 1.0, 4.0, seed=rng)
    # Four lags of first order, exactly, for an input that is held.
    A = -np.eye(4) + np.eye(4, k=-1)
    Phi, Gamma = zero_order_hold(A, np.eye(4)[:, :1], 0.2)
    x, clean = np.zeros(4), np.empty(u.size)
    for k, volts in enumerate(u.tolist()):
        clean[k] = x[3]
        x = Phi @ x + Gamma[:, 0] * volts
    y = clean + 0.01 * clean.std() * rng.standard_normal(u.size)

    found = armrig.delay(Dataset(u=u, y=y, Ts=0.2))

    assert found.nk == 1
    assert found.interval[0] <= 1 <= found.interval[1] <= 3
    assert "An even slower onset looks like a delay" in found.explain()


def held(
    seed: int, *, gain: float, pole: float, walk: float, spikes: tuple[float, float]
) -> Dataset:
    """Return a lag with nk = 6 under an input of long holds; the noise drifts and has spikes."""
    rng, N = np.random.default_rng([77, seed]), 300
    high, u = bool(rng.random() < 0.5), []
    while len(u) < N:
        u += [6.0 if high else -6.0] * (10 * int(rng.integers(1, 12)))
        high = not high
    share, size = spikes
    drift = apply_filter([1.0], [1.0, -0.99], walk * rng.standard_normal(N))
    spike = np.where(rng.random(N) < share, size * rng.standard_normal(N), 0.0)
    x = apply_filter([*np.zeros(6), gain], [1.0, -pole], np.array(u[:N]))
    y = np.round(120 + x + drift + 0.5 * rng.standard_normal(N) + spike)
    return Dataset(u=np.array(u[:N]), y=y, Ts=0.025)


@pytest.mark.parametrize("seed", [7, 12, 17, 25])
def test_the_last_lag_of_a_model_is_not_the_first_lag_of_u(seed: int) -> None:
    """AIC chose a single lag of u, and that lag contained the effect of all later lags."""
    data = held(seed, gain=0.1, pole=0.98, walk=1.5, spikes=(0.06, 6.0))

    try:
        low, high = armrig.delay(data, integrator=False).interval
    except ValueError as err:
        assert "do not determine the delay" in str(err)  # noqa: PT017
    else:
        assert low <= 6 <= high


@pytest.mark.parametrize("seed", [22, 33, 42])
def test_a_single_spike_is_not_an_effect_of_u(seed: int) -> None:
    """If u changes rarely, one wrong sample made the coefficient of an early lag significant."""
    data = held(seed, gain=0.25, pole=0.97, walk=0.7, spikes=(0.02, 15.0))

    low, high = armrig.delay(data, integrator=False).interval

    assert low <= 6 <= high


def test_the_p_value_without_one_row_is_the_largest_of_all_rows() -> None:
    """Each row is left out in turn from the scores."""
    rng = np.random.default_rng(8)
    X, y = rng.standard_normal((40, 5)), rng.standard_normal(40)
    Q, R = np.linalg.qr(np.column_stack([X, y]))

    found = _least_without_one([np.column_stack([X, y])], R, 3)

    for k in (1, 2, 3):
        first = Q[:, 5 - k : 5]
        e = y - Q[:, : 5 - k] @ (Q[:, : 5 - k].T @ y)
        sums = [float(np.sum((first.T @ e - first[i] * e[i]) ** 2)) for i in range(40)]
        assert found[k - 1] == pytest.approx(min(sums))


def test_the_progress_of_the_fits_of_an_onset_is_reported() -> None:
    seen: list[tuple[int, int, str]] = []

    armrig.delay(unnamed(arm(1, N=2000)), integrator=True, progress=lambda *of: seen.append(of))

    (done, total, name), *_ = seen
    assert (done, name.split()[0]) == (0, "lag")
    assert len(seen) == total == len({name for _, _, name in seen})


def test_a_wide_range_of_lags_is_not_tested_by_its_shape() -> None:
    """The test of 12 lags took a minute, and its result was then discarded."""
    data = held(1, gain=0.25, pole=0.97, walk=0.7, spikes=(0.02, 15.0))
    seen: list[tuple[int, int, str]] = []

    found = armrig.delay(data, integrator=True, progress=lambda *of: seen.append(of))

    assert found.interval == (0, 11)
    assert (found.misfit, seen) == ({}, [])


def test_each_channel_has_a_separate_delay() -> None:
    found = armrig.delay(two_outputs(1))

    nk = {name: found[name].nk for name in found}  # type: ignore[attr-defined, index]
    assert nk == {("y1", "u1"): 1, ("y1", "u2"): 2, ("y2", "u1"): 1, ("y2", "u2"): 1}
    assert repr(found).startswith("u1 to y1: nk = 1")


def test_a_channel_without_a_response_has_a_reason() -> None:
    found: Any = armrig.delay(two_outputs(1, cross=0.0))

    assert len(found) == 3
    with pytest.raises(InputError, match="u2 to y1: "):
        found["y1", "u2"]
    with pytest.raises(InputError, match="there is no such channel"):
        found["y9", "u2"]


def test_a_model_of_all_inputs_has_at_most_a_fifth_of_its_rows_as_parameters() -> None:
    """As many parameters as rows fit noise exactly, and would be chosen for it."""
    rng = np.random.default_rng(1)
    data = Signals(u=rng.standard_normal((60, 2)), y=rng.standard_normal((60, 1)), Ts=0.1)

    model = best_arx([(data.u, data.y[:, 0])], (1, 2, 3, 4, 6), mdl, 5)

    assert model is not None
    assert model.base.rank <= 60 / 5
    with pytest.raises(InputError, match="too few samples of y for an ARX model"):
        without_other_inputs(data[:24], "y", "u1")


def test_each_channel_of_several_signals_has_separate_hints() -> None:
    """The channels have the orders 2, 1, 1 and 1; u2 reaches y1 one sample later."""
    found: Any = armrig.structure_hints(two_outputs(1))

    first = {name: found[name].structures[0] for name in found}
    assert {name: (s.nb, s.nf, s.nk) for name, s in first.items()} == {
        ("y1", "u1"): (2, 2, 1),
        ("y1", "u2"): (1, 1, 2),
        ("y2", "u1"): (1, 1, 1),
        ("y2", "u2"): (1, 1, 1),
    }
    assert found.explain().startswith("u1 to y1:\n- integrator: ")


@pytest.mark.parametrize("nk", [45, 50, 51, 60, 150, 200])
def test_a_dead_time_of_many_samples_is_found(nk: int) -> None:
    """The first model has 50 lags; its last lag also represents later lags."""
    rng, N = np.random.default_rng(nk), max(10 * nk, 800)
    u = armrig.telegraph(N, 0.1, seed=nk)
    late = np.concatenate([np.full(nk - 1, u[0]), u[: N - nk + 1]])
    y = lfilter([0.0, 0.2], [1, -0.9], late) + 0.1 * rng.standard_normal(N)

    assert armrig.delay(armrig.Dataset(u=u, y=y, Ts=1.0)).interval == (nk, nk)


def test_the_last_tested_lag_is_no_answer() -> None:
    """An eighth of the samples is tested, so that a dead time of 300 is beyond the range."""
    rng, N, nk = np.random.default_rng(2), 1600, 300
    u = armrig.telegraph(N, 0.1, seed=2)
    y = lfilter([0.0, 0.2], [1, -0.9], np.concatenate([np.full(nk, u[0]), u[: N - nk]]))
    data = armrig.Dataset(u=u, y=y + 0.1 * rng.standard_normal(N), Ts=1.0)

    with pytest.raises(InputError, match="the data do not determine the delay"):
        armrig.delay(data)


def test_a_position_behind_a_dead_zone_is_given_no_direct_term() -> None:
    """The shape of the onset fitted lag 0 best, but lag 0 itself is not significant."""
    rng, N, Ts, tau = np.random.default_rng(0), 1000, 0.02, 0.2
    u, y, w = np.repeat(rng.uniform(-4, 4, N), 8)[:N], np.zeros(N), 0.0
    moving = np.sign(u) * np.maximum(np.abs(u) - 0.5, 0)
    for t in range(1, N):
        y[t] = y[t - 1]
        for _ in range(10):
            w += Ts / 10 / tau * (moving[t - 1] - w)
            y[t] += Ts / 10 * w
    y += 0.02 * rng.standard_normal(N)

    late = armrig.delay(armrig.Dataset(u=u, y=y, Ts=Ts, output="position"))

    assert (late.nk, late.interval[0]) == (1, 0)
