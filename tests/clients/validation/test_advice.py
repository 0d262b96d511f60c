"""Advice in words, and silence about good models."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset, Signals
from armrig.data.finding import warning
from armrig.data.treatment.integrating import integration
from armrig.models.estimate import Minimisation
from armrig.models.structure_table import STRUCTURES
from armrig.numerics.polynomial import apply_filter
from armrig.validation.advice import Advice, _about_negative_poles, _about_pole_at_1, examine_fit_of
from armrig.validation.answer import answer

from tests.clients.validation.plants import (
    oe_of_two_outputs,
    of_second_order,
    switched,
    two_outputs,
    under_control,
)
from tests.sampling import sampled

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant


def clipped(data: Dataset) -> Dataset:
    """Return data with a converter's rail at the 80 % quantile of y."""
    return Dataset(u=data.u, y=np.minimum(data.y, np.quantile(data.y, 0.8)), Ts=data.Ts)


def told(found: Advice) -> set[str]:
    return {f.about for f in found.findings if f.level != "good"}


def remedies(found: Advice) -> set[str]:
    return {f.remedy for f in found.findings}


def test_good_data_cause_no_advice(plant: HandoutPlant) -> None:
    assert told(armrig.advice(plant.dataset(1))) == set()


@pytest.mark.parametrize("Ts", sampled([0.5, 7.0, 3600.0]))
def test_slow_and_fast_data_cause_the_same_advice(Ts: float) -> None:
    """One sample per hour."""
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], 400)
    y = np.convolve(u, [0, 0.5, 0.3, 0.1])[:400] + 0.1 * rng.standard_normal(400)

    found = armrig.advice(Dataset(u=u, y=y, Ts=Ts))

    fast = armrig.advice(Dataset(u=u, y=y, Ts=1.0))
    judged = [[(f.about, f.level) for f in advised.findings] for advised in (found, fast)]
    assert judged[0] == judged[1]
    assert told(found) == set()


def test_a_drift_of_an_output_that_does_not_integrate_is_reported() -> None:
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], 2000)
    y = np.convolve(u, [0, 0.5, 0.3])[:2000] + 1e-3 * np.arange(2000)
    y += 0.1 * rng.standard_normal(2000)
    said = armrig.advice(Dataset(u=u, y=y, Ts=1.0))

    assert "drift" in told(said)
    assert "detrend" in repr(said)


def test_the_right_model_causes_no_advice(plant: HandoutPlant) -> None:
    fit = armrig.oe(plant.dataset(1), nb=4, nf=4, integrator=True, starts="few")

    assert told(armrig.advice(fit)) == set()


def test_an_arx_model_of_the_angle_gets_advice_on_each_fault(plant: HandoutPlant) -> None:
    found = armrig.advice(armrig.arx(plant.dataset(1), na=4, nb=4))

    assert {"residuals", "poles", "integrator"} <= told(found)
    assert {"search", "order", "structure"} <= remedies(found)


def test_an_argument_that_is_neither_data_nor_a_model_is_refused() -> None:
    with pytest.raises(TypeError, match=r"data is a str: give a Dataset"):
        armrig.advice("run.mcap")  # type: ignore[arg-type]


def test_a_single_fault_of_data_is_the_only_finding() -> None:
    wrong = of_second_order(switched())
    y = wrong.y.copy()
    y[[100, 400, 900]] += 5.0
    cases = {
        "level": of_second_order(switched(), level=5.0),
        "outliers": wrong.replaced(y=y, step=None),
        "feedback": under_control(),
    }

    for about, data in cases.items():
        found = armrig.advice(data)
        assert told(found) == {about}
        assert remedies(found) == {"", "check" if about == "feedback" else about}


def test_a_sine_determines_neither_orders_nor_a_delay() -> None:
    data = of_second_order(np.sin(0.3 * np.arange(1500)))

    assert told(armrig.advice(data)) == {"excitation", "delay"}


def test_an_output_without_a_response_is_reported() -> None:
    data = Dataset(u=switched(), y=np.random.default_rng(1).standard_normal(1500), Ts=0.02)

    found = armrig.advice(data)

    assert told(found) == {"delay"}
    assert "shows no response to u" in repr(found)


def test_white_residuals_of_a_fit_that_explains_nothing_are_no_praise() -> None:
    u, y = np.random.default_rng(4).standard_normal((2, 500))
    data = armrig.Dataset(u=u, y=y + 0.05 * u, Ts=1.0)

    fit = armrig.arx(data, na=1, nb=1)

    said = answer(fit, None, None, ())
    assert "explains hardly anything of y" in said
    assert "trust" not in said
    assert "residuals" in told(armrig.advice(fit))


