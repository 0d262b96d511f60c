"""Step analysis reads time constant, dead time and gain."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.data.treatment.outliers import quantum
from armrig.estimation.nonparametric.sampling_time import sampling_time
from armrig.estimation.nonparametric.step_analysis import (
    _alone,
    _lag,
    _left_to_settle,
    _longest_gap,
    _mean_response,
    _Steps,
    _steps,
    _warnings,
    step_analysis,
)
from armrig.estimation.nonparametric.step_answer import (
    DRAWS,
    NormalisedResponse,
    _crossing_times,
    _settling_times,
)
from armrig.numerics.polynomial import apply_filter
from armrig.numerics.quantities import with_std
from armrig.numerics.step_times import lag_of_angle
from armrig_core.errors import InputError
from numpy.typing import NDArray

from tests.sampling import sampled

TS, TAU, GAIN = 0.01, 0.2, 3.0


def first_order(dead: int = 0, std: float = 0.0, *, down: bool = False, seed: int = 1) -> Dataset:
    """Return the answer of GAIN/(1 + TAU s), delayed, to a step of 2 after 1 s."""
    N, at = 400, 100
    u = np.where(np.arange(N) < at, 1.0, 3.0)
    u = 4.0 - u if down else u
    y: NDArray[np.float64] = np.full(N, GAIN * u[0])
    a = np.exp(-TS / TAU)
    for t in range(1, N):
        y[t] = a * y[t - 1] + (1 - a) * GAIN * u[max(t - 1 - dead, 0)]
    return Dataset(u=u, y=y + std * np.random.default_rng(seed).standard_normal(N), Ts=TS)


@pytest.mark.parametrize("down", [False, True])
def test_the_time_constant_and_gain_of_a_first_order_system_are_found(down: bool) -> None:
    found = step_analysis(first_order(down=down), integrator=False)

    assert found.tau == pytest.approx(TAU, rel=0.01)
    assert found.gain == pytest.approx(GAIN, rel=1e-3)
    assert found.dead_time == 0.0
    assert found.bandwidth == pytest.approx(1 / TAU, rel=0.01)
    assert found.settling == pytest.approx(3 * TAU, rel=0.05)
    assert found.overshoot == pytest.approx(0.0, abs=1e-3)


def test_the_dead_time_is_not_part_of_the_time_constant() -> None:
    found = step_analysis(first_order(dead=8, std=0.01), integrator=False)
    unclaimed = step_analysis(first_order(dead=8, std=0.05), integrator=False)

    assert found.dead_time == pytest.approx(0.08, abs=0.015)
    assert found.dead_time_interval[0] > 0
    assert found.tau == pytest.approx(TAU, rel=0.1)
    assert found.equivalent_time == pytest.approx(TAU, rel=0.1)
    assert abs(found.equivalent_time - TAU) < 3 * found.equivalent_time_std < 0.01
    assert unclaimed.dead_time in (0.0, pytest.approx(0.08, abs=0.03))
    assert abs(unclaimed.tau - TAU) < 2 * unclaimed.tau_std


@pytest.mark.exhaustive
@pytest.mark.exhaustive
def test_the_reported_deviations_equal_the_scatter_of_many_runs() -> None:
    """Gain, 63 % time, equivalent time and settling time, in 40 runs; noise is no overshoot."""
    found = [step_analysis(first_order(std=0.2, seed=s), integrator=False) for s in range(40)]
    loud = step_analysis(first_order(std=10.0, seed=4), integrator=False)

    gain, tau = np.array([f.gain for f in found]), np.array([f.tau for f in found])
    assert np.mean(gain) == pytest.approx(GAIN, abs=0.03)
    assert np.mean(tau) == pytest.approx(TAU, rel=0.1)
    assert 0.4 < np.std(tau) / np.mean([f.tau_std for f in found]) < 1.5
    lag = np.array([f.equivalent_time for f in found])
    assert np.mean(lag) == pytest.approx(TAU, rel=0.05)
    assert 0.5 < np.std(lag) / np.mean([f.equivalent_time_std for f in found]) < 1.5
    settling = np.array([f.settling for f in found])
    assert 0.4 < np.std(settling) / np.mean([f.settling_std for f in found]) < 1.5
    assert sum("no visible overshoot (± " in repr(f) for f in found) >= 38
    assert "gain not determined" in repr(loud)


def test_the_arm_is_analysed_by_its_velocity(arm: Any) -> None:
    """1.86 rad/s per volt; 63 % after 20 ms, in the middle of two samples."""
    found = step_analysis(arm.steps())

    assert found.rate
    assert found.steps == 9
    assert found.gain == pytest.approx(1.862, rel=0.01)
    assert found.tau == pytest.approx(0.0217, abs=0.002)
    assert found.dead_time == 0.0
    assert "rad/s/V" in repr(found)
    assert repr(found).startswith("step analysis of the rate of theta_1, 9 steps, Ts 0.01 s")


def test_long_holds_are_averaged_over_their_common_samples() -> None:
    """A hold of less than half the longest, or with 7 known samples, makes no step."""
    u = np.repeat([0.0, 2.0, 1.0, 5.0, 1.0], [30, 40, 15, 25, 22])
    valid = np.ones(u.size, dtype=np.bool_)
    valid[7:30] = False  # 7 known samples before the first step
    other = np.repeat([1.0, -1.0], [36, 33])
    data = merge([Dataset(u=u, y=u, Ts=TS, valid=valid), Dataset(u=other, y=other, Ts=TS)])

    assert _steps(data) == _Steps([(0, 110), (1, 36)], 25, 22)
    valid[7] = True  # the level before this step is not known
    data = merge([Dataset(u=u, y=u, Ts=TS, valid=valid), Dataset(u=other, y=other, Ts=TS)])
    assert _steps(data) == _Steps([(0, 110), (1, 36)], 25, 22)


@pytest.mark.parametrize("slope", [False, True])
def test_a_large_step_weighs_as_the_square_of_its_size(slope: bool) -> None:
    """The weighted mean is the least-squares response of a unit step."""
    u = np.repeat([1.0, 4.0, 2.0], [20, 24, 24])
    t = np.arange(u.size)
    y = 3.0 + 0.5 * t * slope
    y[20:44] += 3 * np.arange(24.0)
    y[44:] += 4.0 - 2 * np.arange(24.0) + (72.0 - 4.0 if slope else 0)
    y[50] = np.nan
    data = Dataset(u=u, y=y, Ts=TS, valid=np.isfinite(y))
    steps = _Steps([(0, 20)], 20, 24)
    both = _Steps([(0, 20), (0, 44)], 10, 24)

    k, mean, weight = _mean_response(data, steps, slope=slope)
    _, _, of_both = _mean_response(data, both, slope=slope)

    np.testing.assert_allclose(mean[k >= 0], np.arange(24.0), atol=1e-9)
    np.testing.assert_allclose(mean[k < 0], 0.0, atol=1e-9)
    np.testing.assert_array_equal(weight, 9.0)
    np.testing.assert_array_equal(of_both, np.where(np.arange(-10, 24) == 6, 9.0, 13.0))


@pytest.mark.parametrize(
    ("missing", "crossing", "expected"),
    [
        ([(1, 2)], 0.1, None),  # a single sample
        ([(1, 3)], 0.03, (0.0, 0.03)),
        ([(2, 5), (7, 8)], 0.05, (0.01, 0.05)),
        ([(2, 5), (6, 10)], 0.05, (0.05, 0.1)),
        ([(2, 5), (7, 11)], 0.05, (0.01, 0.05)),  # the longer begins after the rise
        ([(2, 4)], 0.5, None),  # short for so slow a rise
        ([(-5, -2)], 0.05, None),  # before the step
    ],
)
def test_the_longest_gap_on_the_rise_is_from_known_sample_to_known_sample(
    missing: list[tuple[int, int]], crossing: float, expected: tuple[float, float] | None
) -> None:
    k = np.arange(-10, 40)
    y = np.ones(k.size)
    for a, b in missing:
        y[(k >= a) & (k < b)] = np.nan

    found = _longest_gap(y, k, crossing, 0.01)

    assert found == (None if expected is None else pytest.approx(expected))


def test_a_sample_between_gaps_of_two_or_more_samples_is_isolated() -> None:
    known = np.array([c == "#" for c in "##..#..#.#..##..#"])

    assert np.flatnonzero(_alone(known)).tolist() == [4]


@pytest.mark.parametrize(("slope", "noise"), [(0.02, 0.0), (-0.02, 0.001), (0.0, 0.1)])
def test_motion_before_the_step_is_considered_up_to_the_63_per_cent_time(
    slope: float, noise: float
) -> None:
    k = np.arange(-40, 60)
    y = slope * k + noise * np.random.default_rng(1).standard_normal(100)
    y[20:24] = np.nan
    y[:19] = 5.0  # before the second half of the hold

    left = _left_to_settle(y, k, _Steps([(0, 40)], 40, 60), 12.0)

    assert left == pytest.approx(12 * slope, abs=5e-3)


def test_the_rounding_of_an_angle_is_divided_by_the_steps() -> None:
    """Steps of 3 and -4 weigh as one of 5."""
    u = np.repeat([1.0, 4.0, 0.0], [30, 30, 30])
    y = 0.02 * np.round(np.cumsum(u) / 7)
    data = Dataset(u=u, y=y, Ts=0.1)
    k = np.arange(-20, 30)
    mean = 0.3 * k + 0.01 * np.cos(k)

    found = _lag(mean, k, data, _Steps([(0, 30), (0, 60)], 20, 30), (1.0, 0.1), integrates=True)

    late = k >= 2 * 29 // 3
    expected = lag_of_angle(0.1 * k[late], mean[late], before=(11, 1.1), rounding=0.02 / 5)
    assert quantum(data) == pytest.approx(0.02)
    assert found == pytest.approx(expected)


def test_a_curve_crosses_and_settles_between_its_samples() -> None:
    """The last curve reaches 63 % at its first sample."""
    t = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    share = 1 - np.exp(-1)
    curves = np.array(
        [[0, 0.2, 0.4, 1.2, 1.0], [0.5, 1.5, 0.9, 1.0, 1.0], [2 * share, 1.04, 1.0, 0.96, 1.0]]
    ).T

    np.testing.assert_allclose(
        _crossing_times(t, curves),
        [0.3 + 0.1 * (share - 0.4) / 0.8, 0.1 + 0.1 * (share - 0.5), 0.05],
    )
    np.testing.assert_allclose(_settling_times(t, curves, 0.05), [0.45, 0.35, 0.15])


def _answer_of(delays: Any, none: float) -> NormalisedResponse:
    curves = np.linspace(0.2, 0.4, 400)
    return NormalisedResponse(
        t=np.array([0.1, 0.2, 0.3]), y=np.array([0.5, 1.1, 1.0]), std=np.zeros(3),
        crossings=curves, delays=np.asarray(delays, float), settlings=np.linspace(0.5, 0.9, 400),
        peaks=np.full(400, 1.3), none=none,
    )  # fmt: skip


@pytest.mark.parametrize(("none", "dead_time"), [(0.0, 0.1), (0.0099, 0.1), (0.01, 0.0), (0.9, 0)])
def test_a_dead_time_is_reported_from_a_probability_of_99_per_cent_on(
    none: float, dead_time: float
) -> None:
    """It is the median of the curves that have one."""
    answer = _answer_of([0.0] * 201 + [0.1] * 100 + [0.05] * 99, none)

    assert answer.dead_time == dead_time
    assert answer.crossing == pytest.approx(0.3)
    off = np.abs(answer.crossings - answer.delays - (0.3 - dead_time))
    assert np.mean(off <= answer.tau_std) == pytest.approx(0.683, abs=0.005)


@pytest.mark.parametrize(
    ("of", "told"),
    [
        ({}, ""),
        (
            {"hidden": (0.012, 0.031)},
            "y is missing 12 … 31 ms after the step, on the rise, so the ",
        ),
        (
            {"unsettled": -0.006},
            "the output had not settled before the step: the remaining motion ",
        ),
        ({"unsettled": 0.005}, ""),
        ({"tail": np.linspace(0.96, 1.06, 60)}, "the response has not settled in the last third"),
        ({"tail": np.linspace(0.985, 1.015, 60)}, ""),
        ({"tail": 1 + 0.3 * (-1.0) ** np.arange(61)}, ""),
        ({"crossing": 0.029}, "63 % is reached within 2.9 samples, which is coarse: record with"),
        ({"crossing": 0.03}, ""),
    ],
)
def test_each_warning_has_its_limit_and_its_numbers(of: dict[str, Any], told: str) -> None:
    fields = {"tail": np.ones(30), "unsettled": 0.0, "hidden": None, "crossing": 0.05} | of
    answer: Any = SimpleNamespace(crossing=fields.pop("crossing"), tau_std=0.0042, settling_std=9.0)
    data = Dataset(u=np.ones(9), y=np.ones(9), Ts=0.01)

    said = [x.replace("\xa0", " ") for x in _warnings(**fields, answer=answer, data=data)]

    assert [x.startswith(told) for x in said] == ([True] if told else [])
    assert all("known only to ± 4.2 ms; record" in x for x in said if "missing" in x)
    assert all("was 0.6 % of the response" in x for x in said if "motion" in x)


def test_numbers_of_curves_are_medians_and_their_scatter() -> None:
    answer = _answer_of([*np.linspace(0, 0.01, 200), *np.linspace(0.01, 0.9, 200)], 0.5)
    low, high = answer.dead_time_interval

    assert low == 0.0
    assert np.mean(answer.delays <= high) == pytest.approx(0.95, abs=0.003)
    late = _answer_of(0.9 - answer.delays, 0.0)
    assert late.dead_time_interval == pytest.approx((0.9 - high, 0.9))
    assert answer.settling == pytest.approx(0.7)
    assert answer.settling_std == pytest.approx(np.hypot(0.683 * 0.2, 0.1 / np.sqrt(12)), rel=5e-3)
    assert answer.overshoot == pytest.approx((0.1, 0.2))


def test_steps_of_several_experiments_are_averaged_without_their_gaps() -> None:
    parts = []
    for seed in (1, 2):
        d = first_order(std=0.1, seed=seed)
        valid = np.random.default_rng(seed).random(d.N) > 0.5
        parts.append(Dataset(u=d.u, y=d.y, Ts=TS, valid=valid))

    found = step_analysis(merge(parts), integrator=False)

    assert found.steps == 2
    assert found.tau == pytest.approx(TAU, rel=0.1)
    assert found.gain == pytest.approx(GAIN, rel=0.02)


def test_a_single_sample_between_gaps_is_not_averaged() -> None:
    """A single noisy sample between two holes neither crosses 63 % nor overshoots."""
    whole = first_order(std=0.3)
    gap = (np.arange(400) >= 104) & (np.arange(400) < 114)
    y = whole.y.copy()
    gap[108], y[108] = False, whole.y[108] + 10.0
    data = Dataset(u=whole.u, y=y, Ts=TS, valid=~gap)

    found = step_analysis(data, integrator=False)

    assert found.tau == pytest.approx(TAU, rel=0.2)
    assert found.overshoot < 0.1


@pytest.mark.exhaustive
@pytest.mark.exhaustive
def test_overshoot_and_settling_time_are_those_of_the_response_and_not_of_its_noise(
    sampled: Any,
) -> None:
    """The arm has 10.7 % and 0.372 s; the noise is as high as the peak."""
    u = np.where(np.arange(2500) < 500, 0.5, 4.5)
    arm = sampled(0.002)
    of_the_arm = [step_analysis(arm.dataset(u, std=4e-3, seed=seed)) for seed in range(20)]
    above = np.array([f.overshoot for f in of_the_arm])

    assert np.mean(above) == pytest.approx(0.1067, abs=0.003)
    assert 0.5 < np.std(above) / np.mean([f.overshoot_std for f in of_the_arm]) < 1.5
    assert "overshoot 10." in repr(of_the_arm[0])
    np.testing.assert_allclose([f.settling for f in of_the_arm], 0.372, rtol=0.06)


def test_a_fast_oscillation_has_not_settled() -> None:
    """A pair of poles at 0.97 exp(±1.5j), without noise: the last sample outside 5 % counts."""
    F = np.poly(0.97 * np.exp([1.5j, -1.5j])).real
    u = np.where(np.arange(500) < 100, 0.0, 3.0)
    y = apply_filter([0.0, F.sum()], F, u)

    found = step_analysis(Dataset(u=u, y=y, Ts=TS), integrator=False)

    outside = np.flatnonzero(np.abs(y - 3.0) > 0.05 * 3.0)[-1] - 100
    assert found.settling == pytest.approx(outside * TS, rel=0.1)


def test_data_without_a_step_are_refused() -> None:
    still = Dataset(u=np.ones(100), y=np.zeros(100), Ts=TS)
    deaf = Dataset(u=first_order().u, y=np.random.default_rng(1).standard_normal(400), Ts=TS)

    with pytest.raises(
        ValueError, match=r"u has no step with \d+ constant .*armrig\.step\(N, at=50"
    ):
        step_analysis(still, integrator=False)
    with pytest.raises(
        ValueError, match=r"y does not respond to the step: .*; use a larger step, or hold"
    ):
        step_analysis(deaf, integrator=False)
    assert not step_analysis(first_order(), integrator=False).warnings


@pytest.mark.parametrize("integrator", [False, True])
def test_a_step_without_a_known_initial_level_is_omitted(integrator: bool) -> None:
    """The output is missing just before the first of two steps, as in a dead band."""
    first, second = first_order(std=0.01), first_order(std=0.01, down=True, seed=2)
    gap = (np.arange(first.N) >= 40) & (np.arange(first.N) < 105)
    y = np.cumsum(first.y) if integrator else first.y
    late = np.cumsum(second.y) if integrator else second.y
    part = Dataset(u=first.u, y=np.where(gap, np.nan, y), Ts=TS, valid=~gap)
    whole = Dataset(u=second.u, y=late, Ts=TS)

    found = step_analysis(merge([part, whole]), integrator=integrator)

    assert found.steps == 1
    of = "the rate of y" if integrator else "y"
    assert repr(found).startswith(f"step analysis of {of}, 1 step, Ts 0.01 s")
    assert found.tau == pytest.approx(TAU, rel=0.1)
    with pytest.raises(InputError, match=r"y.* has fewer than 2 samples .* u's 1 step: record"):
        step_analysis(part, integrator=integrator)


@pytest.mark.parametrize(("before", "is_told"), [(20, True), (60, True), (160, False)])
def test_motion_before_the_step_enters_the_deviation_of_the_gain(
    before: int, is_told: bool
) -> None:
    """Three slow poles: the gain is -1.43, and after 60 samples of u = -1 V it is -1.32."""
    u = np.repeat([-1.0, 2.0], [before, 250])
    y = apply_filter([0.0] * 6 + [-0.002], np.poly([0.93, 0.9, 0.8]), u)
    y += 1e-4 * np.random.default_rng(1).standard_normal(u.size)

    found = step_analysis(Dataset(u=u, y=y, Ts=0.1), integrator=False)

    assert abs(found.gain + 1 / 0.7) < 2 * found.gain_std
    said = [w for w in found.warnings if w.startswith("the output had not settled before the step")]
    assert bool(said) is is_told


@pytest.mark.parametrize("begins_ms", sampled([6, 40, 14, 18], 2))
def test_a_gap_on_the_rise_enters_the_deviation_and_is_reported(
    sampled: Any, begins_ms: int
) -> None:
    """The dead band hides 19 ms of the arm's rise, whose 63 % time is 20.6 ms."""
    arm = sampled(0.002)
    u = np.where(np.arange(2500) < 500, 0.5, 4.5)
    data = arm.dataset(u, std=5e-4)
    t = 2 * (np.arange(2500) - 500)
    gap = (t > begins_ms) & (t < begins_ms + 19)
    whole, cut = (
        step_analysis(Dataset(u=u, y=data.y, Ts=0.002, valid=v, output="theta_1"))
        for v in (np.ones(2500, bool), ~gap)
    )

    assert abs(cut.tau - 0.0206) < 3 * cut.tau_std
    assert cut.equivalent_time == whole.equivalent_time
    assert abs(cut.equivalent_time - 0.07237) < 3 * cut.equivalent_time_std
    told = [w for w in cut.warnings if "on the rise" in w]
    if begins_ms < 20:
        assert cut.hidden == pytest.approx((begins_ms / 1e3, begins_ms / 1e3 + 0.02), abs=0.0021)
        assert "armrig collect step --at" in told[0]
    else:
        assert cut.hidden is None
        assert not told
    if begins_ms == 18:
        assert cut.tau_std > 1.3 * whole.tau_std
    assert whole.hidden is None


