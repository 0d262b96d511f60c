"""Regions contain the truth, by draws if the linearisation fails, and name their method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation.polynomial_structures import oe
from armrig.models.fit import Fit
from armrig.models.uncertainty import (
    Draws,
    directions,
    frequency_bands,
    frequency_responses,
    parameter_draws,
    pole_regions,
    roots_of,
    step_band,
    step_responses,
    zero_regions,
)
from armrig.numerics.confidence_regions import linear_region
from armrig.numerics.polynomial import apply_filter

from tests.clients.models.made_fits import changed, made

NEAR = (0.85 + 0.02j, 0.85 - 0.02j, 0.5)
PLAIN = (0.83 + 0.35j, 0.83 - 0.35j, 0.7)


def data(seed: int, poles: tuple[complex, ...], noise: float, N: int = 1000) -> Dataset:
    """Return y = B/F u + e, e of a share of y's deviation."""
    rng = np.random.default_rng([seed, N])
    u = rng.choice([-1.0, 1.0], N).repeat(2)[:N]
    y = apply_filter([0.0, 0.1, 0.08, 0.02], np.real(np.poly(poles)), u)
    return Dataset(u=u, y=y + noise * np.std(y) * rng.standard_normal(N), Ts=1.0)


@pytest.fixture(scope="module")
def plain() -> Fit:
    """Return a fit of a system whose roots are far from each other."""
    return oe(data(1, PLAIN, 0.1), nb=3, nf=3, starts="few")


@pytest.fixture(scope="module")
def near() -> Fit:
    """Return a fit of a system whose pair of poles is hardly a pair."""
    return oe(data(1, NEAR, 0.3), nb=3, nf=3, starts="few")


def test_draws_have_mean_and_covariance_exactly(plain: Fit) -> None:
    """An answer that is linear in theta therefore gets the deviation of its derivative."""
    draws = parameter_draws(plain)

    assert draws is not None
    np.testing.assert_allclose(draws.theta.mean(axis=0), plain.theta, atol=1e-12)
    np.testing.assert_allclose(
        np.cov(draws.theta.T, ddof=0), plain.covariance, rtol=1e-6, atol=1e-12
    )
    assert (draws.unstable, draws.degenerate, draws.left_out) == (0, 0, "")


def test_the_region_of_a_nearly_double_root_is_sampled(near: Fit) -> None:
    assert {r.method for r in pole_regions(near)} == {"sampled"}
    assert all(r.method == "sampled" for r in zero_regions(near))


@pytest.mark.exhaustive
def test_a_sampled_region_contains_a_pair_that_the_ellipse_misses() -> None:
    """Coverage of the pole over 60 experiments; 95 % has a standard deviation of 2.8 %."""
    truth = NEAR[0]
    held = []
    for seed in range(60):
        fit = oe(data(seed, NEAR[:2], 0.3), nb=3, nf=2, starts="few")
        poles = fit.poles()
        i = int(np.argmin(np.abs(poles.values - truth)))
        ellipse = linear_region(complex(poles[i]), poles.covariance[i])
        held.append([ellipse.contains(truth), pole_regions(fit)[i].contains(truth)])

    linearised, chosen = np.mean(held, axis=0)

    assert linearised < 0.75
    assert chosen > 0.95 - 3 * 0.028


@pytest.mark.exhaustive
def test_a_good_linearisation_is_kept_and_has_its_confidence_level() -> None:
    """Pole, |G| and step response over 60 experiments: 95 % within three deviations."""
    omega, at = np.array([0.1, 0.5]), 20
    F = np.real(np.poly(PLAIN))
    x = np.exp(-1j * omega)
    G = np.abs(np.polyval([0.02, 0.08, 0.1, 0.0], x) / np.polyval(F[::-1], x))
    y = apply_filter([0.0, 0.1, 0.08, 0.02], F, np.ones(at + 1))
    held, sampled = [], []
    for seed in range(60):
        fit = oe(data(seed, PLAIN, 0.1), nb=3, nf=3, starts="few")
        draws = parameter_draws(fit)
        pole = next(r for r in pole_regions(fit, draws) if r.centre.imag > 0)
        magnitude, _ = frequency_bands(fit, fit.frequency_response(omega), draws)
        step = step_band(fit, fit.step_response(at + 1), draws)
        held.append([pole.contains(PLAIN[0]), *magnitude.contains(G), step.contains(y)[at]])
        sampled.append([r.method == "sampled" for r in (pole, magnitude, step)])

    assert (np.mean(held, axis=0) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 60)).all()
    assert np.mean(sampled) < 0.05


def of_one_pole(pole: float, std: float, n: int) -> Draws:
    """Return draws of a model with this pole and its deviation."""
    draws = parameter_draws(made(F=(1, -pole), std=(0.1, std)), n=n)
    assert draws is not None
    return draws


