"""The verdict on a law: draws, corners, steps, and models that are refused or doubted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import armrig
import control
import numpy as np
import pytest
from armrig.control.loop import LawMatrices, margins
from armrig.control.plant import design_model
from armrig_core.errors import InputError
from armrig_core.rig.description import builtin

from tests.clients.control import plants

LAG = plants.model([0, 0.1], [1, -0.9])


def _estimated(*, N: int = 600, noise: float = 0.05, seed: int = 3) -> armrig.Fit:
    u = armrig.prbs(N, clock=4, low=0.0, high=4.0, seed=seed)
    y = LAG.simulate(u) + noise * np.random.default_rng(seed).standard_normal(N)
    return armrig.oe(armrig.Dataset(u=u, y=y, Ts=0.05, input_unit="V"), nb=1, nf=1)


@pytest.mark.exhaustive
def test_bands_over_draws_hold_the_margins_of_the_true_plant() -> None:
    """The true Ms and phase margin are in the 95 % bands of 60 estimates, each with its own law."""
    inside = np.zeros(2)
    true = design_model(LAG)

    for seed in range(60):
        fit = _estimated(seed=seed)
        law = armrig.control.pid(fit, time_constant=0.2)
        check = armrig.control.check_law(law, fit, draws=200)
        m = margins(LawMatrices.of(law, ["y"]), true.plant, 0.05)
        for i, name in enumerate(("Ms", "phase_deg")):
            low, high = check.band(name)
            inside[i] += low <= getattr(m, name) <= high

    assert (inside >= 52).all()  # below 52 of 60 with probability 0.006
    assert not (inside == 60).all()


def test_the_first_number_is_the_worst_of_draws_and_corners() -> None:
    calm, noisy = (_estimated(noise=noise) for noise in (0.05, 1.0))
    check = armrig.control.check_law(armrig.control.pid(calm, ms=1.4), calm)
    doubtful = armrig.control.check_law(armrig.control.pid(noisy, ms=1.4), noisy)

    corners = [m.Ms for m in check.corners.values()]
    assert check.worst_Ms == pytest.approx(max(corners))
    assert max(corners) > np.quantile(check.draws["Ms"], 0.975)
    quantile = np.quantile(doubtful.draws["Ms"], 0.975)
    assert replace(doubtful, corners={}).worst_Ms == pytest.approx(quantile, rel=5e-3)
    assert quantile > 1.01 * doubtful.nominal.Ms
    assert f"Ms at most {check.worst_Ms:.2f}" in check.verdict
    assert "0 % of 500 draws unstable" in check.verdict


def test_corners_are_the_margins_of_changed_plants() -> None:
    check = armrig.control.check_law(law := armrig.control.pid(LAG), LAG)
    changed = plants.model([0, 0.08], [1, -0.9]), plants.model([0, 0, 0.1], [1, -0.9])

    for name, model in zip(("gain -20 %", "one more sample of delay"), changed, strict=True):
        m = margins(LawMatrices.of(law, ["y"]), design_model(model).plant, 0.05)
        assert check.corners[name].Ms == pytest.approx(m.Ms, rel=1e-9)


def test_a_share_of_unstable_draws_is_reported() -> None:
    fit = _estimated(N=100, noise=1.0)
    check = armrig.control.check_law(armrig.control.pid(fit, ms=9.0), fit)

    assert 0 < check.unstable_share < 1
    assert f"{100 * check.unstable_share:.2g} % of 500 draws unstable" in check.verdict
    assert "ask for a slower loop" in check.verdict


def test_steps_have_the_overshoot_and_settling_of_a_direct_simulation() -> None:
    law = armrig.control.pid(LAG, ms=1.9, weight=1.0)
    check = armrig.control.check_law(law, LAG, height=1.0)
    y, _ = plants.simulate(law, LAG, np.ones(check.steps.t.size))

    outside = np.flatnonzero(np.abs(y[:, 0] - 1) > 0.05)
    assert check.steps.overshoot()[0] == pytest.approx(100 * (y.max() - 1))
    assert check.steps.overshoot()[0] > 3
    assert check.steps.settling()[0] == pytest.approx((outside[-1] + 1) * 0.05)


@pytest.mark.parametrize(
    ("design", "text"),
    [
        (lambda: armrig.control.pid(LAG, time_constant=0.05), "at least 0.1 s can be met"),
        (lambda: armrig.control.pid(LAG, ms=1.05), "at least 1.1 can be met"),
        (lambda: armrig.control.place(LAG, [-30]), "at most 10 rad/s can be met"),
        (lambda: armrig.control.place(LAG, [-3, -4]), "the model needs 1"),
        (lambda: armrig.control.place(LAG, [3]), "below 0"),
        (lambda: armrig.control.lqg(LAG, effort=0.0), "must be above 0"),
        (lambda: armrig.control.pid(plants.model([0, 0.1], [1, -1.1])), "unstable"),
        (lambda: armrig.control.pid(plants.model([0.1], [1, -0.9])), "nk=0"),
        (lambda: armrig.control.pid(plants.model([0, 0.1], [1, -1.0])), "integrator=True"),
        (lambda: armrig.control.pid(plants.model([0, 0.1], [1, -0.9], Ts=2.0)), "0.005 to 1 s"),
        (lambda: armrig.control.pid(LAG, Ts=0.1), "the model has 0.05 s"),
        (lambda: armrig.control.pid(LAG, rig=builtin("heater")), "a model of another rig"),
        (lambda: armrig.control.pid(LAG, output="z"), "the model has y"),
        (lambda: armrig.control.pid(plants.model([0, 0.1, -0.1], [1, -0.9])), "cannot follow r"),
        (
            lambda: armrig.control.lqg(
                armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
            ),
            "steady gain 2.4e-05",
        ),
        (lambda: armrig.control.pid(LAG, rate=True), "does not integrate"),
        (
            lambda: armrig.control.pid(
                armrig.Fit.of_channel(B=[0, 1], nk=1, Ts=1.0, input_unit="%")
            ),
            "rig='",
        ),
        (lambda: armrig.control.pid(control.tf([1.0], [1, 1])), "give Ts="),
        (lambda: armrig.control.pid(3.0), "give a Fit"),
        (
            lambda: armrig.control.lqg(
                plants.model([0, 0.1], [1, -1.0], integrator=True, output="level")
            ),
            "give reference=",
        ),
        (
            lambda: armrig.control.check_law(
                armrig.control.pid(LAG), plants.model([0, 0.1], [1, -0.9], Ts=0.1)
            ),
            "Ts",
        ),
        (
            lambda: armrig.control.check_law(
                armrig.control.pid(LAG), plants.model([0, 1], [1, -0.9], output="z")
            ),
            "the law uses y",
        ),
    ],
)
def test_a_design_that_no_law_meets_is_refused_with_what_would_be_met(
    design: Any, text: str
) -> None:
    with pytest.raises(armrig.ArmrigError) as refusal:
        design()

    assert text in str(refusal.value)


def test_with_a_dead_time_poles_that_cannot_dominate_are_refused() -> None:
    """A fast pole needs hardly any gain, and the slow pole of the plant would stay."""
    late = plants.model([0] * 16 + [0.1], [1, -0.9])

    with pytest.raises(InputError, match="rad/s can be met") as refusal:
        armrig.control.place(late, [-5])

    most = float(str(refusal.value).split("at most ")[1].split()[0])
    assert armrig.control.place(late, [-0.95 * most]).input_delay == 15


def test_draws_of_a_dead_time_may_cross_a_whole_sample() -> None:
    """A dead time near 15 samples is 14 or 15 whole samples and a part, with one state or two."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.choice([0.0, 4.0], 20), 60)
    late = plants.model([0] * 16 + [0.051], [1, -0.9943], Ts=1.0)
    y = late.simulate(u) + 0.1 * rng.standard_normal(u.size)
    fit = armrig.process(armrig.Dataset(u=u, y=y, Ts=1.0, input_unit="V"), "P1D")
    drawn = design_model(fit).draw(100)

    check = armrig.control.check_law(armrig.control.pid(fit, time_constant=40.0), fit, draws=100)

    assert {p.delay for p in drawn} == {14, 15}
    low, high = check.band("delay_s")
    assert low < check.nominal.delay_s < high
    y_direct, _ = plants.simulate(check.law, late, np.ones(400))
    found = np.interp(200.0, check.steps.t, check.steps.z[0]) / check.steps.height
    assert found == pytest.approx(y_direct[200, 0], abs=0.02)