def shown(arm: Any, seed: int, *, after: int, hidden: slice = slice(0)) -> Dataset:
    """Return a step of 1 V as 10 bits show it, `hidden` samples missing; it begins at 250."""
    resolution = np.radians(352) / 1024
    u = np.where(np.arange(250 + after) < 250, 0.5, 1.5)
    noise = 0.5 * np.random.default_rng(seed).standard_normal(u.size)
    y = np.round(arm.dataset(u).y / resolution + noise) * resolution
    valid = np.ones(u.size, bool)
    valid[hidden] = False
    return Dataset(u=u, y=y, Ts=arm.Ts, valid=valid, output="theta_1", unit="rad")


@pytest.mark.parametrize("begins", [401, 501, 651, 851, 1001])
def test_a_dead_band_after_the_step_does_not_delay_the_settling_time(
    sampled: Any, begins: int
) -> None:
    """The settling time is 0.372 s; gaps of 75 ms made it 0.795, 1.283 and 1.495 s."""
    data = shown(sampled(0.002), 2, after=1250, hidden=slice(begins, begins + 37))

    found = step_analysis(data)

    assert found.settling == pytest.approx(0.372, rel=0.05)
    assert abs(found.settling - 0.372) < 3 * found.settling_std
    assert f"within 5 % after {with_std(found.settling, found.settling_std)} s" in repr(found)


