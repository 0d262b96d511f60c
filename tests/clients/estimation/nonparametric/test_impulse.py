"""Impulse responses are right, and their bands hold."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.estimation.nonparametric import impulse
from armrig.estimation.nonparametric.impulse import _warnings, impulse_response
from armrig.estimation.nonparametric.kernels import Evidence, Kernel, factor
from armrig.numerics.polynomial import apply_filter
from armrig.numerics.whiteness import LJUNG_BOX, Whiteness
from numpy.typing import NDArray

from tests.sampling import sampled

KERNELS: tuple[Kernel, ...] = ("tc", "dc", "ss")


def test_without_noise_plain_least_squares_gives_back_the_response() -> None:
    """A row is used if its output and all its inputs are inside the experiment."""
    rng = np.random.default_rng(1)
    g = np.array([0.0, 0.5, -0.3, 0.2, 0.1])
    parts = []
    for level in (2.0, -1.0):
        u = rng.standard_normal(120)
        y = apply_filter(g, [1.0], u) + level
        parts.append(Dataset(u=u, y=y, Ts=1.0, valid=rng.random(120) > 0.1))

    found = impulse_response(merge(parts), 5, None, integrator=False)

    np.testing.assert_allclose(found.g, g, atol=1e-12)
    assert np.count_nonzero([part.valid[4:] for part in parts]) == found.N
    np.testing.assert_allclose(found.band(), 1.959963984540054 * found.std)
    assert found.lags.tolist() == [*range(5)]


@pytest.mark.parametrize(
    ("u_pole", "v_pole", "missing"), sampled([(0, 0.8, 0), (0.8, 0.8, 0.1)], 0)
)
def test_the_band_of_confidence_holds_for_coloured_noise(
    second: Any, u_pole: float, v_pole: float, missing: float
) -> None:
    """95 % of 150 runs of 30 lags, whatever the colours."""
    truth, held = second.g(30), 0.0
    for seed in range(150):
        data = second.dataset(
            np.random.default_rng(seed), 600, u_pole=u_pole, v_pole=v_pole, missing=missing
        )
        found = impulse_response(data, 30, kernel=None, integrator=False)
        held += float(np.mean(np.abs(found.g - truth) < found.band(0.95))) / 150

    assert 0.93 < held < 0.97


@pytest.mark.exhaustive
def test_regularisation_lowers_the_error_on_short_data(second: Any) -> None:
    """In nearly every one of 12 paired runs, with every kernel (Chen, Ohlsson, Ljung 2012)."""
    truth = second.g(50)
    ratio = np.zeros((12, 3))
    for seed in range(12):
        data = second.dataset(np.random.default_rng(seed), 200, std=3.0)
        plain, *others = (
            float(np.sum((impulse_response(data, 50, k, integrator=False).g - truth) ** 2))
            for k in (None, *KERNELS)
        )
        ratio[seed] = np.array(others) / plain

    assert np.all(np.median(ratio, axis=0) < 0.25)
    assert np.all(np.mean(ratio < 1, axis=0) > 0.95)


@pytest.mark.parametrize("kernel", KERNELS)
def test_the_product_of_a_kernel_factor_equals_the_kernel(kernel: Kernel) -> None:
    """L L^T = P by the published formulas."""
    decay, rho, n = 0.8, 0.6, 12
    i, j = np.meshgrid(np.arange(1, n + 1), np.arange(1, n + 1), indexing="ij")
    largest = np.maximum(i, j)
    P = {
        "tc": decay**largest,
        "dc": decay ** ((i + j) / 2) * rho ** np.abs(i - j),
        "ss": decay ** (i + j + largest) / 2 - decay ** (3 * largest) / 6,
    }[kernel]

    L = factor(kernel, n, decay, rho)

    np.testing.assert_allclose(L @ L.T, P, atol=1e-14)


def test_the_posterior_equals_the_formula_of_the_textbook(second: Any) -> None:
    """The mean P Phi^T (Phi P Phi^T + sigma² I)^-1 y and its covariance, computed directly."""
    data = second.dataset(np.random.default_rng(3), 150)
    found = impulse_response(data, 20, "tc", integrator=False)
    u, rows = data.u - data.u.mean(), np.arange(19, 150)
    Phi = np.column_stack([u[rows - k] for k in range(20)])
    centre = np.eye(131) - 1 / 131
    Phi, y = centre @ Phi, centre @ data.y[rows]
    L = factor("tc", 20, found.hyperparameters["decay"])
    P = found.hyperparameters["scale"] * L @ L.T
    gain = P @ Phi.T @ np.linalg.inv(Phi @ P @ Phi.T + found.noise_variance * np.eye(131))

    np.testing.assert_allclose(found.g, gain @ y, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.covariance, P - gain @ Phi @ P, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("unit", [1e-3, 1e6])
def test_the_unit_of_u_changes_only_the_scale_of_the_response(
    second: Any, kernel: Kernel, unit: float
) -> None:
    """The search for the kernel's scale begins at the scale of the data."""
    data = second.dataset(np.random.default_rng(3), 150)
    scaled = Dataset(u=unit * data.u, y=data.y, Ts=data.Ts)

    found, of_scaled = (impulse_response(d, 20, kernel, integrator=False) for d in (data, scaled))

    np.testing.assert_allclose(unit * of_scaled.g, found.g, atol=0.01 * np.abs(found.g).max())


