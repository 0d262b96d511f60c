"""An estimate reports faults of the data: wrong samples, an offset."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation.data_faults import (
    _doubtful,
    cause_of_indeterminacy,
    data_faults,
    level_without_input,
    swap_warnings,
)
from armrig.models.fit import Fit
from armrig.numerics.polynomial import apply_filter
from armrig.numerics.quantities import percent

from tests.sampling import sampled

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
    return Dataset(u=u, y=apply_filter(B, F, u) + std * e, Ts=0.1)


@cache
def spoilt_and_marked() -> tuple[Dataset, Dataset]:
    """Return data with five wrong samples, and the same data with these samples missing."""
    data = dataset()
    y = data.y.copy()
    y[[101, 333, 334, 600, 871]] += 1e6 * np.array([1, -1, 1, 1, -1])
    data = data.replaced(y=y, step=None)
    return data, armrig.hampel(data)


def about(fit: Fit, word: str) -> list[str]:
    return [w for w in fit.warnings if word in w]


@estimators
def test_outliers_that_the_model_follows_are_reported(estimate: Callable[[Dataset], Fit]) -> None:
    fit, marked = map(estimate, spoilt_and_marked())

    assert about(fit, "5 samples of y look wrong (101, 333, 334, 600, 871)")
    assert about(fit, "mark them missing (hampel)")
    assert not about(marked, "hampel")


@pytest.mark.parametrize(
    ("at", "said"),
    [
        ([70], "1 sample of y look wrong (70)"),
        ([70, 90, 110, 130, 150, 170], "6 samples of y look wrong (70, 90, 110, 130, 150, …)"),
    ],
)
def test_at_most_five_wrong_samples_are_listed_and_all_are_counted(
    at: list[int], said: str
) -> None:
    data = dataset(N=300)
    y = data.y.copy()
    y[at] -= 1e3

    [found] = (
        x
        for x in armrig.arx(data.replaced(y=y, step=None), na=0, nb=9).findings
        if x.about == "outliers"
    )

    assert found.text.startswith(said)
    assert found.numbers["count"] == len(at)
    assert 0.9 < found.numbers["share"] < 1.0
    assert f"make {percent(100 * found.numbers['share'])} of the squared" in found.text


@pytest.mark.parametrize(("known", "is_told"), [(49, False), (50, True)])
def test_few_residuals_show_no_wrong_samples(known: int, is_told: bool) -> None:
    data = dataset(N=60)
    y = data.y.copy()
    y[30] += 1e3
    e = np.where(np.arange(60) < 60 - known, np.nan, y - y.mean())

    told = [x.about for x in data_faults(data.replaced(y=y, step=None), [e], way_out="")]

    assert told == ["outliers"] * is_told


@pytest.mark.parametrize(
    ("N", "levels", "is_told"), [(100, 45, False), (100, 55, True), (400, 90, False), (400, 110, 1)]
)
def test_swapped_columns_are_reported_from_50_levels_and_a_quarter_on(
    N: int, levels: int, is_told: bool
) -> None:
    u = np.arange(float(N)) % levels
    two, three = (np.arange(N) % k for k in (2.0, 3.0))

    told = [x.about for x in swap_warnings(Dataset(u=u, y=two, Ts=1.0))]

    assert told == ["swapped"] * is_told
    assert not [*swap_warnings(Dataset(u=u, y=three, Ts=1.0))]


def test_the_cause_of_undetermined_parameters_is_named() -> None:
    x, valid = np.arange(20.0) % 7, np.arange(20) % 4 > 0
    constant = np.where(valid, 2.5, np.nan)

    def cause(u: np.ndarray, y: np.ndarray) -> str:
        return cause_of_indeterminacy(
            Dataset(u=u, y=y, Ts=1.0, valid=np.isfinite(y), output="speed")
        )

    assert cause(np.full(20, -3.0), x).startswith("u is always -3: give the column that varies")
    assert cause(x, constant).startswith("speed is always 2.5: give the column that varies")
    assert cause(x, x) == "speed equals u: give the column of the output"
    assert cause(x, x[::-1]) == "lower the orders or excite with a richer input"


@pytest.mark.parametrize("mean", [0.0, 0.19, -0.19, 0.21, -0.21])
def test_a_mean_of_either_sign_is_doubtful_from_four_deviations_on(mean: float) -> None:
    """The deviation of the mean of 395 samples is 0.0503."""
    e = np.random.default_rng(3).standard_normal(400)
    e[20:25] = np.nan
    e = (e - np.nanmean(e)) / np.nanstd(e) + mean

    assert _doubtful([e[:150], e[150:]]) == (abs(mean) > 0.2)
    assert _doubtful([apply_filter([1.0], [1.0, -0.6], e[25:])])


@pytest.mark.parametrize(("offset", "N"), [(3.0, 300), (-3.0, 70), (0.0, 300)])
def test_the_level_without_input_has_its_sign_its_unit_and_its_deviations(
    offset: float, N: int
) -> None:
    """The order of the model is a tenth of the known samples, at most 12."""
    rng = np.random.default_rng(9)
    u, e = rng.standard_normal((2, N))
    y = apply_filter([0, 1.0], [1, -0.5], u + 2.0) + apply_filter([1], [1, -0.5], 0.3 * e) + offset
    valid = np.arange(N) != 40
    data = Dataset(u=u + 2.0, y=y, Ts=1.0, valid=valid, unit="K", starts=(0, 25))
    n = min(12, (N - 1) // 10)
    rows = [t for t in range(n, N) if not (25 <= t < 25 + n or 40 <= t <= 40 + n)]
    Phi = np.array([[*-y[t - n : t][::-1], *data.u[t - n : t + 1], 1.0] for t in rows])
    theta, [sse], *_ = np.linalg.lstsq(Phi, y[rows])
    std = np.sqrt(sse / (len(rows) - 2 * n - 2) * np.linalg.inv(Phi.T @ Phi)[-1, -1])

    found = level_without_input(data, least=0.0)

    assert found is not None
    level, sigmas = theta[-1] / (1 + theta[:n].sum()), abs(theta[-1]) / std
    assert [found.numbers[name] for name in ("level", "sigmas")] == pytest.approx([level, sigmas])
    text = f"y is about {level:.3g} K at u = 0 ({sigmas:.0f} standard deviations from 0)"
    assert found.text == text
    assert level_without_input(data, least=0.9 * sigmas)
    assert not level_without_input(data, least=1.1 * sigmas)


def test_a_level_far_from_the_data_is_not_stated_as_a_value() -> None:
    u = 0.3 + 0.02 * np.random.default_rng(9).choice([-1.0, 1.0], 500)
    y = (
        90
        + apply_filter([0, -3.0], [1, -0.9], u)
        + 0.01 * np.random.default_rng(8).normal(size=500)
    )

    found = level_without_input(Dataset(u=u, y=y, Ts=1.0, input="flow", output="T"))

    assert found is not None
    assert found.text.startswith("a linear model from flow to T needs a level (")


def test_data_without_a_level_have_no_finding() -> None:
    u = np.random.default_rng(9).standard_normal(200)
    data = Dataset(u=u, y=apply_filter([0, 1.0], [1, -0.5], u), Ts=1.0)

    assert level_without_input(data, least=0.0) is None
    assert level_without_input(data[:9], least=0.0) is None


@pytest.mark.parametrize("noise", sampled(["laplace", "normal"]))
def test_noise_is_not_an_outlier_and_a_mean_of_u_is_not_an_offset(noise: str) -> None:
    """40 runs of each noise."""
    for seed in range(40):
        fit = armrig.oe(dataset(seed, 500, noise=noise), nb=2, nf=2, starts="few")

        assert not about(fit, "hampel")
        assert not about(fit, "at u = 0")


def test_steps_missed_by_a_poor_model_are_not_outliers() -> None:
    """Few large residuals, each after a step of the input: the order is too low."""
    u = np.repeat([0.0, 1.0, 0.0, 1.0, 0.0], 400)
    y = apply_filter([0, 0, 0, 0, 0, 1.0], [1.0, -0.3], u)
    y += 1e-3 * np.random.default_rng(1).standard_normal(u.size)

    assert not about(armrig.arx(Dataset(u=u, y=y, Ts=1.0), na=1, nb=1), "hampel")


@pytest.mark.parametrize("name", ["arx", "iv4", "n4sid", "armax", "oe"])
def test_an_offset_of_y_is_reported_with_the_remedy(name: str) -> None:
    """The offset is 5 above any response to u."""
    data = dataset()
    data = data.replaced(y=data.y + 5.0, step=None)

    fit = ESTIMATORS[name](data)

    [said] = about(fit, "at u = 0")
    assert "offset" in said
    assert float(said.split("about ")[1].split()[0]) == pytest.approx(5.0, abs=0.3)


def test_a_level_that_remains_without_the_means_is_due_to_a_transient() -> None:
    """The advice to remove the means would be of no use."""
    k = np.arange(100.0)
    u = np.where(k // 13 % 2, 1.0, 3.0)
    y = apply_filter([0, 0.2], [1, -0.9], u) + 0.01 * np.sin(9 * k**2)

    fit = armrig.arx(armrig.detrend(Dataset(u=u, y=y, Ts=0.1)), na=1, nb=1)

    (text,) = [f.text for f in fit.findings if f.about == "level"]
    assert "the removed means contain a transient" in text


def test_an_integrator_has_a_separate_level() -> None:
    """The offset of the input is estimated with it, so that no other remedy is named."""
    data = dataset(N=300)
    data = data.replaced(y=data.y + 5.0, step=None)

    assert about(armrig.n4sid(data, 2), "at u = 0")
    assert not about(armrig.n4sid(data, 2, integrator=True), "at u = 0")


def test_the_model_with_an_offset_is_unbiased() -> None:
    data = dataset(std=0.05)
    fit = armrig.oe(data.replaced(y=data.y + 5.0, step=None), nb=2, nf=2, offset=True)

    np.testing.assert_allclose(fit.F, F, atol=0.02)
    assert not about(fit, "at u = 0")


@pytest.mark.exhaustive
def test_coloured_noise_is_not_an_offset() -> None:
    """30 runs with noise filtered by a pole at 0.9, which an OE model leaves coloured."""
    for seed in range(30):
        data = dataset(seed, 500, std=0.0)
        v = apply_filter([1.0], [1.0, -0.9], np.random.default_rng([seed, 4]).standard_normal(500))
        fit = armrig.oe(data.replaced(y=data.y + 0.1 * v, step=None), nb=2, nf=2, starts="few")

        assert not about(fit, "at u = 0")