def test_a_smooth_onset_is_not_a_dead_time(sampled: Any) -> None:
    """Noise made the dead time 17 ms, and the 63 % time 7.7 ms instead of 20.6 ms."""
    found = step_analysis(shown(sampled(0.002), 31, after=650))

    assert found.dead_time == 0.0
    assert found.dead_time_interval[0] == 0.0
    assert abs(found.tau - 0.0206) < 2 * found.tau_std


def test_the_smoothed_response_begins_after_the_step(sampled: Any) -> None:
    found = step_analysis(shown(sampled(0.01), 1, after=250))

    assert found.smooth_t[0] > 0
    assert found.smooth[0] < 0.3 * found.gain
    assert found.smooth.shape == found.smooth_t.shape == found.smooth_std.shape
    assert found.smooth_std.max() < 0.2 * found.gain


def test_a_dead_time_lies_inside_its_interval() -> None:
    """The estimate of this record was 0 s once; the dead time is 12 s."""
    rng = np.random.default_rng(26)
    u, t = np.repeat([0.0, 50.0], [100, 700]), np.arange(800) - 112.0
    y = 22 + 40 * (1 - np.exp(-np.maximum(t, 0) / 99.5)) + 0.45 * rng.standard_normal(800)

    found = step_analysis(Dataset(u=u, y=y, Ts=1.0), integrator=False)

    low, high = found.dead_time_interval
    assert found.dead_time == pytest.approx(12, abs=high - low)
    assert high - low < 2
    assert found.tau == pytest.approx(99.5, abs=2 * found.tau_std)
    assert f"dead time {found.dead_time:.4g} s (95 %: {low:.4g} … {high:.4g} s)" in repr(found)


