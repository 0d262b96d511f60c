"""The best linear approximation separates noise from nonlinear distortion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig import excitation
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.estimation.nonparametric.etfe import bla, etfe, strong_lines
from armrig.numerics.polynomial import apply_filter
from numpy.typing import NDArray

P = 128


def multisine(rng: np.random.Generator, periods: int) -> NDArray[np.float64]:
    """Return periods of a sum of 40 cosines of random phases."""
    k = np.arange(1, 41)
    t = np.arange(P)
    phase = rng.uniform(0, 2 * np.pi, k.size)
    one = np.cos(2 * np.pi * np.outer(t, k) / P + phase).sum(axis=1)
    return np.tile(one / np.std(one), periods)


def realisations(
    seed: int, *, R: int = 6, periods: int = 5, std: float = 0.2, cubic: float = 0.0
) -> list[Dataset]:
    """Return the responses of a second-order system after a static nonlinearity."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(R):
        u = multisine(rng, periods)
        y = apply_filter([0, 1, 0.5], [1, -1.2, 0.6], u + cubic * u**3)
        parts.append(Dataset(u=u, y=y + std * rng.standard_normal(u.size), Ts=1.0))
    return parts


def test_a_linear_system_shows_no_distortion(second: Any) -> None:
    found = [bla(realisations(s), integrator=False) for s in range(25)]
    truth = second.response(found[0].omega)

    error = np.mean([np.abs(f.G - truth) ** 2 for f in found])
    said = np.mean([2 * f.std_magnitude**2 for f in found])
    noise = np.mean([f.noise_only_std**2 for f in found])  # type: ignore[operator]
    assert error / said == pytest.approx(1.0, abs=0.1)
    assert error / noise == pytest.approx(1.0, abs=0.1)
    assert "hardly any nonlinear distortion" in repr(found[0])


def test_a_cubic_distortion_appears_only_between_realisations() -> None:
    """Averaging over more periods lowers the noise alone."""
    few, many = (bla(realisations(1, periods=p, cubic=0.1), integrator=False) for p in (3, 41))

    for found in (few, many):
        ratio = np.mean(found.nonlinear_std**2) / np.mean(  # type: ignore[operator]
            np.abs(found.G) ** 2
        )
        assert 1e-4 < ratio < 1e-1
    assert np.mean(many.noise_only_std) < 0.4 * np.mean(few.noise_only_std)  # type: ignore[arg-type]
    assert np.median(many.nonlinear_std) > 0.5 * np.median(  # type: ignore[arg-type]
        few.nonlinear_std  # type: ignore[arg-type]
    )
    assert "the variance of the noise: nonlinear distortion" in repr(many)


def test_experiments_of_one_data_set_are_realisations() -> None:
    parts = realisations(2)
    holed = np.ones(parts[0].N, dtype=np.bool_)
    holed[2 * P + 5 : 2 * P + 9] = False
    first = Dataset(u=parts[0].u, y=parts[0].y, Ts=1.0, valid=holed)

    a, b, c = (bla(x, integrator=False) for x in (parts, merge(parts), [first, *parts[1:]]))

    np.testing.assert_array_equal(a.G, b.G)
    assert c.N == a.N - 4
    assert 0 < np.max(np.abs(c.G - a.G) / a.std_magnitude) < 1