def test_doubts_stand_in_the_first_line() -> None:
    fit, other = _estimated(), _estimated(seed=9)
    u = armrig.prbs(400, clock=4, low=0.0, high=4.0, seed=8)
    rng = np.random.default_rng(1)
    good = armrig.Dataset(
        u=u, y=LAG.simulate(u) + 0.05 * rng.standard_normal(400), Ts=0.05, input_unit="V"
    )
    bad = armrig.Dataset(
        u=u, y=2 * LAG.simulate(u) + 0.05 * rng.standard_normal(400), Ts=0.05, input_unit="V"
    )
    law = armrig.control.pid(fit)

    first = [
        armrig.control.check_law(law, model, validation=data, draws=20).verdict.splitlines()[0]
        for model, data in ((LAG, None), (fit, None), (fit, bad), (other, good))
    ]

    for line, text in zip(
        first,
        ("no covariance", "not validated", "reject the model", "designed on another model"),
        strict=True,
    ):
        assert line.startswith("In doubt: ")
        assert text in line
    verdict = armrig.control.check_law(law, fit, validation=good, draws=20).verdict
    assert verdict.startswith("Ms at most")
    assert len(verdict.splitlines()) == 2


def test_a_model_in_percent_commands_volts_at_the_pin_of_its_rig() -> None:
    """20 % are 1 V on the heater: gains and u0 of the law are those of the model in V."""
    heater, more = builtin("heater"), {"output": "T1", "unit": "degC", "Ts": 1.0, "input": "power"}
    percent = armrig.Fit.of_channel(B=[0, 0.01], F=[1, -0.98], nk=1, input_unit="%", **more)

    law = armrig.control.pid(percent, time_constant=20.0, rig=heater, u0=1.0, y0=33.0)
    check = armrig.control.check_law(law, percent, rig=heater)

    in_volts = armrig.Fit.of_channel(B=[0, 0.2], F=[1, -0.98], nk=1, input_unit="V", **more)
    same = armrig.control.pid(replace(in_volts, inputs=("u",)), time_constant=20.0, u0=1.0, y0=33.0)
    np.testing.assert_allclose(law.A, same.A)
    np.testing.assert_allclose(law.B, same.B)
    assert law.u0 == pytest.approx(1.0 - 33.0 / 10.0)  # 10 degC for 1 V
    assert law.reference.low == pytest.approx(23.0, abs=1.0)  # at 0 V
    assert law.reference.high == 70.0
    assert check.nominal.Ms == pytest.approx(law.design["margins"]["Ms"])
    law.check_rig(heater, 1_000_000, 0.0, 5.0)