@pytest.mark.parametrize(("zeros", "shown"), [(2, True), (10, False), (30, False)])
def test_the_interval_excludes_0_only_if_a_dead_time_is_shown(zeros: int, shown: bool) -> None:
    delays = np.append(np.zeros(zeros), np.linspace(7, 12, DRAWS - zeros))
    answer = _answer_of(delays, zeros / DRAWS)

    low, high = answer.dead_time_interval

    assert (low > 0, answer.dead_time > 0) == (shown, shown)
    assert low <= answer.dead_time <= high


def heated(length: float, noise: float = 0.05, Ts: float = 1.0) -> Dataset:
    """Return TCLab's step of 50 %, held for `length` time constants: 175 s, and 15 s dead time."""
    n = round(175 * length / Ts)
    t = np.maximum(Ts * np.arange(-100, n) - 15.0, 0.0)
    y = 23 + 30 * (1 - np.exp(-t / 175)) + noise * np.random.default_rng(1).standard_normal(t.size)
    u = np.repeat([0.0, 50.0], [100, n])
    return Dataset(u=u, y=0.3 * np.round(y / 0.3), Ts=Ts, output="heat")


@pytest.mark.parametrize(
    ("length", "Ts"),
    [
        (2.0, 1.0),
        *(
            pytest.param(*x, marks=pytest.mark.exhaustive)
            for x in ((5.0, 1.0), (12.0, 1.0), (6.0, 0.1))
        ),
    ],
)
def test_a_heater_has_the_numbers_of_a_process(length: float, Ts: float) -> None:
    """The gain was 23 to 32 deviations too small, and the dead time was in the time constant."""
    found = step_analysis(heated(length, Ts=Ts))

    assert (found.form, found.rate) == ("P1D", False)
    assert abs(found.gain - 0.6) < 3 * found.gain_std < 0.02
    low, high = found.dead_time_interval
    assert 12 < low < found.dead_time < high < 16
    assert found.dead_time == pytest.approx(15, abs=0.75 * (high - low))
    for value, std in ((found.tau, found.tau_std), (found.equivalent_time, found.tau_std)):
        assert abs(value - 175) < 3 * std < 10
    assert any("of its final value" in w for w in found.warnings) is (length == 2)
    assert repr(found).splitlines()[0].endswith(", P1D fit")


