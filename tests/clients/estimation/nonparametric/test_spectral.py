"""Spectral analysis: response, noise, coherence, and how sure they are."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.estimation.nonparametric.spectra import Spectra, coherent_range
from armrig.estimation.nonparametric.spectral import _estimate, spa, spectral_reference
from armrig.numerics.polynomial import apply_filter

from tests.sampling import sampled

OMEGA = np.linspace(0.3, 2.8, 12)


@pytest.mark.parametrize(
    ("u_pole", "v_pole", "missing"),
    sampled([(0, 0, 0), (0.8, 0.8, 0), (0.8, 0.8, 0.1)]),
)
def test_the_bands_contain_the_smoothed_response(
    second: Any, u_pole: float, v_pole: float, missing: float
) -> None:
    """95 % of 120 runs, around the result of noise-free data."""
    held = np.zeros(2)
    runs = 120 if missing == 0 else 15
    for seed in range(runs):
        data, clean = (
            second.dataset(
                np.random.default_rng(seed), u_pole=u_pole, v_pole=v_pole, missing=missing, std=s
            )
            for s in (0.5, 0.0)
        )
        found, expected = (spa(d, 30, OMEGA, integrator=False) for d in (data, clean))
        held += [
            np.mean(np.abs(found.magnitude - expected.magnitude) < 1.96 * found.std_magnitude),
            np.mean(np.abs(np.angle(found.G / expected.G)) < 1.96 * found.std_phase),
        ]

    assert np.all((held / runs > 0.92) & (held / runs < 0.985))


def test_the_noise_spectrum_equals_that_of_the_noise(second: Any) -> None:
    """White noise of variance 4 at Ts 1 s has Phi_v = 4 everywhere."""
    found = [
        spa(second.dataset(np.random.default_rng(s), 2000, std=2.0), 30, OMEGA, integrator=False)
        for s in range(20)
    ]

    mean = np.mean([f.noise_spectrum for f in found], axis=0)
    scatter = np.std([f.noise_spectrum for f in found], axis=0)
    said = np.mean([f.noise_std for f in found], axis=0)
    np.testing.assert_allclose(mean, 4.0, rtol=0.1)
    assert 0.7 < np.mean(scatter / said) < 1.3


def test_coherence_is_the_share_that_the_input_explains(second: Any) -> None:
    """|G|² Phi_u/(|G|² Phi_u + Phi_v), here with Phi_u = Phi_v = 1."""
    found = spa(second.dataset(np.random.default_rng(1), 20_000), 60, OMEGA, integrator=False)

    power = np.abs(second.response(OMEGA)) ** 2
    np.testing.assert_allclose(found.coherence, power / (power + 1), atol=0.05)


def test_the_response_of_the_angle_is_estimated_by_its_rate(arm: Any) -> None:
    """Within 5 % if the response is smooth."""
    w = np.array([2.0, 5.0, 30.0, 50.0])

    found = spa(arm.telegraph(N=6000, std=1e-3), 200, w)

    assert found.integrator
    np.testing.assert_allclose(np.abs(found.G / arm.response(w)), 1.0, atol=0.06)


def test_logarithmic_windows_resolve_both_ends_of_the_band(arm: Any) -> None:
    """A single width is too wide for the arm's low end or too narrow for its high end."""
    found = spa(arm.telegraph(std=1e-3), "log")
    low, high = found.omega < 5, (found.omega > 40) & (found.omega < 100)

    error = np.abs(found.G / arm.response(found.omega) - 1)
    assert np.max(error[low]) < 0.1
    assert np.mean(found.std_magnitude[high] / found.magnitude[high]) < 0.01


def test_frequencies_are_even_unless_the_window_is_logarithmic(second: Any) -> None:
    """128 frequencies up to Nyquist."""
    data = second.dataset(np.random.default_rng(1))

    found = spa(data)

    np.testing.assert_allclose(found.omega, np.pi / data.Ts * np.arange(1, 129) / 128)


