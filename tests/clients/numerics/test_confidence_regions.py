"""Regions of 95 %: where the linearisation holds, and where draws replace it."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.numerics.confidence_regions import (
    HALF_WIDTH,
    RADIUS,
    RootDraws,
    band,
    choose_region,
    linear_band,
    region_of_draws,
    regions,
    root_draws,
)
from numpy.typing import NDArray
from scipy.special import ndtri

Z = ndtri((np.arange(400) + 0.5) / 400)
"""Normal draws without chance: the quantiles in the middle of 400 equal shares."""
SKEWED = {
    "to both sides": np.sinh(Z),
    "upwards": np.where(Z > 0, 2 * Z, Z),
    "downwards": np.where(Z < 0, 2 * Z, Z),
}


def test_a_band_is_1_96_deviations_wide_on_both_sides_but_not_below_its_least() -> None:
    found = linear_band([1.0, 5.0], [2.0, 0.5], least=0.0)

    assert found.low == pytest.approx([0.0, 5 - 0.5 * HALF_WIDTH])
    assert found.high == pytest.approx([1 + 2 * HALF_WIDTH, 5 + 0.5 * HALF_WIDTH])
    assert found.contains([0.0, 4.0]).tolist() == [True, False]
    assert found.contains(found.high).all()
    assert not found.contains(found.high + 1e-9).any()


@pytest.mark.parametrize("draws", SKEWED.values(), ids=SKEWED.keys())
def test_draws_replace_a_band_if_they_leave_it_on_any_side(draws: NDArray[np.float64]) -> None:
    """Only the last of three numbers is skewed; all three then come from the draws."""
    samples = np.column_stack([Z, 3 + 0.5 * Z, -7 + 0.1 * draws])
    value, std = [0.0, 3.0, -7.0], [1.0, 0.5, 0.1]

    found, first = band(value, std, samples), band(value[:2], std[:2], samples[:, :2])

    assert (found.method, first.method) == ("sampled", "linearised")
    assert first.low == pytest.approx(np.array([0.0, 3.0]) - HALF_WIDTH * np.array([1.0, 0.5]))
    low, high = np.quantile(draws, [0.025, 0.975])
    assert (found.low[2], found.high[2]) == pytest.approx((-7 + 0.1 * low, -7 + 0.1 * high))
    assert found.high[1] == pytest.approx(3 + 0.5 * np.quantile(Z, 0.975))


def test_a_band_without_enough_draws_is_unknown() -> None:
    few, enough = (band([0.0], [1.0], Z[:: 400 // n, None]) for n in (80, 100))

    assert few.method == "sampled"
    assert np.isnan([few.low, few.high]).all()
    assert np.isfinite([enough.low, enough.high]).all()
    assert band([0.0], [1.0], None).method == "linearised"
    assert band([1.0], [0.0], np.ones((400, 1))).method == "linearised"  # a known number


SLANTED = np.array([[4e-4, 3e-4], [3e-4, 9e-4]])
CENTRE = 0.5 + 0.4j


def drawn(z: complex, P: NDArray[np.float64], n: int = 1000) -> NDArray[np.complex128]:
    """Return normal draws of a root with the covariance P of real and imaginary part."""
    x = np.random.default_rng(1).standard_normal((2, n))
    x -= x.mean(axis=1, keepdims=True)
    x = np.linalg.solve(np.linalg.cholesky(np.cov(x)), x)
    parts = np.linalg.cholesky(P) @ x
    return np.asarray(z + parts[0] + 1j * parts[1])


def test_a_pair_with_normal_draws_has_an_ellipse_and_its_mirror_image() -> None:
    """The covariance of the lower root has the other sign off its diagonal."""
    mirror = np.diag([1.0, -1.0])
    upper = drawn(CENTRE, SLANTED)
    both = np.column_stack([upper, upper.conj()])

    found = regions(
        np.array([CENTRE, CENTRE.conjugate()]),
        np.array([SLANTED, mirror @ SLANTED @ mirror]),
        both[:, ::-1],
    )

    assert [region.method for region in found] == ["linearised"] * 2
    for region, z in zip(found, both.T, strict=True):
        inside = np.mean([region.contains(complex(one)) for one in z])
        assert inside == pytest.approx(0.95, abs=0.02)
        border = region.border()
        assert border is not None
        off = border - np.array([[region.centre.real], [region.centre.imag]])
        size = np.sqrt(np.sum(off * np.linalg.solve(region.covariance, off), axis=0))
        np.testing.assert_allclose(size, RADIUS)


@pytest.mark.parametrize("wider", [0.5, 2.0])
def test_a_pair_whose_draws_are_wider_or_narrower_has_a_region_of_draws(wider: float) -> None:
    z = drawn(CENTRE, wider**2 * SLANTED)
    draws = RootDraws(pairs=z, reals=np.zeros(0))

    region = choose_region(CENTRE, SLANTED, draws)

    assert (region.method, region.interval, region.border()) == ("sampled", None, None)
    assert region.densest is not None
    assert region.densest.inside().size / z.size == pytest.approx(0.95, abs=0.01)
    assert np.mean([region.contains(complex(one)) for one in z]) > 0.94
    assert region.contains(CENTRE.conjugate())  # the region of a pair has both halves
    assert not region.contains(CENTRE + 8 * wider * 0.03)


def test_a_real_root_has_an_interval_on_the_axis() -> None:
    P = np.diag([0.01, 0.0])
    sound = choose_region(0.5, P, RootDraws(pairs=np.zeros(0, complex), reals=0.5 + 0.1 * Z))
    skewed = choose_region(
        0.5, P, RootDraws(pairs=np.zeros(0, complex), reals=0.5 + 0.1 * SKEWED["downwards"])
    )

    assert (sound.method, skewed.method) == ("linearised", "sampled")
    assert sound.interval == pytest.approx((0.5 - 0.1 * HALF_WIDTH, 0.5 + 0.1 * HALF_WIDTH))
    assert skewed.interval is not None
    assert skewed.interval[0] == pytest.approx(0.5 + 0.2 * np.quantile(Z, 0.025))
    assert [sound.contains(z) for z in (0.35, 0.65, 0.75, 0.5 + 0.01j)] == [
        True,
        True,
        False,
        False,
    ]
    assert skewed.contains(0.2)
    assert not skewed.contains(0.75)


def test_roots_that_are_a_pair_in_some_draws_have_a_region_and_an_interval() -> None:
    """A kind that has less than a two-hundredth of the draws is ignored."""
    z = drawn(0.5 + 0.1j, 1e-3 * np.eye(2), 199)
    z = z.real + 1j * np.abs(z.imag)

    for pairs, reals in ((z, 0.5 + 0.1 * Z[:300]), (z[:1], 0.5 + 0.1 * Z), (z, Z[:0])):
        found = region_of_draws(0.5, np.eye(2), RootDraws(pairs=pairs, reals=reals))

        assert (found.densest is not None) == (pairs.size > 1)
        assert (found.interval is not None) == (reals.size > 0)
        if reals.size:
            assert found.interval == pytest.approx(np.quantile(reals, [0.025, 0.975]))


def test_too_few_draws_leave_a_region_unknown_and_a_known_root_needs_none() -> None:
    few = RootDraws(pairs=np.zeros(0, complex), reals=0.5 + 0.1 * Z[:99])

    for z, P in ((0.5 + 0j, np.diag([0.01, 0.0])), (CENTRE, SLANTED)):
        unknown = choose_region(z, P, few)
        assert unknown.method == "sampled"
        assert np.isnan(unknown.covariance).all()
        assert (unknown.interval is None) == (z.imag != 0)
        assert not unknown.contains(z)
    assert choose_region(1.0, np.zeros((2, 2)), few).method == "linearised"


def test_each_root_of_a_draw_belongs_to_the_nearest_of_the_estimate() -> None:
    """If a pair became two real roots, each root of the pair has both."""
    centres = np.array([0.9, 0.5 + 0.1j, 0.5 - 0.1j])
    draws = np.array(
        [[0.5 - 0.2j, 0.91, 0.5 + 0.2j], [0.4, 0.6, 0.89], [0.52 + 0.1j, 0.52 - 0.1j, 0.9]]
    )

    real, upper, lower = root_draws(centres, draws)

    assert real.reals.tolist() == [0.91, 0.89, 0.9]
    assert real.pairs.size == 0
    for root in (upper, lower):
        assert root.pairs.tolist() == [0.5 + 0.2j, 0.52 + 0.1j]
        assert sorted(root.reals) == [0.4, 0.6]
        assert root.upper.size == 4