def test_what_a_step_leaves_open_is_not_determined() -> None:
    """The record ends after a third of a time constant: only the dead time is known."""
    found = step_analysis(heated(0.3, noise=0.5), integrator=False)

    assert np.isnan([found.gain, found.tau, found.equivalent_time, found.settling]).all()
    low, high = found.gain_interval
    assert low < 0.6 < high
    assert found.dead_time == pytest.approx(15, abs=3)
    assert f"gain not determined (95 %: {low:.4g} … {high:.4g}" in repr(found)
    assert "63 % time not determined\n" in repr(found)
    with pytest.raises(InputError, match=r"ends before heat settles, .*: hold u longer after"):
        sampling_time(heated(0.3, noise=0.5), integrator=False)


@pytest.mark.parametrize("length", [0.6, 0.9])
def test_a_response_that_ends_early_is_still_no_rate(length: float) -> None:
    found = step_analysis(heated(length, noise=0.02))

    assert not found.rate
    assert np.isnan(found.gain)


def test_two_time_constants_are_reported_if_both_are_sure() -> None:
    u = np.repeat([0.0, -2.0], [80, 400])
    t = np.maximum(np.arange(-80, 400) - 20.5, 0.0)
    y = 3.0 * (1 - (50 * np.exp(-t / 50) - 15 * np.exp(-t / 15)) / 35)
    y += 0.02 * np.random.default_rng(2).standard_normal(480)

    found = step_analysis(Dataset(u=u, y=y, Ts=1.0))

    assert found.form == "P2D"
    for value, std, true in zip(
        found.time_constants, found.time_constants_std, (50, 15), strict=True
    ):
        assert abs(value - true) < 3 * std < true / 3
    assert "time constant 2 " in repr(found)