def test_a_window_that_blunts_a_resonance_is_reported() -> None:
    rng = np.random.default_rng([1, 2])
    F = np.poly(0.98 * np.exp([0.5j, -0.5j])).real
    u, e = rng.standard_normal((2, 3000))
    data = Dataset(u=u, y=apply_filter([0, 1], F, u) + 0.3 * e, Ts=1.0)
    truth = abs(1 / np.polyval(F, np.exp(0.5j)))

    blunt, sharp = (spa(data, window, [0.3, 0.5, 2.0], integrator=False) for window in (None, 400))

    assert blunt.magnitude[1] < 0.5 * truth
    [said] = [note for note in blunt.notes if "blunts" in note]
    assert "near 0.5 rad/s" in said
    assert "window=120" in said
    assert sharp.magnitude[1] > 0.8 * truth
    assert not any("blunts" in note for note in sharp.notes)


def test_a_window_that_blunts_no_resonance_is_not_reported(second: Any) -> None:
    """At most one of 100 runs reports a blunted resonance (smooth response, 128 frequencies)."""
    told = [
        spa(second.dataset(np.random.default_rng(seed), 1000), 60, integrator=False).notes
        for seed in range(100)
    ]

    assert sum(any("blunts" in note for note in notes) for notes in told) <= 1


def test_a_known_delay_is_aligned(second: Any) -> None:
    """A delay of 12 samples in a window of 20 lowers the response unless y is advanced."""
    data = second.dataset(np.random.default_rng(7), 8000, std=0.1)
    late = Dataset(u=data.u[12:], y=data.y[:-12], Ts=1.0)

    loose, aligned = (spa(late, 20, OMEGA, delay=d, integrator=False) for d in (0, 12))
    prompt = spa(data, 20, OMEGA, integrator=False)

    np.testing.assert_allclose(aligned.G, prompt.G * np.exp(-12j * OMEGA), rtol=0.02, atol=0.02)
    assert np.all(loose.magnitude < 0.8 * prompt.magnitude)


def test_missing_samples_are_shifted_with_the_output(second: Any) -> None:
    """The estimate is that of the data without the first samples of y and the last of u."""
    whole = second.dataset(np.random.default_rng(7), 300, std=0.1)
    valid = np.arange(300) % 60 != 11
    late = Dataset(u=whole.u, y=whole.y, Ts=0.5, valid=valid, starts=(0, 100, 296))
    parts = [
        Dataset(u=whole.u[a : b - 7], y=whole.y[a + 7 : b], Ts=0.5, valid=valid[a + 7 : b])
        for a, b in ((0, 100), (100, 296))
    ]
    omega = 2 * OMEGA

    found = spa(late, 12, omega, delay=7, integrator=False)

    expected = spa(merge(parts), 12, omega, integrator=False)
    assert found.N == expected.N == 282 - 5
    np.testing.assert_allclose(found.G, expected.G * np.exp(-7j * omega * 0.5), rtol=1e-9)


def test_missing_samples_and_several_experiments_give_the_same_response(second: Any) -> None:
    rng = np.random.default_rng(3)
    whole = second.dataset(rng, 3000, missing=0.0, std=0.3)
    holed = Dataset(u=whole.u, y=whole.y, Ts=1.0, valid=rng.random(3000) > 0.3)
    split = merge([whole[:1000], whole[1000:]])

    a, b, c = (spa(d, 30, OMEGA, integrator=False) for d in (whole, holed, split))

    assert np.all(np.abs(b.G - a.G) < 4 * b.std_magnitude)
    assert np.all(np.abs(c.G - a.G) < 4 * a.std_magnitude)
    assert 1.1 < np.mean(b.std_magnitude / a.std_magnitude) < 1.35  # 1/sqrt(0.7) is 1.195


def test_at_zero_and_nyquist_the_response_is_real(second: Any) -> None:
    """The whole uncertainty is in the magnitude."""
    found = spa(second.dataset(np.random.default_rng(5)), 30, [0.0, np.pi], integrator=False)

    np.testing.assert_allclose(found.G.imag, 0.0, atol=1e-9)
    np.testing.assert_allclose(found.std_phase, 0.0, atol=1e-6)


