"""A first coefficient too small to see is no delay; where it cannot be told, that is said."""

from __future__ import annotations

from functools import cache

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.validation.feedback_and_delay.delay import Delay
from armrig_core.arm import ArmParameters, arm_matrices, zero_order_hold
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Ts, NOISE, LSB = 0.002, 5e-3, np.deg2rad(352.0) / 1024


def angle(u: Vector, finer: int = 1) -> Vector:
    """Return theta_1 every Ts, for u held over Ts / `finer`."""
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, Ts / finer)
    x, y = np.zeros(4), np.empty(u.size)
    for k in range(u.size):
        y[k] = C[0] @ x
        x = Phi @ x + Gamma[:, 0] * u[k]
    return y[::finer]


def observed(seed: int, *, late: float = 0.0, output: str = "theta_1") -> Dataset:
    """Return 12 s at 2 ms, `late` samples late (in quarters), with white noise."""
    rng = np.random.default_rng([23, seed])
    u = armrig.telegraph(6000, 0.01, 0.0, 5.0, seed=rng)
    quarters = round(4 * late)
    delayed = np.concatenate([np.zeros(quarters), np.repeat(u, 4)])[: 4 * u.size]
    y = angle(delayed, 4) + NOISE * rng.standard_normal(u.size)
    return Dataset(u=u, y=y, Ts=Ts, output=output, unit="rad")


@cache
def undelayed() -> Delay:
    """Return what is found where nothing is late."""
    return armrig.delay(observed(1))


@pytest.mark.parametrize("samples", [0, 1, 5])
def test_at_a_short_sampling_time_the_shape_of_the_onset_tells(samples: int) -> None:
    """Where the first coefficient alone is within the noise."""
    found = armrig.delay(observed(1, late=samples)) if samples else undelayed()

    assert found.told
    assert found.delay == samples
    assert found.misfit[samples + 1] < 0.01 * min(
        chi2 for k, chi2 in found.misfit.items() if k != samples + 1
    )


def test_half_a_sample_is_neither_of_its_neighbours() -> None:
    """Neither onset explains it, and no delay is claimed."""
    found = armrig.delay(observed(2, late=1.5))

    assert not found.told
    assert found.interval == (2, 3)
    assert found.delay == 1
    assert "nk between 2 and 3: cannot be told at this Ts and noise" in repr(found)


def test_without_knowing_the_kind_of_onset_the_lag_before_is_not_ruled_out() -> None:
    """An output of no known name may begin as slowly as an angle does."""
    found = armrig.delay(observed(3, output="y"), integrator=True)

    assert found.interval == (1, 2)
    assert not found.told


def test_the_level_of_the_tests_is_told() -> None:
    """Beside the result and in the explanation."""
    found = undelayed()

    assert "level 1 %" in repr(found)
    assert "a level of 1 %" in found.explain()


def stepped(at: int) -> Delay:
    """Return what is found on one step of 4 V, read with 10 bits and no noise."""
    u = np.where(np.arange(1500) < at, 0.5, 4.5)
    y = (np.floor(angle(u) / LSB) + 0.5) * LSB
    return armrig.delay(Dataset(u=u, y=y, Ts=Ts, output="theta_1", unit="rad"))


@pytest.mark.parametrize("at", [157, 161])
def test_one_step_read_in_steps_is_no_delay(at: int) -> None:
    """What quantisation hides is not claimed."""
    found = stepped(at)

    assert found.interval[0] <= 1 <= found.interval[1]
    assert found.delay <= 0