def test_the_hyperparameters_maximise_the_marginal_likelihood() -> None:
    """The marginal likelihood is computed from the covariance of all samples."""
    rng = np.random.default_rng(4)
    n, M = 15, 60
    Phi = rng.standard_normal((M, n))
    y = Phi @ (factor("tc", n, 0.7) @ rng.standard_normal(n)) + 0.3 * rng.standard_normal(M)
    R = np.linalg.qr(np.hstack([Phi, y[:, None]]), mode="r")
    evidence = Evidence(kernel="tc", R=R[:n, :n], r=R[:n, n], rest=float(R[n, n] ** 2), M=M)

    def density(scale: float, decay: float, variance: float) -> float:
        L = factor("tc", n, decay)
        S = scale * Phi @ L @ L.T @ Phi.T + variance * np.eye(M)
        return float(np.linalg.slogdet(S)[1] + y @ np.linalg.solve(S, y))

    best = evidence.posterior()
    at = (best.hyperparameters["scale"], best.hyperparameters["decay"], best.noise_variance)
    least = density(*at)
    for i, change in ((0, 1.3), (0, 0.7), (1, 1.05), (1, 0.95), (2, 1.2), (2, 0.8)):
        moved = list(at)
        moved[i] *= change
        assert density(*moved) > least


def test_dc_is_at_least_as_likely_as_tc_which_is_a_case_of_it(arm: Any) -> None:
    """On the arm a search from the grid alone ended in a poorer maximum."""
    tc, dc = (impulse_response(arm.telegraph(), 100, kernel) for kernel in ("tc", "dc"))

    assert dc.hyperparameters["correlation"] == pytest.approx(
        np.sqrt(tc.hyperparameters["decay"]), abs=0.05
    )


def test_an_integrating_angle_is_estimated_by_its_rate(arm: Any) -> None:
    """The response tends to the gain times Ts and stays there."""
    found = impulse_response(arm.telegraph())

    rate = arm.rate(100)
    assert found.integrator
    assert np.sqrt(np.mean((found.rate - rate) ** 2)) < 0.02
    np.testing.assert_allclose(found.g, 0.01 * np.cumsum(found.rate))
    assert found.g[-1] == pytest.approx(0.01 * rate.sum(), rel=0.02)
    assert found.died_out


def test_unregularised_bands_of_the_rate_are_valid_up_to_the_last_lag(arm: Any) -> None:
    """Later lags do not add to the last coefficient."""
    truth = arm.rate(60)
    z = []
    for seed in range(15):
        found = impulse_response(arm.telegraph(seed), 60, kernel=None)
        z.append((found.rate - truth) / found.decaying[1])

    assert np.sqrt(np.mean(np.square(z), axis=0))[-1] < 1.6
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("kernel", [None, *KERNELS])
def test_the_response_of_the_dryer_begins_at_lag_3(
    kernel: Kernel | None, reference: Callable[[str], NDArray[np.float64]]
) -> None:
    """The first coefficient outside its 99 % band, first 300 samples."""
    u, y = reference("dryer.dat")[:300].T

    found = impulse_response(Dataset(u=u, y=y, Ts=0.08), kernel=kernel)

    assert found.first_lag(0.99) == 3


@pytest.mark.parametrize("kernel", [None, "tc"])
@pytest.mark.parametrize("p", [0.002, 0.3])
@pytest.mark.parametrize(("last", "std"), [(0.019, 0), (-0.021, 0), (0.027, 0.01), (0.03, 0.01)])
def test_the_last_lags_or_coloured_residuals_cause_a_warning_on_a_band(
    kernel: Kernel | None, p: float, last: float, std: float
) -> None:
    """The last tenth counts, within 2 % or 4 deviations; least squares may leave a colour."""
    g = np.append(np.ones(18), [last + 0.5, last - 0.5])

    told = list(_warnings(g, std**2 * np.eye(20), kernel, Whiteness(p_value=p, test=LJUNG_BOX)))

    short = "the response has not decayed at the last lags: give more lags (n)"
    assert [x == short for x in told] == [True] * (last in (-0.021, 0.03)) + [False] * (
        kernel == "tc" and p < 0.05
    )


