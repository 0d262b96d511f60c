"""Advice and residual tests made by hand: their words, and the numbers in them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.finding import Finding
from armrig.data.step import LINE, Step
from armrig.data.treatment.integrating import Integration
from armrig.models.characteristics import overlapping
from armrig.models.fit import Fit
from armrig.models.structure_table import STRUCTURES
from armrig.numerics.whiteness import Whiteness
from armrig.validation import advice
from armrig.validation.advice import Tested as OfData
from armrig.validation.feedback_and_delay.delay_result import Delay
from armrig.validation.feedback_and_delay.open_loop import CHANCE_LEVEL
from armrig.validation.residual_test import ResidualTest
from armrig.validation.residuals import _possible
from armrig_core.errors import InputError

from tests.clients.models.made_fits import made


def loop(**fields: Any) -> Any:
    """Return a test for feedback that finds it at p = 0.01."""
    values = {
        "feedback": True,
        "p_value": 0.01,
        "level": 0.05,
        "output": "alpha",
        "may_be_direct_term": False,
        "remarks": ("first", "second"),
        "laws": (),
    }
    values |= fields
    return SimpleNamespace(sure=values["p_value"] < CHANCE_LEVEL, **values)


def late(nk: int, interval: tuple[int, int] | None = None) -> Delay:
    found = object.__new__(Delay)
    values = {"nk": nk, "interval": interval or (nk, nk), "Ts": 0.02, "may_be_feedback": False}
    for name, value in values.items():
        object.__setattr__(found, name, value)
    return found


def known_of(**fields: Any) -> OfData:
    decided = Integration(integrates=False)
    values: dict[str, Any] = {"integration": decided, "loop": None, "late": late(1)}
    return OfData(**(values | fields))


def examined(data: Dataset, about: str) -> list[Finding]:
    """Return the findings about a subject, of data that integrate and have feedback."""
    known = known_of(integration=Integration(integrates=True), loop=loop(p_value=1e-4))
    return [f for f in advice.examine_experiment(data, known) if f.about == about]


def only(findings: Any) -> tuple[str, str, bool]:
    """Return the subject and the text of the only finding, and whether it is good."""
    [found] = findings
    return found.about, found.text, found.level == "good"


@pytest.mark.parametrize(
    ("fields", "said", "good"),
    [
        ({"feedback": None}, ["not tested: first; second"], True),
        ({"feedback": False, "p_value": 0.4}, ["none is found (p = 0.400)"], True),
        (
            {},
            ["as if u depends on alpha (p = 0.010)", "in 20 has p < 0.05", "ARMAX or BJ with nk"],
            False,
        ),
        ({"p_value": 0.001, "level": 0.1}, ["one open-loop recording in 10 has p < 0.1"], False),
        (
            {"p_value": 0.0009, "may_be_direct_term": True},
            ["or record in open loop; first; second"],
            False,
        ),
    ],
)
def test_feedback_is_advised_on_by_its_p_value(
    fields: dict[str, Any], said: list[str], good: bool
) -> None:
    test = loop(**fields)

    about, text, is_good = only(advice.about_feedback(known_of(loop=test)))

    assert (about, is_good) == ("feedback", good)
    assert all(words in text for words in said)
    assert ("By chance" in text) == (not good and test.p_value >= 1e-3)
    assert [*advice.about_feedback(known_of())] == []


@pytest.mark.parametrize(
    ("p", "direct", "together", "closed"),
    [(0.001, False, False, False), (0.0009, False, True, True), (0.0009, True, True, False)],
)
def test_data_are_of_a_closed_loop_if_no_direct_term_can_be_the_cause(
    p: float, direct: bool, together: bool, closed: bool
) -> None:
    known = known_of(loop=loop(p_value=p, may_be_direct_term=direct))

    assert (known.together, known.closed) == (together, closed)
    assert (known_of().together, known_of().closed) == (False, False)


def telegraph(N: int = 600) -> Any:
    return np.random.default_rng(1).choice([-1.0, 1.0], N)


@pytest.mark.parametrize(
    ("nk", "doubted"), [(1, True), (2, False), (3, False), (4, False), (5, True)]
)
def test_a_model_may_begin_at_each_lag_that_is_not_ruled_out(
    nk: int, doubted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit = made(B=[0.0] * nk + [1.0], F=(1, -0.5), nk=nk)
    data = Dataset(u=telegraph(), y=telegraph(), Ts=0.02)

    known = known_of(late=late(3, (2, 4)))
    monkeypatch.setattr(advice, "preliminary_tests", lambda *_: known)

    found = [*advice.examine_fit_of(data, fit)]

    text = f"u acts from lag 3 on, and the model begins at lag {nk}: use nk=3"
    assert [(f.about, f.text) for f in found] == ([("delay", text)] if doubted else [])


@pytest.mark.parametrize(("missing", "good"), [(119, True), (120, False), (6, True)])
def test_a_fifth_of_the_samples_may_be_missing(missing: int, good: bool) -> None:
    data = Dataset(u=np.zeros(600), y=np.zeros(600), Ts=1.0, valid=np.arange(600) >= missing)

    about, text, is_good = only(examined(data, "missing"))

    assert (about, is_good) == ("missing", good)
    assert text.startswith(f"{100 * missing / 600:.3g}".rstrip("0").rstrip(".")[:2])
    assert "of the samples: no estimator replaces them by a value" in text


def test_a_line_removed_from_an_angle_that_integrates_is_a_fault() -> None:
    values: dict[str, Any] = {"u": telegraph(), "y": telegraph(), "Ts": 1.0}
    line = (Step("removed a straight line", LINE),)

    found = [
        examined(Dataset(output=name, history=history, **values), "trend")
        for name, history in (("theta_1", line), ("alpha", line), ("theta_1", ()))
    ]

    assert [len(f) for f in found] == [1, 0, 0]
    assert (found[0][0].about, found[0][0].level) == ("trend", "warning")


def exciting(order: int) -> Dataset:
    """Return data whose input is exciting of this order: two for each sine, one at Nyquist."""
    t, lines = np.arange(600), 0.4 * np.arange(1, order // 2 + 1)
    u = np.cos(np.outer(t, lines) + lines**2).sum(axis=1) + order % 2 * (-1.0) ** t
    return Dataset(u=u, y=telegraph(), Ts=1.0)


@pytest.mark.parametrize(("order", "good"), [(8, True), (7, False)])
def test_eight_parameters_need_an_excitation_of_order_eight(order: int, good: bool) -> None:
    about, text, is_good = only([advice._about_input(exciting(order))])

    assert (about, is_good) == ("excitation", good)
    said = "order 8 at least: enough for 8 parameters" if good else "order 7 only, and a model of"
    assert f"u is exciting of {said}" in text


@pytest.mark.parametrize(
    ("fit", "needed"),
    [(made(F=(1, -0.5, 0.1)), 3), (made(A=(1, -0.5, 0.1), B=(0, 1, 1)), 4)],
    ids=["B and F", "B and A"],
)
def test_a_model_needs_an_excitation_of_as_many_orders_as_parameters(
    fit: Fit, needed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(advice, "preliminary_tests", lambda *_: known_of())

    poor, enough = (
        [*advice.examine_fit_of(exciting(order), fit)] for order in (needed - 1, needed)
    )

    assert enough == []
    assert f"order {needed - 1} only, and {needed} parameters of the model" in only(poor)[1]


@pytest.mark.parametrize(
    ("zero", "pole", "near"),
    [(0.9999, 0.998, True), (0.9899, 0.992, False), (0.992, 0.9899, False)],
)
def test_a_pole_zero_pair_near_1_is_a_level_and_does_not_count_as_an_order(
    zero: float, pole: float, near: bool
) -> None:
    fit = made(B=(0, 1, -zero), F=(1, -pole), std=(0.1, 0.1, 0.1), structure="oe")

    pairs = overlapping(fit)
    far, at_one = ([p for p in pairs if advice._at_one(p) == near] for near in (False, True))

    assert (len(far), len(at_one)) == (int(not near), int(near))
    levels = [*advice._about_pair_at_one(fit, at_one)]
    said = f"pole {pole:.3f} and zero {zero:.3f} cancel: they model a constant of alpha"
    assert [f.text.startswith(said) for f in levels] == [True] * near
    assert [f.remedy for f in levels] == ["level"] * near


def test_the_orders_are_too_high_by_the_cancelling_poles() -> None:
    """A complex pole counts twice."""
    pairs = [(0.5 + 0.1j, 0.5 + 0.1j, 0.9), (0.2 + 0j, 0.2 + 0j, 0.9)]

    cancelled = advice._about_overlap(pairs, STRUCTURES["oe"])

    assert (cancelled.remedy, cancelled.numbers) == ("order", {"poles": 3})


@pytest.mark.parametrize(("b", "doubted"), [(0.0257, True), (-0.0257, True), (0.026, False)])
def test_a_first_coefficient_within_its_robust_deviation_may_be_a_delay(
    b: float, doubted: bool
) -> None:
    """The robust deviation is 0.01."""
    fit = made(A=(1, -0.5), B=(0, b, 1), std=(0.1, 0.005, 0.1))

    found = [*advice._about_first_coefficient(fit)]

    said = f"b1 = {b:.2g} ± 0.01 does not differ"
    assert [(f.text.startswith(said), f.remedy) for f in found] == [(True, "")] * doubted
    assert [*advice._about_first_coefficient(made(B=(0, b, 1)))] == []


@pytest.mark.parametrize(
    ("allowance", "own", "powerless"),
    [(10.0, False, False), (10.1, False, True), (1e6, True, False), (float("nan"), False, False)],
)
def test_bands_ten_times_as_wide_have_no_power(
    allowance: float, own: bool, powerless: bool
) -> None:
    said = signals_test(allowance=allowance, on_estimation_data=own).powerless

    assert bool(said) is powerless
    assert not said or "correlations by a factor of 10, so these tests find nothing" in said


@pytest.mark.parametrize(("L", "N", "longest"), [(6, 10, 5), (0, 10, 5), (2, 1, 1), (6, 11, 5)])
def test_at_most_half_of_the_residuals_are_lags(L: int, N: int, longest: int) -> None:
    with pytest.raises(InputError, match=f"lags={L} must be 1 to {longest}, half of the {N} res"):
        _possible(L, N)
    assert _possible(longest, N) == longest


def signals_test(**fields: Any) -> ResidualTest:
    """Return a test of two outputs and three inputs, made up."""
    rng = np.random.default_rng(5)
    e = rng.standard_normal((50, 2))
    e[:5, 1] = np.nan
    values: dict[str, Any] = {
        "outputs": ("a", "b"),
        "inputs": ("u", "v", "w"),
        "e": e,
        "lags": np.arange(4),
        "autocorrelation": rng.standard_normal((2, 2, 4)),
        "autocorrelation_band": np.array([0.36, 0.38]),
        "ljung_box": np.array([0.3, 0.7]),
        "white_by_output": (
            Whiteness(p_value=0.25, test="portmanteau"),
            Whiteness(p_value=0.75, test="Ljung-Box"),
        ),
        "white": Whiteness(p_value=0.5, test="portmanteau"),
        "cross_lags": np.arange(-3, 4),
        "cross_correlation": rng.standard_normal((2, 3, 7)),
        "cross_band": np.full((2, 3), 0.4),
        "cross_std": rng.uniform(0.1, 1.0, (2, 3, 7)),
        "missing_dynamics_by_pair": np.array([[0.5, np.nan, 0.3], [0.2, 0.1, 0.0017]]),
        "feedback_by_pair": np.array([[0.6, 0.7, 0.0016], [0.8, 0.9, 0.95]]),
        "missing_dynamics": 0.25,
        "feedback": 0.0012,
        "allowance": 1.5,
        "error_ratio": 1.0,
        "larger_errors": 0.5,
        "noise_of_estimation": True,
        "on_estimation_data": False,
        "source": "",
    }
    return ResidualTest(**(values | fields))


def test_the_poorest_pair_has_the_least_p_value_of_those_tested() -> None:
    untested_first = np.array([[np.nan, 0.5, 0.5], [0.5, 0.2, 0.5]])

    assert signals_test().poorest_pair == ("b", "w")
    assert signals_test(missing_dynamics_by_pair=np.full((2, 3), np.nan)).poorest_pair == ("a", "u")
    assert signals_test(missing_dynamics_by_pair=untested_first).poorest_pair == ("b", "v")


@pytest.mark.parametrize(
    ("white", "dynamics", "feedback", "rejects"),
    [
        (0.01, 0.01, 0.01, False),
        (0.009, 0.5, 0.5, True),
        (0.5, 0.009, 0.5, True),
        (0.5, 0.5, 0.009, True),
        (float("nan"), float("nan"), float("nan"), False),
    ],
)
def test_a_model_is_rejected_by_any_joint_test_below_1_percent(
    white: float, dynamics: float, feedback: float, rejects: bool
) -> None:
    test = signals_test(
        white=Whiteness(p_value=white, test="x"), missing_dynamics=dynamics, feedback=feedback
    )

    assert test.rejects is rejects
