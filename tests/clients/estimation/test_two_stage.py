"""Two-stage estimates of a plant in a closed loop: no bias, right deviations, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.estimation.polynomial_structures import oe
from armrig.estimation.two_stage import two_stage
from armrig.numerics.polynomial import apply_filter
from armrig_core.errors import InputError

from tests.clients import pages

B, F = [0.0, 0.4, 0.2], [1.0, -1.2, 0.5]
TRUE = np.array([0.4, 0.2, -1.2, 0.5])
ORDERS = {"nb": 2, "nf": 2}


def loop(seed: int = 0, N: int = 800, std: float = 0.1) -> tuple[Dataset, np.ndarray]:
    """Return a plant with coloured noise under a PI controller, and its set point."""
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.choice([-1.0, 1.0], N), 5)[:N]
    v = apply_filter([1.0, 0.5], [1.0, -0.9], std * rng.standard_normal(N))
    u, x, y = np.zeros((3, N))
    integral = 0.0
    for t in range(N):
        x[t] = 1.2 * x[t - 1] - 0.5 * x[t - 2] + 0.4 * u[t - 1] + 0.2 * u[t - 2] if t > 1 else 0.0
        y[t] = x[t] + v[t]
        integral += 0.05 * (r[t] - y[t])
        u[t] = 0.4 * (r[t] - y[t]) + integral
    return Dataset(u=u, y=y, Ts=0.1), r


def test_the_deviations_contain_the_first_stage() -> None:
    """Over 40 runs the errors have the reported deviations; OE is biased."""
    runs = [loop(seed) for seed in range(40)]
    fits = [two_stage(data, r, **ORDERS) for data, r in runs]

    z = np.array([(fit.theta - TRUE) / fit.std for fit in fits])
    assert np.all(np.abs(np.sqrt(np.mean(z**2, axis=0)) - 1) < 0.4)
    biased = [oe(data, **ORDERS) for data, _ in runs[:10]]
    assert np.mean([(fit.theta[0] - TRUE[0]) / fit.std_robust[0] for fit in biased]) < -3


def test_without_noise_the_plant_is_exact_in_both_domains() -> None:
    data, r = loop(std=0.0, N=2000)
    fit = two_stage(data, r, **ORDERS)
    in_s = two_stage(data, r, structure="tf", poles=2)

    np.testing.assert_allclose(fit.theta, TRUE, atol=1e-3)
    np.testing.assert_allclose(in_s.theta, fit.to_continuous().theta, rtol=1e-3)
    assert fit.estimated_from(data)
    assert "r causes" in fit.history[-1]


@pytest.mark.parametrize(("level", "slope"), [(0.0, 0.0), (0.5, 0.0), (0.0, 3.0)])
def test_a_level_or_a_drift_in_a_loop_does_not_bias_the_plant(level: float, slope: float) -> None:
    """A P controller removes slow noise from u, but not the mean of the noise."""
    errors, warned = [], 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        r = np.repeat(rng.choice([-1.0, 1.0], 150), 10)
        v = level + apply_filter([1.0], [1.0, -0.9], 0.1 * rng.standard_normal(1500))
        v += slope * np.arange(1500) / 1500
        u, x, y = np.zeros((3, 1500))
        for t in range(1500):
            x[t] = 0.8 * x[t - 1] + 0.4 * u[t - 1]
            y[t] = x[t] + v[t]
            u[t] = r[t] - y[t]
        data = Dataset(u=u, y=y, Ts=0.1)
        fit = two_stage(data, r, nb=1, nf=1)
        errors.append((fit.theta[:2] - [0.4, -0.8]) / fit.std[:2])
        alone = two_stage(data, r, nb=1, nf=1, offset=False)
        warned += any(f.about == "level" for f in alone.findings)

    assert np.count_nonzero(np.abs(errors) > 1.96) <= 3
    assert warned == 8 or not level


def test_experiments_and_missing_outputs_are_used() -> None:
    (first, r1), (second, r2) = loop(1), loop(2)
    data, r = merge([first, second]), np.concatenate([r1, r2])
    y = data.y.copy()
    y[[300, 301, 1100]] = np.nan

    fit = two_stage(Dataset(u=data.u, y=y, Ts=0.1, starts=data.starts), r, **ORDERS)

    assert np.all(fit.std < two_stage(first, r1, **ORDERS).std)
    assert np.all(np.abs(fit.theta - TRUE) < 4 * fit.std)


@pytest.mark.parametrize(("name", "printed"), [("closed-loop", 1), ("time-constants", 2)])
def test_a_page_prints_what_it_shows(
    name: str, printed: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert pages.run(pages.DOCS / f"{name}.md", capsys, atol=2e-3) == printed


@pytest.mark.parametrize(
    ("change", "options", "said"),
    [
        (lambda r: r[:-1], {}, "r has 799 samples and the data have 800"),
        (lambda r: 0 * r, {}, "r does not affect u"),
        (lambda r: np.random.default_rng(9).permutation(r), {}, "r does not affect u"),
        (lambda r: np.where(r > 0, r, np.nan), {}, r"must be known at each sample"),
        (lambda r: r, {"structure": "bj"}, "structure='bj'"),
        (lambda r: r.__getitem__, {}, "r contains text or other objects"),
    ],
)
def test_a_refusal_says_what_is_allowed(change: Any, options: dict[str, Any], said: str) -> None:
    data, r = loop()
    with pytest.raises((InputError, TypeError), match=said):
        two_stage(data, change(r), **(ORDERS | options))