def test_draws_are_repeated_until_half_of_a_round_is_accepted() -> None:
    """A pole at 0.99 ± 0.05 is unstable in about four of ten draws, ± 100 in nearly all."""
    few, many = of_one_pole(0.99, 0.05, 200), of_one_pole(0.99, 100.0, 200)
    off = of_one_pole(0.5, 0.01, 200)

    assert (off.asked, off.unstable, off.degenerate) == (200, 0, 0)
    assert few.asked == 200
    assert 0.3 < few.unstable / few.asked < 0.5
    assert many.asked == 2000
    assert many.theta.shape[0] < 200
    for draws in (few, many, off):
        assert draws.theta.shape[0] == draws.asked - draws.unstable - draws.degenerate


def test_all_draws_of_an_unstable_model_are_accepted() -> None:
    draws = of_one_pole(1.2, 0.05, 200)

    assert (draws.asked, draws.unstable) == (200, 0)
    assert draws.left_out == ""
    said = replace(draws, unstable=3, degenerate=4).left_out
    assert said == "3 of 200 unstable, 4 of 200 degenerate"


def test_an_unstable_draw_must_be_finite() -> None:
    """The first b of some draws is 0, which is counted by itself."""
    fit = made(F=(1, -0.5), std=(0.0, 100.0), B=(0, 0.0))

    draws = parameter_draws(fit, n=100)

    assert draws is not None
    assert (draws.unstable, draws.degenerate) == (0, draws.asked)


def test_directions_have_the_covariance_and_keep_the_pole_at_1() -> None:
    for letter in ("A", "F"):
        p = {letter: np.convolve([1, -1], np.poly([0.6, 0.3])).tolist()}
        free = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, -1.0], [0.5, -1.0, 2.0]]) * 1e-4
        by_free = np.zeros((4, 3))
        # The rows are b and p, or p and b: p_k = f_k - f_(k - 1) of the other factor.
        at = slice(0, 3) if letter == "A" else slice(1, 4)
        b = 3 if letter == "A" else 0
        by_free[b, 0] = 1.0
        by_free[at, 1:] = [[1, 0], [-1, 1], [0, -1]]
        P = by_free @ free @ by_free.T
        fit = made(B=(0, 1), **p, integrator=True, covariance=P, covariance_robust=P)

        W = directions(fit)

        np.testing.assert_allclose(W @ W.T, P, atol=1e-12)
        np.testing.assert_allclose(W[at].sum(axis=0), 0, atol=1e-12)
        assert W.shape[1] == 3


@pytest.mark.parametrize("rate", [False, True])
def test_a_band_of_draws_has_the_unit_of_its_response(rate: bool) -> None:
    """A lag with a gain ± 40 %; the band holds 95 % of the draws."""
    fit = made(B=(0, 0.2), F=(1, -0.9), std=(0.04, 0.03), Ts=0.02)
    answer, draws = fit.step_response(30, rate=rate), parameter_draws(fit)
    assert draws is not None
    steps = step_responses(fit, draws.theta, 30 + rate)
    samples = np.diff(steps, axis=1) / 0.02 if rate else steps

    shown = step_band(fit, answer, draws)

    expected = np.quantile(samples, [0.025, 0.975], axis=0)
    assert shown.method == "sampled"
    np.testing.assert_allclose([shown.low, shown.high], expected, rtol=0.05, atol=1e-3)
    linear = step_band(fit, answer, None)
    np.testing.assert_allclose(linear.high - answer.y, 1.96 * answer.std, rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("nk", [0, 1, 3])
def test_each_draw_has_the_responses_and_roots_of_its_model(nk: int) -> None:
    """Three draws of a model with A and F."""
    fit = made(A=(1, -0.4), B=[0.0] * nk + [1, 0.5, 0.2], F=(1, -1.2, 0.5), nk=nk, std=[0.05] * 6)
    draws = parameter_draws(fit, n=20)
    assert draws is not None
    omega = np.array([0.3, 5.0, 30.0])

    G = frequency_responses(fit, draws.theta, omega)
    steps = step_responses(fit, draws.theta, 9)

    for i in (0, 3, 19):
        a, b, f = np.split(draws.theta[i], [1, 4])
        moved = changed(fit, A=np.append(1, a), B=np.append(np.zeros(nk), b), F=np.append(1, f))
        np.testing.assert_allclose(G[i], moved.frequency_response(omega).G)
        np.testing.assert_allclose(steps[i], moved.step_response(9).y)
        for letter, roots in (("b", moved.zeros()), ("f", np.roots(moved.F)), ("a", [-a[0]])):
            np.testing.assert_allclose(
                np.sort_complex(roots_of(fit, draws.theta, letter)[i]),
                np.sort_complex(np.asarray(roots)),
            )


def test_the_band_of_a_phase_is_centred_on_the_phase_of_the_model() -> None:
    """Also near -180°, where the phases of the draws jump."""
    fit = made(B=(0, -0.2), F=(1, -0.8), std=(0.02, 0.01))
    answer = fit.frequency_response([0.01, 3.0])

    for draws in (parameter_draws(fit), None):
        magnitude, phase = frequency_bands(fit, answer, draws)

        for band_, value, std in (
            (magnitude, np.abs(answer.G), answer.std_magnitude),
            (phase, np.zeros(2), answer.std_phase),
        ):
            np.testing.assert_allclose(band_.high - value, 1.96 * std, rtol=0.15)
            np.testing.assert_allclose(value - band_.low, 1.96 * std, rtol=0.15)
