"""An estimate reports faults of the data: wrong samples, an offset."""

from __future__ import annotations

from collections.abc import Callable

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.models.fit import Fit
from armrig.numerics.polynomial import filtered

B, F = [0.0, 0.5, 0.3], [1.0, -1.2, 0.5]
ESTIMATORS: dict[str, Callable[[Dataset], Fit]] = {
    "arx": lambda data: armrig.arx(data, na=2, nb=2),
    "iv4": lambda data: armrig.iv4(data, na=2, nb=2),
    "armax": lambda data: armrig.armax(data, na=2, nb=2, nc=2, starts="few"),
    "oe": lambda data: armrig.oe(data, nb=2, nf=2, starts="few"),
    "n4sid": lambda data: armrig.n4sid(data, order=2),
    "bj": lambda data: armrig.bj(data, nb=2, nc=1, nd=1, nf=2, starts="few"),
}
estimators = pytest.mark.parametrize("estimate", ESTIMATORS.values(), ids=ESTIMATORS.keys())


def dataset(seed: int = 1, N: int = 1000, std: float = 0.2, noise: str = "normal") -> Dataset:
    """Return an output-error system under a binary input with a mean."""
    rng = np.random.default_rng([seed, 3])
    u = np.repeat(rng.choice([0.0, 4.0], N // 5), 5)
    e = rng.standard_normal(N) if noise == "normal" else rng.laplace(size=N)
    return Dataset(u=u, y=filtered(B, F, u) + std * e, Ts=0.1)


def spoilt(data: Dataset) -> Dataset:
    """Return the data with five wrong samples."""
    y = data.y.copy()
    y[[101, 333, 334, 600, 871]] += 1e6 * np.array([1, -1, 1, 1, -1])
    return data.replaced(y=y, step=None)


def about(fit: Fit, word: str) -> list[str]:
    """Return the warnings with that word."""
    return [w for w in fit.warnings if word in w]


@estimators
def test_outliers_that_the_model_follows_are_reported(estimate: Callable[[Dataset], Fit]) -> None:
    data = spoilt(dataset())

    fit, mended = estimate(data), estimate(armrig.hampel(data))

    assert about(fit, "5 samples of y look wrong (101, 333, 334, 600, 871)")
    assert about(fit, "mark them missing (hampel)")
    assert not about(mended, "hampel")


@pytest.mark.parametrize("noise", ["normal", "laplace"])
def test_noise_is_no_outlier_and_a_mean_of_the_input_no_offset(noise: str) -> None:
    """40 runs of each noise."""
    for seed in range(40):
        fit = armrig.oe(dataset(seed, 500, noise=noise), nb=2, nf=2, starts="few")

        assert not about(fit, "hampel")
        assert not about(fit, "at u = 0")


def test_steps_that_a_poor_model_misses_are_no_outliers() -> None:
    """Few large residuals, each after a step of the input: the order is too low."""
    u = np.repeat([0.0, 1.0, 0.0, 1.0, 0.0], 400)
    y = filtered([0, 0, 0, 0, 0, 1.0], [1.0, -0.3], u)
    y += 1e-3 * np.random.default_rng(1).standard_normal(u.size)

    assert not about(armrig.arx(Dataset(u=u, y=y, Ts=1.0), na=1, nb=1), "hampel")


@pytest.mark.parametrize("name", ["arx", "iv4", "n4sid", "armax", "oe"])
def test_an_offset_of_y_is_reported_with_the_way_out(name: str) -> None:
    """The offset is 5 above any response to u."""
    data = dataset()
    data = data.replaced(y=data.y + 5.0, step=None)

    fit = ESTIMATORS[name](data)

    [said] = about(fit, "at u = 0")
    assert "offset" in said
    assert float(said.split("about ")[1].split()[0]) == pytest.approx(5.0, abs=0.3)


def test_with_offset_true_the_model_is_right() -> None:
    data = dataset(std=0.05)
    fit = armrig.oe(data.replaced(y=data.y + 5.0, step=None), nb=2, nf=2, offset=True)

    np.testing.assert_allclose(fit.F, F, atol=0.02)
    assert not about(fit, "at u = 0")


def test_coloured_noise_is_no_offset() -> None:
    """30 runs with noise filtered by a pole at 0.9, which an OE model leaves coloured."""
    for seed in range(30):
        data = dataset(seed, 500, std=0.0)
        v = filtered([1.0], [1.0, -0.9], np.random.default_rng([seed, 4]).standard_normal(500))
        fit = armrig.oe(data.replaced(y=data.y + 0.1 * v, step=None), nb=2, nf=2, starts="few")

        assert not about(fit, "at u = 0")