@pytest.mark.parametrize(("length", "known"), [(40.0, True), (8.0, False)])
def test_a_response_that_is_no_process_has_not_its_numbers(length: float, known: bool) -> None:
    """A fast and a slow part: the last third of a short record is not the final value."""
    t = np.linspace(0, length, 400)
    y = 1 - 0.5 * np.exp(-t) - 0.5 * np.exp(-t / 10)
    y = np.append(np.zeros(150), y) + 0.005 * np.random.default_rng(1).standard_normal(550)
    u = np.repeat([0.0, 1.0], [151, 399])

    found = step_analysis(Dataset(u=u, y=y, Ts=float(t[1])), integrator=False)

    assert found.form == ""
    assert any("has not settled" in w for w in found.warnings) is not known
    assert np.isnan(found.gain) or abs(found.gain - 1) < 4 * found.gain_std


@pytest.mark.parametrize("at", [20, 150])
def test_the_deviation_of_a_gain_contains_the_level_before_the_step(at: int) -> None:
    """A zero at +1/3 makes the response none of a process; gain 1, noise 0.01."""
    F = np.poly(np.exp([-0.025, -0.05]))
    B = np.array([0.0, -0.0362, 0.0374])
    B *= F.sum() / B.sum()
    u = np.concatenate([np.full(at, 1.0), np.full(450, 3.0)])
    y = apply_filter(B, F, u - 1)
    seeds = range(20)

    found = [
        step_analysis(Dataset(u=u, y=y + 0.01 * _white(seed, u.size), Ts=0.1)) for seed in seeds
    ]

    errors = np.array([(step.gain - 1) / step.gain_std for step in found])
    assert all(step.form == "" for step in found)
    assert np.count_nonzero(np.abs(errors) > 1.96) <= 4
    assert np.sqrt(np.mean(errors**2)) > 0.6