def test_a_pole_and_a_zero_at_one_are_reported_as_a_level() -> None:
    """Such a model is the answer to an offset, not an integrator or too high an order."""
    fit = armrig.oe(of_second_order(switched(), level=5.0), nb=3, nf=3, starts="few")

    assert "level" in told(armrig.advice(fit))
    assert not {"integrator", "order"} & told(armrig.advice(fit))


@pytest.mark.parametrize(
    ("data", "about", "words", "remedy"),
    [
        (
            of_second_order(np.sin(0.3 * np.arange(1500))),
            *("excitation", "4 parameters of the model", ""),
        ),
        (of_second_order(switched(), nk=4), "delay", "nk=4", "nk"),
        (under_control(), "feedback", "u depends on y", "check"),
        (clipped(of_second_order(switched())), "rails", "mark them missing", "rails"),
    ],
    ids=["sine", "delay", "feedback", "rails"],
)
def test_the_advice_compares_a_model_with_its_data(
    data: Dataset, about: str, words: str, remedy: str
) -> None:
    fit = armrig.oe(data, nb=2, nf=2, starts="few")

    found = {f.about: f for f in examine_fit_of(data, fit)}[about]

    assert words in found.text
    assert found.remedy == remedy


def test_a_good_model_of_good_data_causes_no_warning() -> None:
    """Only data that integrate raise the question of the pole at 1, also of a doubtful model."""
    data = of_second_order(switched())
    fit = armrig.oe(data, nb=2, nf=2, starts="few")

    ended = replace(fit, search=Minimisation(converged=False))
    assert not [*examine_fit_of(data, fit), *examine_fit_of(data, ended)]


@pytest.mark.parametrize(
    ("pole", "std", "said"),
    [
        (1.00014, 1e-4, "pole 1.00014 ± 0.00010 is 1 within its accuracy: fix it"),
        (0.99903, 1e-4, "theta_1 integrates, and no pole of the model is 1: fix it"),
        (1 - 1e-7, 2.9e-8, "theta_1 integrates, and no pole of the model is 1: fix it"),
        (0.95, 0.03, "theta_1 integrates, and no pole of the model is 1: fix it"),
    ],
)
def test_a_pole_that_differs_from_1_is_not_called_1(pole: float, std: float, said: str) -> None:
    """The pole differs by more than 2.58 of its deviations, or its interval is wide."""
    poles = SimpleNamespace(values=np.array([pole], complex), std=np.array([std]))
    of = {"integrator": False, "output": "theta_1", "structure": "oe", "N": 1000}
    fit: Any = SimpleNamespace(poles=lambda: poles, **of)

    [found] = _about_pole_at_1(fit, STRUCTURES["oe"])

    assert found.text.startswith(said)
    assert found.remedy == "integrator"


@pytest.mark.parametrize(("pole", "std"), [(0.857, 0.069), (0.9998971, 3.8e-6)])
def test_neither_a_wide_interval_nor_a_slow_pole_is_an_integrator(pole: float, std: float) -> None:
    poles = SimpleNamespace(values=np.array([pole], complex), std=np.array([std]))
    of = {"integrator": False, "output": "y", "structure": "oe", "N": 4000}
    fit: Any = SimpleNamespace(poles=lambda: poles, **of)

    assert not [*_about_pole_at_1(fit, STRUCTURES["oe"])]


def test_a_real_negative_pole_is_impossible_for_the_rig() -> None:
    for poles, told in (([0.6 + 0.7j, 0.6 - 0.7j, 1.0005], []), ([-0.5], ["order"])):
        found = SimpleNamespace(values=np.array(poles, complex), std=np.full(len(poles), 1e-4))
        fit: Any = SimpleNamespace(poles=lambda found=found: found)

        assert [f.remedy for f in _about_negative_poles(fit)] == told


def test_a_name_with_a_colon_is_complete_in_the_text() -> None:
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], 600)
    y = np.cumsum(u + 0.1 * rng.standard_normal(600))

    found = armrig.advice(Dataset(u=u, y=y, Ts=0.1, output="lift: left"))

    [text] = [f.text for f in found.findings if f.about == "integrator"]
    assert text.startswith("lift: left behaves as an integrating output")


