"""The rehearsal: the model's exact answer, and what leaves a limit is refused."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, degrees, inf, pi, tau

import numpy as np
import pytest
from armrig_core.commands.commands import rehearsal_sentence
from armrig_core.commands.rehearsal import rehearse
from armrig_core.errors import InputError
from armrig_core.rig.arm import ArmParameters
from armrig_daemon.emulator.plant import REST, advance, build
from numpy.typing import NDArray

P = ArmParameters()
SPEED = P.torque_per_volt / P.damping  # rad/s for 1 V


def _telegraph(N: int, seed: int = 1) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return np.where(rng.random(N).cumsum() % 2 < 1, 0.5, 4.5)


def _played(
    u: NDArray[np.float64], Ts: float, each: int, parameters: ArmParameters = P
) -> NDArray[np.float64]:
    """Return theta_1 and alpha of the emulator's plant, looked at `each` times a sample."""
    plant, x, seen = build(parameters), REST, []
    step_ns = round(Ts * 1e9 / each)
    for volts in u:
        for _ in range(each):
            x = advance(plant, x, float(volts), step_ns)
            seen.append(x[:2])
    return np.array(seen)


@pytest.mark.parametrize("N", [1, 2, 63, 64, 65, 128, 777])
def test_the_rehearsal_ends_at_the_angles_of_the_emulated_rig(N: int) -> None:
    """The emulator is another implementation of the same arm; N is near the ends of blocks."""
    u = _telegraph(N)

    seen = _played(u, 0.005, 1)
    found = rehearse(u, 0.005)

    assert found.turned_rad == pytest.approx(seen[-1, 0], rel=1e-9)
    assert found.alpha_rad == pytest.approx(np.abs(seen[:, 1]).max(), rel=1e-9)
    assert found.revolutions == pytest.approx(np.abs(seen[:, 0]).max() / tau, rel=1e-9)


@pytest.mark.parametrize("Ts", [0.01, 0.1, 1.0])
def test_a_peak_between_two_samples_is_detected(Ts: float) -> None:
    """A long Ts hides the swing of the arm from the samples."""
    u = _telegraph(max(4, round(2 / Ts)))

    seen = np.abs(_played(u, Ts, ceil(Ts / 0.0002))[:, 1])
    found = rehearse(u, Ts).alpha_rad

    assert 0.995 * seen.max() <= found <= seen.max() * (1 + 1e-9)
    if Ts == 1.0:
        at_the_samples = seen[ceil(Ts / 0.0002) - 1 :: ceil(Ts / 0.0002)]
        assert at_the_samples.max() < 0.9 * found


def test_a_long_run_does_not_drift() -> None:
    """600 000 samples of 3 V: each turns the chassis by SPEED 3 V Ts."""
    found = rehearse(np.full(600_000, 3.0), 0.01)

    lag = P.J_1 + P.J_2  # turning along as one body
    expected = SPEED * 3.0 * (6000 - lag / P.damping)
    assert found.turned_rad == pytest.approx(expected, rel=1e-9)


def test_the_predicted_rotation_counts_from_the_present_angle() -> None:
    u = _telegraph(300)

    from_2 = rehearse(u, 0.01, theta_1_rad=2.0)

    assert from_2.theta_1_rad == pytest.approx(2.0 + from_2.turned_rad)
    assert rehearse(u, 0.01, theta_1_rad=0.0).theta_1_rad == from_2.turned_rad
    assert rehearse(u, 0.01).theta_1_rad is None
    words = rehearsal_sentence(from_2)
    assert f"{from_2.revolutions:.1f} times" in words
    assert f"ends {degrees(from_2.turned_rad):.0f}° from its start" in words
    assert f"up to {degrees(from_2.alpha_rad):.1f}°" in words


def test_a_run_is_refused_exactly_at_the_limit() -> None:
    u = np.full(1000, 3.0)
    turns = rehearse(u, 0.01).revolutions
    at = int(np.argmax(_played(u, 0.01, 1)[:, 0] >= pi * 2))  # the first whole turn

    rehearse(u, 0.01, revolutions=turns * 1.0001)
    with pytest.raises(InputError, match=r"reached at u\[999\].* change the limit \(\[limits\]"):
        rehearse(u, 0.01, revolutions=turns)
    with pytest.raises(InputError) as refusal:
        rehearse(u, 0.01, revolutions=1.0)

    text = str(refusal.value)
    assert f"turns theta_1 by up to {turns:.3g} turns: theta_1.turns = 1 is" in text
    assert f"reached at u[{at}], {at * 0.01:.3g} s; shorten the input" in text


def test_a_refusal_names_the_first_time_of_an_excessive_deflection() -> None:
    """A step of 4 V after a second at rest swings the arm, first to the other side."""
    u = np.r_[np.zeros(100), np.full(100, 4.0)]
    most = rehearse(u, 0.01).alpha_rad

    rehearse(u, 0.01, alpha_rad=most * 1.001)
    with pytest.raises(InputError, match=r"takes alpha from -.* to .* rad: alpha") as refusal:
        rehearse(u, 0.01, alpha_rad=most / 100)

    assert "alpha.low = -" in str(refusal.value)
    assert "reached at u[100], 1 s" in str(refusal.value)


def test_the_rehearsal_uses_the_given_arm_parameters() -> None:
    u = _telegraph(500)
    softer = replace(P, K_lin=P.K_lin / 4)

    found = rehearse(u, 0.01, parameters=softer)
    alone = rehearse(u, 0.01, arm_removed=True, alpha_rad=1e-9)

    assert found.turned_rad == pytest.approx(_played(u, 0.01, 1, softer)[-1, 0], rel=1e-9)
    assert found.alpha_rad > 1.1 * rehearse(u, 0.01).alpha_rad
    assert alone.alpha_rad == 0.0
    assert 0 < alone.turned_rad < inf