@pytest.mark.parametrize(("N", "at"), [(300, 50), (800, 200)])
def test_the_deviation_of_a_rate_is_that_of_the_angle_s_ends(N: int, at: int) -> None:
    """The noise of the angle is white, so that the errors of successive rates cancel."""
    u, a = np.repeat([1.0, 3.0], [at, N - at]), np.exp(-0.01 / 0.08)
    rate = apply_filter([0, GAIN * (1 - a)], [1, -a], u - 1) + GAIN
    errors = []
    for seed in range(20):
        angle = 0.01 * np.cumsum(rate) + 0.003 * _white(seed, N)
        found = step_analysis(Dataset(u=u, y=angle, Ts=0.01), integrator=True)
        errors.append((found.gain - GAIN) / found.gain_std)

    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.6


@pytest.mark.parametrize("colour", [0.6, 0.9])
def test_slow_noise_is_no_overshoot_and_widens_the_deviations(colour: float) -> None:
    """P1D: gain 2, 5 s, dead time 0.7 s; of 12 records one or two may lie outside."""
    outside, above = np.zeros(3), 0
    for seed in range(12):
        u = np.repeat([1.0, 3.0], [100, 500])
        a, white = np.exp(-0.02), np.sqrt(1 - colour**2) * _white(seed, 1600)
        y = apply_filter([*np.zeros(8), 2 * (1 - a)], [1, -a], u - 1)
        y += 0.05 * apply_filter([1.0], [1, -colour], white)[1000:]

        found = step_analysis(Dataset(u=u, y=y, Ts=0.1))

        tau = found.tau if found.dead_time else found.tau - 0.35
        errors = [
            (found.gain - 2) / found.gain_std,
            (tau - 5) / found.tau_std,
            (found.settling - 5 * np.log(20) - 0.7) / found.settling_std,
        ]
        outside += np.abs(errors) > 1.96
        above += "overshoot" in repr(found) and "no visible" not in repr(found)
    assert (outside <= 2).all()
    assert above <= 1