@pytest.mark.parametrize(("N", "window"), [(100, 10), (1200, 120), (3500, 300)])
def test_the_reference_of_a_model_has_a_long_window(second: Any, N: int, window: int) -> None:
    """A tenth of the samples, at most 300; it begins at the lowest resolved frequency."""
    data = second.dataset(np.random.default_rng(4), N)
    data = Dataset(u=data.u, y=data.y, Ts=0.5)

    found = spectral_reference(data)

    assert f"gamma {window} samples" in found.method
    np.testing.assert_allclose(found.omega, np.geomspace(4 * np.pi / window, 2 * np.pi, 40))


@pytest.mark.parametrize(
    ("power", "averages", "notes"),
    [
        ([4.0, 0, 2, 1, 1], [9.0], []),
        ([4.0, 3e-8, 2, 0, 1], [9.0], ["u has no power at 2 of 5 frequencies: G is NaN there"]),
        ([4.0, 1, 2, 1, 1], [9.0, 8.0], []),
        (
            [4.0, 1, 2, 1, 1],
            [9.0, 3.25],
            ["only 3.2 independent averages: too few"],
        ),
    ],
)
def test_frequencies_without_power_and_few_averages_are_reported(
    power: list[float], averages: list[float], notes: list[str]
) -> None:
    u, one = np.array(power), np.ones(5)
    u[1] = u[1] or 5e-8
    spectra = Spectra(
        u=u, y=one, yu=0.5 * u + 0j, averages=np.resize(averages, 5), reality=0 * one, noise=one
    )
    data = Dataset(u=one, y=one, Ts=0.5)

    found = _estimate(data, np.arange(5.0), spectra, "m", 5, integrates=False, notes=["first"])

    first, *told = found.notes
    assert first == "first"
    assert len(told) == len(notes)
    assert all(x.startswith(note) for x, note in zip(told, notes, strict=True))
    assert np.isnan(found.G).tolist() == (u <= 4e-8).tolist()


def test_frequencies_are_sorted(second: Any) -> None:
    data = second.dataset(np.random.default_rng(4), 200)

    found = spa(data, 20, [2.0, 0.5, 1.0], integrator=False)

    assert found.omega.tolist() == [0.5, 1.0, 2.0]
    np.testing.assert_array_equal(found.G, spa(data, 20, [0.5, 1, 2], integrator=False).G)
    with pytest.raises(ValueError, match=r"omega from 0\.5 to 4 rad/s is outside 0 to 3\.14"):
        spa(data, 20, [0.5, 4.0, 1.0], integrator=False)


@pytest.mark.parametrize(
    ("coherence", "found"),
    [
        ([0.0, 0.9, 0.1, 0.9, 0.9, 0.3], [1, 2, 4]),
        ([0.9, 0.9, np.nan, 0.9, 0.2, 0.9], [0, 1, 2, 4, 5]),
        ([0.1, 0.9, 0.9, 0.2, 0.0, 0.0], "two frequencies"),
        ([0.0] * 6, "no frequency"),
        (None, "no frequency"),
    ],
)
def test_the_band_explained_by_the_input_is_one_range(
    coherence: Any, found: list[int] | str
) -> None:
    """G is not known at the frequency with index 3."""
    G = np.array([1, 1, 1, np.nan, 1, 1])
    spectrum: Any = SimpleNamespace(
        coherence=None if coherence is None else np.array(coherence), G=G
    )

    if isinstance(found, str):
        with pytest.raises(ValueError, match=f"u explains y at {found} .*and 3 are needed"):
            coherent_range(spectrum)
    else:
        assert coherent_range(spectrum).tolist() == found


def test_windows_and_frequencies_out_of_range_are_refused(second: Any) -> None:
    data = second.dataset(np.random.default_rng(6), 200)

    with pytest.raises(ValueError, match="window=500 must be less than the 200"):
        spa(data, 500, integrator=False)
    with pytest.raises(ValueError, match="u is constant"):
        spa(Dataset(u=np.ones(50), y=np.zeros(50), Ts=1.0), integrator=False)