def test_the_advice_reports_what_the_estimation_found_and_says_it_once() -> None:
    """The advice on a level or an integrator does not repeat a finding of the estimation."""
    u = switched()
    integrating = Dataset(u=u, y=np.cumsum(u) + of_second_order(u).y, Ts=0.1)
    level = armrig.oe(of_second_order(u, level=5.0), nb=3, nf=3, starts="few")
    at_1 = armrig.arx(integrating, na=1, nb=1)
    own = warning("level", "text"), warning("poor_fit", "more")
    poles = (warning(about, f"pole {about}") for about in ("integrator", "unstable"))

    of_level = repr(armrig.advice(replace(level, findings=own)))
    of_poles = repr(armrig.advice(replace(at_1, findings=tuple(poles))))

    assert "they model a constant" not in of_level
    assert all(text in of_level for text in ("level ", "text", "! poor fit ", "more"))
    assert "is 1 within its accuracy" not in of_poles
    assert "pole integrator\n" in of_poles
    assert "pole unstable\n" in of_poles


def test_each_channel_of_several_signals_has_advice() -> None:
    of_data: Any = armrig.advice(two_outputs(0))
    of_fit: Any = armrig.advice(oe_of_two_outputs(0))

    assert [*of_data] == [*of_fit] == [(y, u) for y in ("y1", "y2") for u in ("u1", "u2")]
    assert "u depends on y1" in of_data["y1", "u1"].warnings[0]
    assert of_fit["y1", "u2"].of == "OE[1 1 2] of y1"
    assert [f.text for f in of_fit["y1", "u2"].findings if f.about == "search"] == ["one minimum"]


@pytest.mark.parametrize(("nf", "superfluous"), [(2, 0), (3, 2)])
def test_a_pole_that_another_channel_needs_is_not_superfluous(nf: int, superfluous: int) -> None:
    """Each pole is cancelled in one of two outputs: both are needed, and a third pole is not."""
    rng = np.random.default_rng(4)
    u = rng.choice([-1.0, 1.0], 1000)
    clean = np.column_stack([apply_filter([0, 1.0], [1, -pole], u) for pole in (0.9, 0.4)])
    signals = armrig.Signals(u=u, y=clean + 0.1 * rng.standard_normal(clean.shape), Ts=0.1)
    fit = armrig.oe(signals, nb=nf, nf=nf, shared="denominator")

    found: Any = armrig.advice(fit)

    cancelled = [name for name in found if told(found[name]) & {"order", "level"}]
    assert len(cancelled) == superfluous


def test_pulses_of_another_input_are_no_outliers() -> None:
    rng = np.random.default_rng(2)
    u = np.column_stack([rng.standard_normal(1000), np.zeros(1000)])
    u[rng.choice(1000, 12, replace=False), 1] = 1.0
    y = apply_filter([0, 1.0], [1, -0.7], u[:, 0]) + apply_filter([0, 2.0], [1.0], u[:, 1])
    y += 0.1 * rng.standard_normal(1000)
    data = Signals(u=u, y=y[:, None], Ts=0.1, inputs=["u1", "u2"])

    found: Any = armrig.advice(data)

    assert "outliers" in told(armrig.advice(data.dataset("y", "u1")))
    assert "outliers" not in told(found["y", "u1"])


def slow_heaters() -> Signals:
    """Return the temperature between two heaters; its time constant is a fifth of the record."""
    rng, pole = np.random.default_rng([87, 14]), np.exp(-1 / 175)
    q = np.column_stack([np.repeat(rng.choice([0.0, 40.0, 80.0], 10), 90) for _ in range(2)])
    T = apply_filter(np.append(np.zeros(16), 0.9 * (1 - pole)), [1, -pole], q @ [1.0, 0.3])
    T += 22 + 0.1 * rng.standard_normal(900)
    return Signals(u=q, y=T[:, None], Ts=1.0, inputs=["Q1", "Q2"], outputs=["T1"])


def test_a_slow_output_that_another_input_moves_is_not_called_integrating() -> None:
    data = slow_heaters()

    alone = integration(data.dataset("T1", "Q1"), None)
    hints: Any = armrig.structure_hints(data)
    findings: Any = armrig.advice(data)

    assert alone.undecided
    assert not alone.integrates
    for found in (hints["T1", "Q1"], findings["T1", "Q1"]):
        assert "without Q2, y would seem to integrate" in found.explain()


def test_an_output_that_integrates_one_of_two_inputs_keeps_its_integrator() -> None:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], (80, 2)), 10, axis=0)
    y = apply_filter([0, 0.1], [1, -1], u[:, 0]) + apply_filter([0, 0.5], [1, -0.5], u[:, 1])
    y += 0.05 * rng.standard_normal(800)
    data = Signals(u=u, y=y[:, None], Ts=0.1, inputs=["u1", "u2"])

    decided = [integration(data.dataset("y", name), None, data) for name in data.inputs]

    assert [one.integrates for one in decided] == [True, False]