def test_the_deviation_of_a_gain_contains_the_step_of_a_converter() -> None:
    """Six steps between the same levels have the same error of rounding."""
    levels = [0.0, 2.0, 0.0, 2.0, 0.0, 2.0, 0.0]
    u = np.repeat(levels, [150, *[300] * 6])
    y = apply_filter([0, 1.93 * (1 - np.exp(-0.02))], [1, -np.exp(-0.02)], u) + 20.1

    found = step_analysis(Dataset(u=u, y=np.round(y / 0.5) * 0.5, Ts=0.1))

    assert abs(found.gain - 1.93) < 1.96 * found.gain_std < 0.3
    assert abs(found.equivalent_time - 5) < 1.96 * found.equivalent_time_std


def test_a_fit_does_not_extrapolate_from_half_of_the_final_value() -> None:
    """Three equal time constants look like P2D with a dead time until the record ends."""
    u = np.repeat([1.0, 3.0], [50, 100])
    F = np.poly(np.full(3, np.exp(-0.1 / 3)))
    y = apply_filter([0, 2 * F.sum()], F, u - 1) + 0.01 * _white(1, 150)

    found = step_analysis(Dataset(u=u, y=y, Ts=0.1))

    assert np.isnan([found.gain, found.tau, found.settling]).all()
    assert "gain not determined\n" in repr(found)
    assert "dead time not determined (95 %: 0 …" in repr(found)


def _white(seed: int, N: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).standard_normal(N)
