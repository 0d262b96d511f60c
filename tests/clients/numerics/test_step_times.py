"""Each time of a step response is the same number in every command."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import armrig
import numpy as np
import pytest
from armrig.models.characteristics import model_characteristics
from armrig.numerics.step_times import (
    area_above,
    lag_of_angle,
    linear_crossing,
    mean_lag,
    rise_time,
    slowest_time,
)
from armrig.physics.step_response import step_response
from armrig.physics.systems import physical_model
from armrig_core.rig.arm import ArmParameters
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.sampling import sampled

OTHERS = {
    "handout": ArmParameters(),
    "J_1 doubled": ArmParameters(J_1=3.4e-3),
    "soft spring": ArmParameters(K_lin=0.3),
    "friction": ArmParameters(b_1=0.02),
}
EVERY = pytest.mark.parametrize("p", OTHERS.values(), ids=OTHERS.keys())


def _stepped(p: ArmParameters, Ts: float) -> armrig.Dataset:
    """Return the angle without noise before and after a step of 1 V."""
    n = round(15 * armrig.physics.characteristics(p).slowest_time / Ts)
    angle = step_response(p, Ts * np.arange(n), state="theta_1")
    y, u = np.concatenate([np.zeros(n), angle]), np.repeat([0.0, 1.0], n)
    return armrig.Dataset(u=u, y=y, Ts=Ts, output="theta_1", unit="rad")


def _shown(p: ArmParameters, Ts: float) -> Iterator[tuple[str, float, float, float]]:
    """Iterate over what shows a 63 % time, its deviation, and an equivalent time."""
    data = _stepped(p, Ts)
    of_model = model_characteristics(physical_model(p, data))
    of_data = armrig.step_analysis(data)
    yield "model", of_model.rise_time, 0.0, of_model.equivalent_time
    yield "step analysis", of_data.tau, of_data.tau_std, of_data.equivalent_time
    yield "sampling time", armrig.sampling_time(data).tau, of_data.tau_std, of_data.equivalent_time


@EVERY
@pytest.mark.parametrize("Ts", sampled([0.01, 0.005]))
def test_a_time_is_equal_in_all_places_that_show_it(p: ArmParameters, Ts: float) -> None:
    """`armrig model`, `compare`, the step analysis and `armrig sampling` give one number."""
    truth = armrig.physics.characteristics(p)

    for where, rise, std, equivalent in _shown(p, Ts):
        assert rise == pytest.approx(truth.rise_time, rel=0.01, abs=2 * std), where
        assert std <= 0.2 * Ts, where
        assert equivalent == pytest.approx(truth.equivalent_time, rel=0.005), where
    of_model = model_characteristics(physical_model(p, _stepped(p, Ts)))
    assert of_model.slowest_time == pytest.approx(truth.slowest_time, rel=1e-4)


def test_the_arms_times_are_known_in_closed_form() -> None:
    """The equivalent time contains both inertias: (J_1 + J_2) R_m/(N K_m)²."""
    p = ArmParameters()
    found = armrig.physics.characteristics(p)

    total = (p.J_1 + p.J_2) * p.R_m / (p.N * p.K_m) ** 2
    assert found.equivalent_time == pytest.approx(total, rel=1e-6)
    stiff = armrig.physics.characteristics(replace(p, K_lin=1e5))
    assert stiff.rise_time == pytest.approx(total, rel=0.01)
    assert found.slowest_time == pytest.approx(-1 / found.poles[1].real)


@given(tau=st.floats(1.0, 200.0), dead=st.integers(0, 5))
def test_all_three_times_of_a_first_order_system_are_its_time_constant(
    tau: float, dead: int
) -> None:
    """The trapezoidal rule gives the area to 1/12 of a sample squared."""
    pole = np.exp(-1 / tau)
    y = 1 - pole ** np.arange(round(12 * tau))
    B, F = np.append(np.zeros(dead + 1), 1 - pole), np.array([1.0, -pole])

    assert rise_time(y, 1.0) == pytest.approx(tau, rel=0.01)
    assert mean_lag(B, F) - dead - 0.5 == pytest.approx(tau, abs=0.1 / tau)
    assert slowest_time(np.log([pole])) == pytest.approx(tau)


def test_parameters_that_are_far_apart_have_their_times() -> None:
    """The arm rings a million times during the decay of the motor."""
    light, heavy = (
        armrig.physics.characteristics(p) for p in (ArmParameters(J_2=1e-9), ArmParameters(J_1=1e9))
    )

    assert light.rise_time == pytest.approx(light.equivalent_time, rel=0.01)
    assert light.slowest_time > 1e6 * light.rise_time
    assert heavy.rise_time == pytest.approx(heavy.equivalent_time, rel=0.01)


def test_two_samples_are_a_straight_line() -> None:
    assert rise_time(np.array([0.0, 1.0]), 0.1) == pytest.approx(0.1 * (1 - np.exp(-1)))
    assert np.isnan(rise_time(np.array([0.0]), 0.1))


def test_a_level_that_is_never_reached_has_no_time() -> None:
    y: NDArray[np.float64] = np.linspace(0.0, 0.6, 20)

    assert np.isnan(rise_time(y, 0.1))
    assert np.isnan(linear_crossing(0.1 * np.arange(20), y, 0.9))
    assert np.isnan(rise_time(np.array([0.0, np.inf, 1.0]), 0.1))
    assert np.isnan([slowest_time(decay) for decay in ([], [-1.0, 0.5], [-1.0, 0.0])]).all()


@pytest.mark.parametrize("level", [0.1, 0.25, 0.4, 1.0])
def test_a_crossing_lies_on_the_line_between_two_samples_or_from_the_origin(level: float) -> None:
    t, y = np.array([0.5, 1.5, 2.0]), np.array([0.25, 0.4, 1.0])

    found = linear_crossing(t, y, level)

    assert np.interp(found, [0.0, *t], [0.0, *y]) == pytest.approx(level)


def test_the_deviation_of_a_lag_is_that_of_two_lines_where_they_meet() -> None:
    """The line before the step moves the meeting point, too; a missing sample changes nothing."""
    rng = np.random.default_rng(1)
    slope, noise = -3.0, 0.02
    early, late = -2.0 + 0.005 * (np.arange(400) + 0.5), 4.0 + 0.005 * np.arange(600)
    y = slope * (late - 0.7) + noise * rng.standard_normal(600)
    y[[5, 300]] = np.nan

    lag, std = lag_of_angle(late, y, before=(400, 2.0), rounding=0.0)
    rounded = lag_of_angle(late, y, before=(400, 2.0), rounding=0.1)[1]

    kept = np.isfinite(y)
    X, (here, there) = np.array([1.0, lag]), (np.vander(t, 2, True) for t in (early, late[kept]))
    fitted = np.linalg.lstsq(there, y[kept], rcond=None)[0]
    residual = y[kept] - there @ fitted
    shares = sum(X @ np.linalg.inv(M.T @ M) @ X for M in (here, there))
    expected = np.sqrt(residual @ residual / (kept.sum() - 2) * shares) / abs(fitted[1])
    assert lag == pytest.approx(-fitted[0] / fitted[1])
    assert lag == pytest.approx(0.7, abs=4 * std)
    assert std == pytest.approx(expected, rel=1e-3)
    assert rounded == pytest.approx(np.hypot(std, 0.1 / np.sqrt(12) / abs(fitted[1])))
    assert np.isnan(lag_of_angle(late[:5], y[:5], before=(9, 1.0), rounding=0.0)).sum() == 0
    assert np.isnan(lag_of_angle(late[:3], y[:3], before=(9, 1.0), rounding=0.0)).all()


def test_an_area_has_the_error_of_its_samples_and_of_its_final_value() -> None:
    t = np.array([0.1, 0.2, 0.4, 0.5, 0.6])
    y = np.array([0.0, 0.5, np.nan, 1.0, 1.0])

    area, std = area_above(t, y, 0.0, 0.02)

    assert area == pytest.approx(0.1 * 0.75 + 0.3 * 0.25)
    assert std == pytest.approx(0.02 * 0.5)
    even = np.array([0.1, 0.2, 0.3, 0.4])  # inner samples stand for 0.1 s, as do both ends
    assert area_above(even, np.ones(4), 0.3, 0.0) == pytest.approx((0.0, 0.3 * 0.2))