def test_the_spectrum_of_a_response_carries_its_uncertainty(second: Any) -> None:
    """|G| and arg G within their 95 % bands in 95 % of 100 runs."""
    w = np.linspace(0.1, 3.0, 10)
    truth, held = second.response(w), np.zeros(2)
    for seed in range(100):
        data = second.dataset(np.random.default_rng(seed), 800, v_pole=0.5, std=0.3)
        found = impulse_response(data, 40, kernel=None, integrator=False).spectrum(w)
        held += [
            np.mean(np.abs(found.magnitude - np.abs(truth)) < 1.96 * found.std_magnitude),
            np.mean(np.abs(np.angle(found.G / truth)) < 1.96 * found.std_phase),
        ]

    assert np.all((held > 91) & (held < 98))


def test_an_impulse_response_of_too_few_rows_is_refused(second: Any) -> None:
    data = second.dataset(np.random.default_rng(8), 60)
    still = Dataset(u=np.ones(200), y=np.zeros(200), Ts=1.0)

    with pytest.raises(ValueError, match="kernel='rbf' must be one of"):
        impulse_response(data, kernel="rbf", integrator=False)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="needs at least 43 rows"):
        impulse_response(data, 40, kernel=None, integrator=False)
    with pytest.raises(ValueError, match="u is constant"):
        impulse_response(still, 20, kernel=None, integrator=False)
    with pytest.raises(ValueError, match="level=95 must lie between 0 and 1"):
        impulse_response(data, 5, integrator=False).band(95)


@pytest.mark.exhaustive
@pytest.mark.parametrize("kernel", [None, "tc"])
def test_the_memory_does_not_grow_with_the_data(kernel: Kernel | None) -> None:
    """A hundred lags of 100 000 samples need less memory than 30 arrays of that length."""
    rng = np.random.default_rng(9)
    u = rng.standard_normal(100_000)
    v = apply_filter([1.0], [1.0, -0.7], rng.standard_normal(u.size))
    data = Dataset(u=u, y=apply_filter([0, 1.0, 0.5], [1.0, -0.6], u) + v, Ts=1.0)

    tracemalloc.start()
    impulse_response(data, 100, kernel=kernel, integrator=False)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert peak < 30 * u.nbytes


@pytest.mark.parametrize(
    ("decays", "died", "asked", "chosen"),
    [
        ([0.5, 0.9, 0.9], [True] * 3, [20], 20),
        ([0.99, 0.95, 0.9], [True] * 3, [20, 60], 60),  # 0.95^60 = 0.046
        ([0.5, 0.5, 0.5], [False, True, True], [20, 60], 60),
        ([0.9, 0.99, 0.995], [False, False, False], [20, 60, 100], 20),
        ([0.9, 0.999, 0.995], [False, True, True], [20, 60, 100], 100),
        ([0.9, 0.99, 0.995], [False, True, True], [20, 60, 100], 60),  # 0.547 and 0.606
    ],
)
def test_the_least_sufficient_number_of_lags_is_chosen(
    decays: list[float],
    died: list[bool],
    asked: list[int],
    chosen: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A fifth of the known samples, here 100, is the largest number."""
    numbers, tried = (20, 60, 100), []

    def estimated(_: Dataset, n: int, **of: bool) -> Any:
        tried.append(n)
        i = numbers.index(n)
        assert of == {"integrator": True}
        return SimpleNamespace(
            hyperparameters={"decay": decays[i]}, lags=np.arange(n), died_out=died[i]
        )

    monkeypatch.setattr(impulse, "impulse_response", estimated)
    u = np.arange(600.0)
    data = Dataset(u=u, y=u, Ts=1.0, valid=u % 6 > 0)

    found = impulse.long_enough(data, (20, 60, 200, 400), integrator=True)

    assert tried == asked
    assert found.lags.size == chosen


def test_each_experiment_has_its_own_level_and_ramp(arm: Any) -> None:
    first, other = arm.telegraph(1, 1500), arm.telegraph(2, 1500)
    moved = other.replaced(step=None, y=other.y + 40.0 + 0.3 * other.t)

    a, b = (impulse_response(merge([first, x]), 60) for x in (other, moved))

    np.testing.assert_allclose(a.g, b.g, atol=1e-7)
