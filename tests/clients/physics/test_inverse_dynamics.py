"""The second estimate: unbiased, with right deviations, and in agreement with the first."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.physics.grey_box.smoothing import kernels, smoothed, smoothed_noise_p_value
from armrig.physics.systems import ArmParameters
from scipy.special import ndtr

from tests.clients.chassis_data import Make, Ts, angle

HANDOUT = ArmParameters()


def test_the_smoothed_signals_are_derivatives_in_phase() -> None:
    w, s = 20.0, 0.02
    t = Ts * np.arange(1000)
    x = smoothed(Dataset(u=np.ones(1000), y=np.sin(w * t) + 50 * t + 200, Ts=Ts), s)

    inside = np.isfinite(x.velocity)
    gain = float(np.max(x.acceleration[inside])) / w**2
    assert gain == pytest.approx(np.exp(-((w * s) ** 2) / 2), rel=1e-2)
    np.testing.assert_allclose(x.velocity[inside], 50 + gain * w * np.cos(w * t[inside]), atol=1e-3)
    np.testing.assert_allclose(
        x.acceleration[inside], -gain * w**2 * np.sin(w * t[inside]), atol=0.02
    )
    np.testing.assert_allclose(x.u[inside], 1.0, rtol=1e-12)


@pytest.mark.parametrize(("every", "within"), [(1, 1e-6), (5, 2e-4)])
def test_noise_free_data_give_back_the_inertia(every: int, within: float) -> None:
    """At 2 ms and at 10 ms: the error of the sums falls with the fourth power."""
    u = np.repeat(armrig.telegraph(1000, 0.1, seed=2), 5)
    y = angle(u, HANDOUT)
    data = Dataset(u=u[::every], y=y[::every], Ts=every * Ts)

    fit = armrig.inverse_dynamics(data)

    assert fit.values["J_1"] == pytest.approx(HANDOUT.J_1, rel=within)


@pytest.fixture(scope="module")
def sound(make: Make) -> list[armrig.GreyFit]:
    """Give the second estimate of 60 sound experiments."""
    return [armrig.inverse_dynamics(make(seed)) for seed in range(60)]


@pytest.mark.exhaustive
def test_the_standard_deviation_equals_the_scatter_of_experiments(
    make: Make, sound: list[armrig.GreyFit]
) -> None:
    """Over 40 seeds."""
    pairs = [(armrig.greybox(make(seed)), sound[seed]) for seed in range(40)]

    z = np.array([(b.values["J_1"] - HANDOUT.J_1) / b.std["J_1"] for _, b in pairs])
    assert 0.66 < z.std(ddof=1) < 1.34
    assert abs(z.mean()) < 0.5
    assert all(a.std["J_1"] < b.std["J_1"] for a, b in pairs)
    disagree = [armrig.agreement(a, b)[0].p_value < 0.01 for a, b in pairs]
    assert np.mean(disagree) < 0.07


def test_two_methods_disagree_on_a_wrong_model(make: Make) -> None:
    data = make(p=ArmParameters(b_1=5e-3))
    first, second = armrig.greybox(data), armrig.inverse_dynamics(data)

    [verdict] = armrig.agreement(first, second)

    assert verdict.p_value < 0.05
    assert verdict.difference == second.values["J_1"] - first.values["J_1"]
    assert f"J_1: {verdict.difference:+.3g} apart, " in repr(verdict)


def test_the_variance_of_a_difference_is_the_difference_of_the_variances() -> None:
    """It is at least a hundredth of the other variance; only common parameters are compared."""
    efficient: Any = SimpleNamespace(
        names=("J_1", "b_1", "K_m"),
        values={"J_1": 10.0, "b_1": 2.0},
        std_noise={"J_1": 3.0, "b_1": 1.0},
        quantum=0.0,
        noise_variance=1.0,
    )
    other: Any = SimpleNamespace(
        names=("b_1", "J_1"), values={"J_1": 2.0, "b_1": 2.1}, std_noise={"J_1": 5.0, "b_1": 1.0}
    )

    inertia, friction = armrig.agreement(efficient, other)

    assert (inertia.name, inertia.difference, inertia.std) == ("J_1", -8.0, 4.0)
    assert inertia.p_value == pytest.approx(2 * ndtr(-2.0))
    assert repr(inertia) == "J_1: -8 apart, -2.00 sd, p = 0.046"
    assert friction.std == pytest.approx(0.1)
    assert friction.p_value == pytest.approx(2 * ndtr(-1.0))
    efficient.quantum = 10.0
    assert all("(the noise is" in repr(one) for one in armrig.agreement(efficient, other))


def test_an_offset_is_estimated_with_both_frictions(make: Make) -> None:
    data = make(
        p=ArmParameters(b_1=5e-3),
        coulomb_nm=0.02,
        low=0.0,
        high=5.0,
        shift=2.5,
        std=1e-3,
        N=10_000,
        offset=0.3,
    )

    fit = armrig.inverse_dynamics(data, friction="both")

    for name, truth in (("J_1", HANDOUT.J_1), ("b_1", 5e-3), ("T_c", 0.02)):
        assert abs(fit.values[name] - truth) < 4 * fit.std[name]
    assert fit.offset[0] == pytest.approx(0.3, abs=0.02)


@pytest.mark.exhaustive
def test_residuals_are_tested_against_smoothed_noise(
    make: Make, sound: list[armrig.GreyFit]
) -> None:
    """Hardly one of 60 sound experiments is warned of."""
    rubbing = [armrig.inverse_dynamics(make(s, p=ArmParameters(b_1=5e-3))) for s in range(10)]

    assert sum(bool(fit.warnings) for fit in sound) <= 4
    assert 0.25 < np.median([fit.whiteness for fit in sound]) < 0.75
    assert all("friction?" in fit.warnings[0] for fit in rubbing)


def test_an_acceleration_without_noise_has_no_p_value() -> None:
    h = np.array([1.0, -2.0, 1.0])

    assert np.isnan(smoothed_noise_p_value([np.zeros(100)], h, 1))
    alone = np.where(np.arange(100) % 10 == 0, 1.0, np.nan)
    assert np.isnan(smoothed_noise_p_value([alone], h, 1))


def test_known_friction_is_part_of_the_torque_balance(make: Make) -> None:
    truth = ArmParameters(b_1=0.05)
    data = make(p=truth)

    fit = armrig.inverse_dynamics(data, fixed=truth)
    low, high = (
        armrig.inverse_dynamics(data, fixed=ArmParameters(b_1=b), width=0.02).values["J_1"]
        for b in (0.049, 0.051)
    )

    assert abs(fit.values["J_1"] - truth.J_1) < 4 * fit.std["J_1"]
    around = armrig.inverse_dynamics(data, fixed=truth, width=0.02, fixed_std={"b_1": 0.02})
    slope = (high - low) / 0.002
    assert around.influence["J_1"]["b_1"] == pytest.approx(slope * 0.05 / truth.J_1, abs=1e-3)
    carried = np.sqrt(around.std["J_1"] ** 2 - around.std_noise["J_1"] ** 2)
    assert carried == pytest.approx(abs(slope) * 0.02, rel=0.05)


def test_too_short_data_are_refused(make: Make) -> None:
    with pytest.raises(ValueError, match=r"no kernel from 0\.0025 to .* leaves 10 values for each"):
        armrig.inverse_dynamics(make(N=20))
    with pytest.raises(ValueError, match='or with fewer stops; friction="viscous"'):
        armrig.inverse_dynamics(make(N=60), friction="both")


@pytest.mark.parametrize("width", [4.0, 1e9])
def test_a_kernel_longer_than_the_data_is_refused_before_its_calculation(
    make: Make, width: float
) -> None:
    """A kernel of 1e9 s would need a terabyte."""
    with pytest.raises(ValueError, match="the longest experiment has 5000; give 1 s or less"):
        armrig.inverse_dynamics(make(), width=width)


def test_the_width_of_the_kernel_follows_the_noise(make: Make) -> None:
    quiet, loud = (armrig.inverse_dynamics(make(std=std)) for std in (2e-4, 2e-2))

    assert quiet.width <= loud.width
    for fit in (quiet, loud):
        assert abs(fit.values["J_1"] - HANDOUT.J_1) < 4 * fit.std["J_1"]
        assert 0 < fit.bias["J_1"] < fit.std["J_1"]


def test_the_reported_bias_is_real(make: Make) -> None:
    """A narrow kernel, on the mean of 40 experiments."""
    fits = [armrig.inverse_dynamics(make(seed), width=3e-3) for seed in range(40)]

    off = np.array([fit.values["J_1"] - HANDOUT.J_1 for fit in fits])
    told = np.array([fit.bias["J_1"] for fit in fits])
    assert off.mean() > 5 * off.std() / np.sqrt(40)
    assert abs((off - told).mean()) < 3 * off.std() / np.sqrt(40)
    assert any("the noise of the velocity shifts J_1 by +" in w for w in fits[0].warnings)


@pytest.mark.parametrize("slower", [1.0, 1e3])
def test_a_slow_machine_is_not_treated_as_at_rest(make: Make, slower: float) -> None:
    """The same motion in other units of time."""
    fast = make(p=ArmParameters(b_1=5e-3), coulomb_nm=0.02, low=0.0, high=5.0, std=1e-3, N=10_000)
    # J x'' = a u - (d + b) x' - T: with time, a, d and b by `slower`, J by its square.
    data = armrig.Dataset(u=fast.u, y=fast.y, Ts=fast.Ts * slower, output="theta_1", unit="rad")
    truth = {"J_1": HANDOUT.J_1 * slower**2, "b_1": 5e-3 * slower, "T_c": 0.02}
    other = ArmParameters(
        J_1=truth["J_1"], N=HANDOUT.N * slower, R_m=HANDOUT.R_m * slower, K_m=HANDOUT.K_m
    )

    fit = armrig.inverse_dynamics(data, other, friction="both")

    for name, value in truth.items():
        assert abs(fit.values[name] - value) < 4 * fit.std[name]
    assert fit.std["J_1"] < 0.01 * truth["J_1"]


def test_smoothed_white_noise_is_rejected_at_the_nominal_level() -> None:
    """At 1 % of 100 values each, 1000 times: chance gives 0.3 to 2.2 %."""
    h, m = kernels(0.05, 0.002).second, 37
    rng = np.random.default_rng(1)

    noise = (rng.standard_normal(100 * m + h.size) for _ in range(1000))
    p = [smoothed_noise_p_value([np.convolve(v, h, "valid")[::m]], h, m) for v in noise]

    assert 0.003 < np.mean(np.array(p) < 0.01) < 0.022


def test_an_offset_without_friction_is_found_in_every_experiment(make: Make) -> None:
    """An input of one sign determines an offset, too."""
    fit = armrig.inverse_dynamics(merge([make(1, 2000, offset=-0.4), make(2, 1500, offset=-0.4)]))

    assert fit.offset == pytest.approx((-0.4, -0.4), abs=0.02)
    assert abs(fit.values["J_1"] - HANDOUT.J_1) < 4 * fit.std["J_1"]
