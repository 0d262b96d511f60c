"""Margins: those of python-control where it is right, and of a simulation in every case."""

from __future__ import annotations

import warnings
from typing import Any

import armrig
import control
import numpy as np
import pytest
from armrig.control.loop import (
    LawMatrices,
    are_stable,
    close_loop,
    frequency_grid,
    loop_response,
    margins,
    margins_of_draws,
)
from armrig.control.plant import design_model
from scipy.signal import lfilter

from tests.clients.control import plants

Ts = 0.05
_W = 2 * np.pi
CASES = {
    "issue 465": control.tf([2], [1, 3, 2, 0]),
    "issue 523, with a sample of delay unstable": 0.5 * control.tf(_W**2, [1, 0.4 * _W, _W**2]),
    "first order": control.tf([3], [0.5, 1]),
    "two lags": control.tf([4], [0.2, 1.2, 1]),
    "resonance": control.tf([0.05, 0.2], [1, 0.02, 1]),
    "right zero": control.tf([-0.3, 0.6], [1, 1.4, 0.4]),
    "slow": control.tf([0.002], [1, 0.002]),
}


def _law(gain: float) -> LawMatrices:
    """Return u[k] = -gain y[k-1]."""
    zero, one = np.zeros(1), np.ones(1)
    return LawMatrices(np.zeros((1, 1)), zero, zero, one[:, None], -gain * one, 0.0, 0, (0,))


def _plant(system: Any) -> Any:
    return design_model(control.ss(control.sample_system(system, Ts)), Ts=Ts).plant


@pytest.mark.parametrize("name", CASES)
def test_margins_equal_those_of_python_control_where_it_is_right(name: str) -> None:
    """The polynomial method of python-control is right on these loops; it warns of rounding."""
    sampled = control.tf(control.sample_system(CASES[name], Ts))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        L = sampled * control.tf([1], [1, 0], Ts)
        gain, phase, _, gain_at, phase_at, _ = control.stability_margins(L, method="poly")

    m = margins(_law(1.0), _plant(CASES[name]), Ts)

    assert m.stable
    # Its distance from -1 is wrong by 0.4 % for issue 465: its response is compared.
    w = m.Ms_at * np.linspace(0.99, 1.01, 2001)
    every = np.append(np.geomspace(1e-4, np.pi / Ts, 5000), w)
    assert 1 / m.Ms == pytest.approx(np.abs(1 + L(np.exp(1j * every * Ts))).min(), rel=1e-6)
    assert m.gain == pytest.approx(gain, rel=1e-6)
    assert m.gain_at == pytest.approx(gain_at, rel=1e-6)
    if np.isfinite(phase):
        assert m.phase_deg == pytest.approx(abs(phase), rel=1e-6)
        assert m.phase_at == pytest.approx(phase_at, rel=1e-6)
    else:
        assert m.phase_deg == np.inf


@pytest.mark.parametrize("name", CASES)
def test_the_loop_is_unstable_just_beyond_its_margins_and_not_before(name: str) -> None:
    """A simulation of the closed loop decays below the gain and delay margin, and grows above."""
    sampled = control.tf(control.sample_system(CASES[name], Ts))
    F = sampled.den[0][0]
    B = np.pad(sampled.num[0][0], (F.size - sampled.num[0][0].size, 0))
    m = margins(_law(1.0), _plant(CASES[name]), Ts)

    with np.errstate(all="ignore"):
        assert _grows(B * m.gain * 1.01, F, 1)
    assert not _grows(B * m.gain * 0.99, F, 1)
    if np.isfinite(m.delay_s):
        assert not _grows(B, F, 1 + int(np.floor(m.delay_s / Ts)))
        assert _grows(B, F, 1 + int(np.ceil(m.delay_s / Ts)))


def _grows(B: Any, F: Any, delay: int) -> bool:
    """Return whether the pulse response of F y = -B u, u[k] = y[k - delay], grows in the end."""
    n = max(F.size, B.size + delay)
    closed = np.pad(F, (0, n - F.size)) + np.pad(B, (delay, n - B.size - delay))
    y = np.abs(lfilter([1.0], closed, np.eye(1, 40_000)[0]))
    return not np.isfinite(y[-1]) or bool(y[30_000:].max() > y[10_000:20_000].max())


def test_a_loop_that_oscillates_at_the_nyquist_frequency_has_a_gain_margin_there() -> None:
    """With y[k+1] = 0.5 y[k] + u[k] and u[k] = -k y[k-1], Im L is 0 at z = -1 by itself."""
    plant = design_model(plants.model([0, 1.0], [1, 0.5]), Ts=Ts).plant
    law = LawMatrices(
        np.zeros((1, 1)),
        np.zeros(1),
        np.zeros(1),
        np.ones((1, 1)),
        np.array([0.3]),
        0.0,
        0,
        (0,),
    )

    m = margins(law, plant, Ts)

    assert m.gain == pytest.approx(0.5 / 0.3)
    assert m.gain_at == pytest.approx(np.pi / Ts)


def test_the_grid_begins_below_all_poles_and_ends_at_nyquist() -> None:
    plant = _plant(CASES["slow"])

    w = frequency_grid(_law(1.0), plant, Ts)

    assert w[0] < 0.002 / 50
    assert w[-1] == pytest.approx(np.pi / Ts)


def test_margins_of_draws_are_those_of_each_plant() -> None:
    plant = _plant(CASES["two lags"])
    several = [plant.rescale(k) for k in (0.5, 1.0, 1.3, 40.0)]
    law = _law(1.0)
    w = frequency_grid(law, plant, Ts)
    stable = are_stable(close_loop(law, several), 0)

    drawn = margins_of_draws(loop_response(law, several, np.exp(1j * w * Ts)), stable, w)

    assert [*drawn["stable"]] == [True, True, True, False]
    for k, one in enumerate(several[:3]):
        m = margins(law, one, Ts)
        for name in ("Ms", "gain", "phase_deg", "delay_s"):
            assert drawn[name][k] == pytest.approx(getattr(m, name), rel=1e-3)
    assert [drawn[name][3] for name in ("Ms", "phase_deg", "delay_s")] == [np.inf, 0, 0]


def test_a_rate_loop_is_stable_with_its_angle_at_exactly_1() -> None:
    """The angle is not fed back; a pole at 1 that is fed back makes a loop unstable."""
    arm = armrig.physics.arm(armrig.physics.ArmParameters())
    law = armrig.control.place(arm, [-18 + 18j, -18 - 18j, -42], rate=True, Ts=0.01)
    plant = design_model(arm, Ts=0.01).plant
    matrices = LawMatrices.of(law, ["theta_1", "alpha"])
    loop = close_loop(matrices, [plant])

    assert np.abs(loop.poles[0] - 1).min() < 1e-9
    assert margins(matrices, plant, 0.01).stable
    assert not are_stable(loop, 0)[0]


def test_a_law_that_sums_r_without_feedback_is_no_stable_loop() -> None:
    """Its pole at 1 is in the voltage, so it is no mode that a rate leaves alone."""
    zero, one = np.zeros(1), np.ones(1)
    law = LawMatrices(np.ones((1, 1)), one, zero, np.zeros((1, 1)), one, 0.0, 0, (0,))

    assert not margins(law, _plant(CASES["first order"]), Ts).stable
