"""Treatment of data: its removals and its limits."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from armrig.data.dataset import Dataset, Signals
from armrig.data.merging import merge
from armrig.data.step import LINE, MEAN, codes_of
from armrig.data.treatment import IntegratingOutputWarning, detrend, difference, drift, retrend
from armrig.excitation import telegraph
from armrig.numerics.polynomial import apply_filter
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

finite = st.floats(-1e3, 1e3).map(lambda x: x if abs(x) > 1e-20 else 0.0)  # as data may be


numbers = arrays(np.float64, (4, 30), elements=finite)
masks = arrays(np.bool_, (2, 30))
SHAPES = pytest.mark.parametrize("shape", [(1, 1), (2, 1), (2, 2)], ids=str)


def of_shape(
    shape: tuple[int, int], x: NDArray[np.float64], valid: NDArray[np.bool_], Ts: float
) -> Signals:
    """Return two experiments of nu inputs and ny outputs."""
    nu, ny = shape
    assume(ny == 1 or valid.any(axis=1).all())
    return Signals(u=x[:nu].T, y=x[2 : 2 + ny].T, Ts=Ts, valid=valid[:ny].T, starts=(0, 12))


@SHAPES
@settings(max_examples=40)
@given(numbers, masks, st.integers(0, 1))
def test_detrending_twice_changes_nothing(
    shape: tuple[int, int], x: NDArray[np.float64], valid: NDArray[np.bool_], order: int
) -> None:
    data = of_shape(shape, x, valid, Ts=1.0)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IntegratingOutputWarning)
        once = detrend(data, order)
        twice = detrend(once, order)

    np.testing.assert_allclose(twice.u, once.u, atol=1e-9)
    np.testing.assert_allclose(twice.y, once.y, atol=1e-9)


def test_each_experiment_loses_its_own_mean() -> None:
    """A level common to all would leave a step at the boundary."""
    data = merge([Dataset(u=[1, 3], y=[5, 7], Ts=1), Dataset(u=[10, 12], y=[0, 4], Ts=1)])

    treated = detrend(data)

    np.testing.assert_allclose(treated.y, [-1, 1, -2, 2])
    np.testing.assert_allclose(treated.u, [-1, 1, -1, 1])
    assert treated.history == (
        "merged 2 parts of 2, 2 samples",
        "removed the mean from u and y of each experiment (order 0)",
    )


def test_a_treatment_keeps_its_code_in_merged_data() -> None:
    data = Dataset(u=np.arange(9.0), y=np.arange(9.0) ** 2, Ts=1)

    merged = merge([detrend(data), data])

    assert codes_of(detrend(data, order=1).history) == [LINE]
    assert merged.history[0].startswith("part 1: removed the mean")
    assert codes_of(merged.history) == [MEAN, ""]


def test_a_line_removed_from_the_angle_causes_a_warning() -> None:
    """theta_1 integrates by construction."""
    data = Dataset(u=np.ones(50), y=np.arange(50.0), Ts=1, output="theta_1")

    with pytest.warns(IntegratingOutputWarning, match="theta_1 integrates its input"):
        treated = detrend(data, order=1)

    assert treated.history[-1].endswith("(order 1), although theta_1 integrates its input")


@pytest.mark.parametrize("seed", range(5))
def test_an_integrator_without_a_name_is_found_by_test(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = telegraph(1000, 0.1, seed=rng)
    y = apply_filter([0, 0.1], [1, -1.5, 0.5], u) + 0.005 * rng.standard_normal(1000)

    with pytest.warns(IntegratingOutputWarning, match="is not seen to return"):
        detrend(Dataset(u=u, y=y, Ts=0.01), order=1)


@pytest.mark.parametrize("seed", range(5))
def test_a_drift_under_a_stable_output_may_be_removed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = telegraph(1000, 0.1, seed=rng)
    t = np.arange(1000)
    y = apply_filter([0, 0.1], [1, -0.9], u) + 0.1 * rng.standard_normal(1000) + 0.02 * t

    treated = detrend(Dataset(u=u, y=y, Ts=0.01), order=1)

    np.testing.assert_allclose(treated.y, y - np.polyval(np.polyfit(t, y, 1), t), atol=1e-9)


def test_a_difference_is_missing_if_a_neighbour_is_missing() -> None:
    data = Dataset(
        u=np.zeros(7),
        y=[0, 1, 3, 6, 10, 0, 2],
        Ts=0.5,
        valid=[True, True, True, False, True, True, True],
        starts=(0, 5),
        output="theta_1",
        unit="rad",
    )

    velocity = difference(data)

    np.testing.assert_array_equal(velocity.y, [np.nan, 2, 4, np.nan, np.nan, np.nan, 4])
    assert (velocity.output, velocity.unit) == ("velocity", "rad/s")


@SHAPES
@settings(max_examples=40)
@given(numbers, masks, st.lists(st.integers(0, 1), min_size=1, max_size=3))
def test_retrend_restores_the_removed_trends(
    shape: tuple[int, int], x: NDArray[np.float64], valid: NDArray[np.bool_], orders: list[int]
) -> None:
    data = of_shape(shape, x, valid, Ts=0.1)

    treated = data
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IntegratingOutputWarning)
        for order in orders:
            treated = detrend(treated, order)
    back = retrend(treated)

    np.testing.assert_allclose(back.u, data.u, atol=1e-9)
    np.testing.assert_allclose(back.y, data.y, atol=1e-9)
    np.testing.assert_allclose(retrend(treated, treated.y), data.y, atol=1e-9)
    np.testing.assert_array_equal(back.valid, data.valid)
    assert back.trends == ()
    assert back.history[-1] == "restored the trend of u and y"


@SHAPES
@settings(max_examples=40)
@given(st.integers(0, 28), st.integers(1, 29), st.integers(1, 5))
def test_a_part_of_the_data_keeps_its_part_of_the_trend(
    shape: tuple[int, int], a: int, length: int, k: int
) -> None:
    rng, (nu, ny) = np.random.default_rng(3), shape
    y = 5 + 0.3 * np.arange(30)[:, None] + rng.random((30, ny))
    data = Signals(u=rng.random((30, nu)), y=y, Ts=0.2, starts=(0, 9, 20))
    treated = detrend(data, order=1)
    b = min(a + length, 30)
    assume(b - a >= max(shape))  # fewer samples than channels are refused

    np.testing.assert_allclose(retrend(treated[a:b]).y, data.y[a:b])
    np.testing.assert_allclose(retrend(treated[a:b]).u, data.u[a:b])
    np.testing.assert_allclose(retrend(merge(treated.split(k))).y, data.y)
    np.testing.assert_allclose(retrend(treated.select(2, 0)).y, data.select(2, 0).y)
    np.testing.assert_allclose(retrend(merge([data, treated])).y, np.concatenate([data.y, data.y]))


def test_a_simulated_output_gets_the_level_of_the_measured_one() -> None:
    """The model was identified about the mean and does not contain the level."""
    rng = np.random.default_rng(0)
    u = telegraph(400, 0.2, seed=rng)
    y = 20 + apply_filter([0, 0.5], [1, -0.5], u - 1)
    treated = detrend(Dataset(u=u, y=y, Ts=0.1))

    simulated = retrend(treated, apply_filter([0, 0.5], [1, -0.5], treated.u))

    # From another start, forgotten after 60 samples.
    np.testing.assert_allclose(simulated[60:], y[60:], atol=0.05)
    with pytest.raises(ValueError, match="y has 3 samples and the data have 400"):
        retrend(treated, [1, 2, 3])


def test_a_trend_follows_the_data_to_their_velocity() -> None:
    """The slope of the line becomes the level of the velocity."""
    data = Dataset(u=[1, 2, 4, 3.0], y=[0, 3, 5, 9.0], Ts=0.5)
    treated = detrend(data, order=1)

    np.testing.assert_allclose(retrend(difference(treated)).y, difference(data).y)
    np.testing.assert_allclose(retrend(difference(treated)).u, data.u)


def drifting(seed: int, rate: float, N: int = 1500) -> Dataset:
    """Return a stable output under a slow input and coloured noise, drifting."""
    rng = np.random.default_rng(seed)
    u = telegraph(N, 0.01, seed=rng)
    v = apply_filter([1], [1, -0.9], 0.05 * rng.standard_normal(N))
    y = apply_filter([0, 0.1], [1, -0.9], u) + v + rate * 0.1 * np.arange(N)
    return Dataset(u=u, y=y, Ts=0.1, unit="V")


@pytest.mark.exhaustive
@pytest.mark.parametrize("rate", [0.0, 0.01])
def test_a_drift_is_separated_from_the_response_to_the_input(rate: float) -> None:
    """|z| of the error exceeds 1.96 in 5 % of 200 runs."""
    found = [drift(drifting(seed, rate))[0] for seed in range(200)]

    z = np.array([(d.rate - rate) / d.std for d in found])
    alarms = np.mean(np.abs(z) > 1.96)
    assert abs(alarms - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 200), alarms
    assert abs(np.mean(z)) < 4 / np.sqrt(200)
    assert str(found[0]).startswith("a drift: 0.0" if rate else "no significant drift: ")


def test_each_experiment_has_its_own_drift_and_gaps_are_left_out() -> None:
    parts = [drifting(1, 0.02), drifting(2, -0.02)]
    holed = parts[0].replaced(valid=np.arange(1500) % 100 != 3, step=None)

    first, second = drift(merge([holed, parts[1]]))

    assert first.rate == pytest.approx(0.02, abs=4 * first.std)
    assert second.rate == pytest.approx(-0.02, abs=4 * second.std)
    assert first.z > 2.58 > -2.58 > second.z
    assert first.unit == "V"


def test_each_output_has_a_drift_and_all_inputs_explain_it() -> None:
    """The second input rises slowly: without it, its effect would be a drift."""
    still, drifts = drifting(1, 0.0), drifting(1, 0.02)
    slow = 0.001 * np.arange(still.N) + 0.1 * telegraph(still.N, 0.1, seed=5)
    y = np.column_stack([still.y + apply_filter([0, 0.2], [1, -0.9], slow), drifts.y])
    names = {"outputs": ["flow", "level"], "units": ["l/s", "V"]}
    signals = Signals(u=np.column_stack([still.u, slow]), y=y, Ts=0.1, **names)  # type: ignore[arg-type]

    alone = drift(signals.channels("level", "u1"))
    first, second = drift(signals)

    assert alone == drift(drifts.replaced(step=None, output="level"))
    assert (first.output, second.output) == ("flow", "level")
    assert abs(first.z) < 2.58 < second.z
    assert abs(drift(signals.channels("flow", "u1"))[0].z) > 2.58


def test_data_whose_gaps_leave_too_few_rows_have_no_drift() -> None:
    """The drift was 0 ± 0 for any data."""
    data = drifting(1, 0.02, N=300)
    full_of_gaps = data.replaced(step=None, valid=np.arange(data.N) % 4 > 0)

    with pytest.raises(ValueError, match=r"has 0 samples after 10 samples without .* needs 40"):
        drift(full_of_gaps)

    assert np.isfinite(drift(full_of_gaps, 2)[0].z)


def test_an_angle_has_an_input_offset_instead_of_a_drift() -> None:
    angle = Dataset(u=np.ones(90), y=np.arange(90.0), Ts=1, output="theta_1")

    with pytest.raises(ValueError, match=r"theta_1 integrates its input.*free\[0\].offset"):
        drift(angle)