@pytest.mark.parametrize(("hidden", "lost"), [(P // 2, P // 2), (P // 2 + 1, P)])
def test_a_period_is_used_if_half_of_its_samples_are_known(hidden: int, lost: int) -> None:
    parts = realisations(2, R=2)
    valid = np.arange(parts[0].N) - 2 * P
    holed = parts[0].replaced(valid=(valid < 0) | (valid >= hidden), step=None)

    found = bla([holed, parts[1]], integrator=False)

    known = 8 * P - lost
    assert known == found.N
    assert f"{4 - lost // P} … 4 periods of 128 samples" in found.method


def test_a_dead_band_in_every_period_removes_only_its_samples() -> None:
    """A tenth of the samples is hidden.

    80 draws of 40 lines leave an uncertainty of 2 %; the tolerance is four times that.
    """
    rng = np.random.default_rng(11)
    whole = realisations(12, R=2, periods=6)
    exact = bla(whole, integrator=False)
    errors, told = [], []
    for _ in range(80):
        parts = []
        for d in whole:
            hidden = (np.arange(d.N) + rng.integers(97)) % 97 < 10
            noisy = d.y + rng.standard_normal(d.N)
            parts.append(Dataset(u=d.u, y=noisy, Ts=1.0, valid=~hidden))
        found = bla(parts, integrator=False)
        errors.append(np.abs(found.G - exact.G) ** 2)
        told.append(np.square(found.noise_only_std))

    ratio = np.mean(np.sum(told, axis=0)) / np.mean(np.sum(errors, axis=0))
    assert ratio == pytest.approx(1, abs=0.08)


def test_rounding_of_the_pwm_excites_no_line() -> None:
    """A multisine rounded to a duty of 10 bits keeps its lines."""
    u = excitation.multisine(500, range(1, 126))
    applied = np.round(u / 5 * 1023) / 1023 * 5

    assert np.flatnonzero(strong_lines(np.fft.rfft(applied))).tolist() == list(range(126))


def test_the_response_of_the_angle_is_estimated_by_its_rate(arm: Any) -> None:
    """Exact without noise, once the transient is over."""
    rng = np.random.default_rng(3)
    parts = [arm.dataset(2.5 + 0.5 * multisine(rng, 6)) for _ in range(2)]

    found = bla(parts, transient=3)

    np.testing.assert_allclose(found.G, arm.response(found.omega), rtol=1e-7)
    np.testing.assert_allclose(found.std_phase * np.abs(found.G), found.std_magnitude)


def test_one_period_does_not_separate_noise_and_distortion() -> None:
    """One realisation of several periods is enough to know the noise."""
    one, several = realisations(4, R=2, periods=2), realisations(5, R=1, periods=5)

    alone, both = bla(one, integrator=False), bla([*one, *several], integrator=False)

    assert alone.notes == (
        "one period in each realisation: noise and nonlinear distortion cannot be distinguished",
    )
    assert np.isnan(alone.noise_only_std).all()  # type: ignore[call-overload]
    assert "variance between realisations is" in both.notes[0]
    assert np.isfinite(both.noise_only_std).all()  # type: ignore[call-overload]


def test_an_approximate_period_is_sufficient(second: Any) -> None:
    """A measured voltage never repeats itself to the last digit."""
    rng = np.random.default_rng(1)
    parts = [
        d.replaced(u=d.u + 1e-6 * rng.standard_normal(d.N), step=None)
        for d in realisations(4, R=2, std=0.0)
    ]

    with pytest.raises(ValueError, match=r"the same period in all realisations, .* got none"):
        bla(parts, integrator=False)
    for found in (
        bla(parts, period_length=P, integrator=False),
        etfe(parts[0], period_length=P, integrator=False),
    ):
        np.testing.assert_allclose(found.G, second.response(found.omega), rtol=1e-4)
    with pytest.raises(ValueError, match="period_length=321 must be 2 to 320, two whole period"):
        etfe(parts[0], period_length=321, integrator=False)


def test_one_realisation_cannot_determine_distortion() -> None:
    found = bla(realisations(4, R=1), integrator=False)

    assert np.isnan(found.nonlinear_std).all()  # type: ignore[call-overload]
    assert np.isfinite(found.std_magnitude).all()
    assert "one realisation" in repr(found)


def test_an_input_without_a_period_is_refused(second: Any) -> None:
    other = Dataset(u=np.tile(np.arange(50.0), 4), y=np.zeros(200), Ts=1.0)

    with pytest.raises(ValueError, match="got none"):
        bla(second.dataset(np.random.default_rng(5)), integrator=False)
    with pytest.raises(ValueError, match="the same period in all realisations"):
        bla([*realisations(5, R=1), other], integrator=False)
    [one] = realisations(6, R=1)
    never = one.replaced(valid=~np.isin(np.arange(one.N) % P, [5, 6, 90]), step=None)
    with pytest.raises(ValueError, match="no value at 3 of the 128 instants of its period"):
        bla(never, integrator=False)
    with pytest.raises(ValueError, match="has no period of 128"):
        bla(realisations(6, periods=2), transient=2, integrator=False)
