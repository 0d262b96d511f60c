"""ARX by least squares."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.data.treatment import detrend
from armrig.estimation.arx import arx
from armrig.numerics.polynomial import apply_filter
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray


def simulated(seed: int, N: int, noise: float = 0.0) -> Dataset:
    """Return (1 - 1.2 q^-1 + 0.6 q^-2) y = (q^-1 + 0.5 q^-2) u + e for white u."""
    rng = np.random.default_rng(seed)
    u, e = rng.standard_normal((2, N))
    A = [1, -1.2, 0.6]
    y = apply_filter([0, 1, 0.5], A, u) + apply_filter([1], A, noise * e)
    return Dataset(u=u, y=y, Ts=1.0)


def test_the_hair_dryer_gives_the_published_model(
    reference: Callable[[str], NDArray[np.float64]],
) -> None:
    """ARX[2 2 3] on 300 samples, means removed: SITB's documentation, to all its digits."""
    u, y = reference("dryer.dat")[:300].T

    fit = arx(detrend(Dataset(u=u, y=y, Ts=0.08)), na=2, nb=2, nk=3)

    assert [f"{fit.A[1]:.4g}", f"{fit.A[2]:.4g}"] == ["-1.274", "0.3935"]
    assert [f"{fit.B[3]:.4g}", f"{fit.B[4]:.4g}"] == ["0.06662", "0.04448"]
    assert not fit.B[:3].any()
    np.testing.assert_allclose(fit.std, [0.0209, 0.0191, 0.00214, 0.00332], rtol=3e-3)


@given(st.floats(0.05, 0.98), st.floats(0.1, 3.0), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_noise_free_data_give_back_the_true_parameters(
    radius: float, angle: float, nk: int, seed: int
) -> None:
    """For any resonance and delay."""
    A = np.array([1, -2 * radius * np.cos(angle), radius**2])
    B = np.append(np.zeros(nk), [1.0, -0.4])
    u = np.random.default_rng(seed).standard_normal(100)

    fit = arx(Dataset(u=u, y=apply_filter(B, A, u), Ts=1), na=2, nb=2, nk=nk)

    np.testing.assert_allclose(fit.A, A, atol=1e-7)
    np.testing.assert_allclose(fit.B, B, atol=1e-7)


def test_rows_need_a_known_past_in_their_own_experiment() -> None:
    """A missing y costs its own row and the na rows that look back on it."""
    first, second = simulated(1, 60), simulated(2, 40)[15:]
    holed = first.replaced(step=None, valid=np.arange(60) != 30)

    fit = arx(merge([holed, second]), na=2, nb=2)

    assert fit.N == 60 - 2 - 3 + 25 - 2
    np.testing.assert_allclose(fit.A, [1, -1.2, 0.6], atol=1e-9)


def test_scale_of_the_units_does_not_spoil_the_answer() -> None:
    """Columns are scaled: microvolts and megametres give the same model."""
    data = simulated(3, 200, noise=0.1)
    scaled = Dataset(u=1e-6 * data.u, y=1e6 * data.y, Ts=1)

    plain, fit = arx(data, na=2, nb=2), arx(scaled, na=2, nb=2)

    np.testing.assert_allclose(fit.A, plain.A, rtol=1e-9)
    np.testing.assert_allclose(fit.B, 1e12 * plain.B, rtol=1e-9)


def test_an_order_too_high_for_the_data_is_refused() -> None:
    data = simulated(1, 7, noise=1.0)

    with pytest.raises(ValueError, match="na=2, nb=2, nk=1 needs at least 7 samples, got 4"):
        arx(data[:4], na=2, nb=2, nk=1)

    assert arx(data, na=2, nb=2, nk=1).N == 5
    late = simulated(1, 14, noise=1.0)
    with pytest.raises(ValueError, match="na=1, nb=2, nk=9 needs at least 14 samples, got 13"):
        arx(late[:13], na=1, nb=2, nk=9)
    assert arx(late, na=1, nb=2, nk=9).N == 4


def test_an_input_without_excitation_is_refused() -> None:
    """A constant determines one number, not two."""
    rng = np.random.default_rng(0)

    with pytest.raises(ValueError, match=r"determine only 2 of 3 parameters; u is always 1"):
        arx(Dataset(u=np.ones(50), y=rng.standard_normal(50), Ts=1), na=1, nb=2)


@pytest.mark.parametrize("orders", [{"na": -1, "nb": 1}, {"na": 1, "nb": 0}, {"na": 1.5, "nb": 1}])
def test_an_impossible_order_is_refused(orders: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=r"n[ab]=.* must be an integer >="):
        arx(simulated(1, 50), **orders)
