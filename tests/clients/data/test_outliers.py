"""Outliers are found where the dynamics are taken out, and never filled."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.data.columns import Vector
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.data.treatment import hampel
from armrig.data.treatment.outliers import quantum, too_quiet
from armrig.data.treatment.wrong_samples import _gross
from armrig.excitation import telegraph
from armrig.numerics.polynomial import apply_filter
from numpy.typing import NDArray

STD = 0.01
FIVE = [101, 333, 334, 900, 1500]


def clean(seed: int, N: int = 2000, *, noise: str = "of the output") -> Dataset:
    """Return a resonant output that jumps as u does, under white noise, of it or inside."""
    rng = np.random.default_rng(seed)
    u = telegraph(N, 0.05, seed=rng)
    v = STD * rng.standard_normal(N)
    if noise == "of the equation":
        v = apply_filter([1], [1, -1.5, 0.7], v)
    return Dataset(u=u, y=apply_filter([0, 0.1, 0.05], [1, -1.5, 0.7], u) + v, Ts=0.01)


def spoilt(data: Dataset, where: list[int], size: float) -> Dataset:
    y = data.y.copy()
    y[where] += size * np.where(np.arange(len(where)) % 2 == 0, 1.0, -1.0)
    return data.replaced(y=y, step=None)


def marked(data: Dataset, treated: Dataset) -> list[int]:
    return np.flatnonzero(data.valid & ~treated.valid).tolist()


@pytest.mark.parametrize(
    ("noise", "seed"), [("of the output", 1), ("of the equation", 1), ("of the equation", 19)]
)
def test_outliers_are_found_and_their_neighbours_are_not(noise: str, seed: int) -> None:
    """Single samples, a pair and three in a row, with errors far smaller than the range of y.

    With the seed 19 the search also marks a right sample, and later removes the mark.
    """
    where = [200, 700, 701, 1203, 1204, 1205, 1500]
    data = spoilt(clean(seed, noise=noise), where, 12 * STD)

    assert marked(data, hampel(data)) == where
    assert np.ptp(data.y) > 20 * 12 * STD


@pytest.mark.parametrize(
    ("where", "size"), [*((FIVE, size) for size in (1.0, 1e2, 1e4, 1e6)), ([700], 30.0)]
)
def test_outliers_of_any_size_do_not_mark_a_correct_sample(where: list[int], size: float) -> None:
    """A model fitted to samples a million times too large would describe only these.

    One sample of six times the range of y spoilt the model, and 100 right samples were marked.
    """
    assert marked(clean(3), hampel(spoilt(clean(3), where, size))) == where


def test_outliers_do_not_depend_on_the_unit_of_y() -> None:
    """A current in ampere is as small as 1e-10."""
    data = spoilt(clean(3), [400, 900], 1.0)
    small = data.replaced(y=1e-10 * data.y, step=None)

    assert marked(small, hampel(small)) == marked(data, hampel(data)) == [400, 900]


def test_a_rare_pulse_caused_by_the_input_is_not_an_outlier() -> None:
    u = np.zeros(2000)
    u[[300, 900, 1400]] = 5.0
    y = apply_filter([0, 1.0, 0.5], [1.0], u) + 1e-4 * np.random.default_rng(1).standard_normal(
        2000
    )
    data = Dataset(u=u, y=y, Ts=0.01)

    assert marked(data, hampel(data)) == []


@pytest.mark.parametrize("rig", [(-0.007, 0.0, 9.0), (-0.716, 1.0, 9.0), (-0.8, 0.0, 3.3)])
def test_right_samples_are_not_outliers(rig: tuple[float, float, float]) -> None:
    """A fast plant starts in motion, noise grows with u, or a sensor saturates."""
    records, (f1, growth, rail) = 0, rig
    for rng in map(np.random.default_rng, range(8)):
        u = telegraph(1200, 0.05, seed=rng)
        y = apply_filter([0, 1 + f1], [1, f1], u)
        y += STD * (1 + growth * (u - 0.5)) * rng.standard_normal(1200)
        data = Dataset(u=u, y=np.minimum(y, rail), Ts=0.1)[200:]
        records += bool(marked(data, hampel(data)))
    assert records <= 1
    assert marked(data, hampel(spoilt(data, [501], 60 * STD))) == [501]


def test_hampel_changes_and_inserts_no_value() -> None:
    data = spoilt(clean(2), [400], 1.0)
    treated = hampel(data)

    assert np.isnan(treated.y[400])
    np.testing.assert_array_equal(treated.y[treated.valid], data.y[treated.valid])
    np.testing.assert_array_equal(treated.u, data.u)


@pytest.mark.parametrize(("count", "end"), [(10, "1360, 1500)"), (11, "1360, 1500, …)")])
def test_the_list_of_outliers_ends_in_an_ellipsis_only_if_it_is_cut(count: int, end: str) -> None:
    data = spoilt(clean(3), list(range(240, 240 + 140 * count, 140)), 1.0)
    treated = hampel(data, threshold=6.0, order=12)

    assert f"marked {count} of 2000 samples" in treated.history[0]
    assert end in treated.history[0]


def test_coloured_residuals_raise_no_more_alarms(plant: Any) -> None:
    """White noise on an angle leaves coloured residuals; the chance of an alarm stays 5 %.

    With a spread taken 15 % too small there were alarms in 24 of the 50.
    """
    records = [plant.dataset(seed) for seed in range(50)]
    alarms = sum(bool(marked(data, hampel(data))) for data in records)

    assert alarms <= 2.5 + 4 * np.sqrt(50 * 0.05 * 0.95), alarms


def test_the_wraps_of_an_angle_are_not_outliers(plant: Any) -> None:
    """theta_1 runs over many turns; a sample that is wrong by 60 mrad is found."""
    data = plant.dataset(4)
    valid = np.arange(3000) % 150 >= 4
    data = spoilt(data.replaced(valid=valid, step=None), [1010, 1900], 0.06)
    treated = hampel(data)
    assert np.ptp(data.y[data.valid]) > 6 * np.pi
    assert marked(data, treated) == [1010, 1900]
    assert not treated.valid[~valid].any()


@pytest.mark.parametrize("after", [0, 1, 7, 19])
def test_a_wrong_sample_after_a_gap_is_found_as_any_other(after: int) -> None:
    """The 20 samples after a gap have no residuals; later residuals show the error."""
    valid = (np.arange(2000) < 700) | (np.arange(2000) >= 704)
    data = clean(3).replaced(valid=valid, step=None)
    where = [after, 704 + after]
    assert marked(data, hampel(spoilt(data, where, 1.0))) == where


def test_each_experiment_is_searched_separately() -> None:
    first, second = clean(5), clean(6)
    high = second.replaced(y=second.y + 3.0, step=None)
    both = merge([spoilt(first, [50], 0.5), spoilt(high, [1000], 0.5)])

    assert marked(both, hampel(both)) == [50, 3000]


@pytest.mark.parametrize(
    "y",
    [
        np.zeros(300),
        np.linspace(0.0, 1.0, 300),
        apply_filter([0, 0.1, 0.05], [1, -1.5, 0.7], telegraph(300, 0.02)),
    ],
)
def test_rounding_errors_are_not_outliers(y: NDArray[np.float64]) -> None:
    """Without noise the robust standard deviation consists of rounding errors."""
    data = Dataset(u=telegraph(300, 0.02), y=y, Ts=0.01)

    assert marked(data, hampel(data)) == []


def test_a_record_without_enough_residuals_is_refused() -> None:
    gaps = np.arange(2000) % 12 > 1
    wild: Vector = np.random.default_rng(0).standard_cauchy(400)

    with pytest.raises(ValueError, match="too many gaps"):
        hampel(clean(0).replaced(valid=gaps, step=None))
    with pytest.raises(ValueError, match="too many for outliers"):
        hampel(Dataset(u=telegraph(400, 0.2), y=wild, Ts=1), threshold=2.0)
    with pytest.raises(ValueError, match="threshold=-1 must be > 0"):
        hampel(clean(0), threshold=-1)


def test_a_resting_reading_with_converter_steps_has_no_gross_outlier() -> None:
    """Most samples equal the median of their neighbours; the others differ by a converter step."""
    y = np.round(np.random.default_rng(5).normal(0.0, 0.4, 2000)) * 0.006
    y[700] = 50.0

    assert np.flatnonzero(_gross(y)).tolist() == [700]


@pytest.mark.parametrize(("size", "found"), [(4.0, []), (9.0, [900]), (22.0, [5, 900])])
def test_an_outlier_among_the_first_samples_needs_twice_the_deviation(
    size: float, found: list[int]
) -> None:
    """The threshold is six deviations, and twelve for samples that only later samples predict."""
    data = spoilt(clean(3, 1000), [5, 900], size * STD)

    assert marked(data, hampel(data, threshold=6.0, order=12)) == found


@pytest.mark.parametrize("step", [0.006, 0.25])
def test_the_converter_step_is_the_least_change_of_the_output(step: float) -> None:
    """Gaps and a few changes that are no multiple do not matter; many do."""
    y = step * np.random.default_rng(1).integers(-5, 6, 3000)
    data = Dataset(u=np.zeros(3000), y=y, Ts=1, valid=np.arange(3000) % 90 > 2)

    assert quantum(data) == pytest.approx(step)
    odd = y + np.where(np.arange(3000) % 100 == 0, 0.3 * step, 0.0)
    assert quantum(data.replaced(step=None, y=odd)) == 0.0
    assert quantum(data[:11]) == 0.0  # at least ten changes
    assert quantum(data.replaced(step=None, y=np.ones(3000))) == 0.0


def test_noise_is_too_quiet_below_a_third_of_a_step_of_a_resting_output() -> None:
    """The quantisation error has the variance step²/12."""
    step = 0.2
    resting = Dataset(u=np.zeros(600), y=step * np.repeat(np.arange(200) % 7, 3), Ts=1.0)
    moving = Dataset(u=np.zeros(600), y=step * (np.arange(600) % 7), Ts=1.0)
    for share, told in ((0.0, "is 0.00 of"), (0.1, "is 0.10 of"), (0.31, "0.31"), (0.33, "")):
        variance = (share * step) ** 2 + step**2 / 12
        assert told in too_quiet(resting, variance)
        assert bool(too_quiet(resting, variance)) == bool(told)
        assert too_quiet(moving, variance) == ""
    assert "rests in 66.8" in too_quiet(resting, 0.0)
    noisy = np.random.default_rng(1).standard_normal(600)
    assert too_quiet(resting.replaced(step=None, y=noisy), 1e-9) == ""
