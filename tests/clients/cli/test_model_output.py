"""Lines about a model: its numbers with their deviations, its tests, and what to act on."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import model_output
from armrig.cli.model_output import (
    advice_lines,
    coefficients,
    hint,
    lags_outside,
    model_facts,
    residual_lines,
    root_lines,
    short_model_lines,
    short_search_lines,
    to_act_on,
)
from armrig.data.finding import Finding, warning
from armrig.models.responses import Roots
from armrig.numerics.whiteness import Whiteness
from armrig.validation import answer as answers
from armrig.validation.answer import answer, simulated_to

NBSP = "\u00a0"


@pytest.fixture(scope="module")
def fit() -> Any:
    """Give an ARX model of a plant with a delay of three samples."""
    rng = np.random.default_rng(1)
    u, y = rng.standard_normal(300), np.zeros(300)
    for k in range(4, 300):
        y[k] = 1.2 * y[k - 1] - 0.6 * y[k - 2] + u[k - 3] - 2 * u[k - 4]
    y += 0.1 * rng.standard_normal(300)
    return armrig.arx(armrig.Dataset(u=u, y=y, Ts=0.5, unit="rad"), na=2, nb=2, nk=3)


def _white(p: float) -> Whiteness:
    return Whiteness(p_value=p, test="T")


def test_each_coefficient_has_its_power_of_the_delay_and_both_deviations(
    fit: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(fit), "summary", lambda _: SimpleNamespace(facts=dict))
    rows = [line.split() for line in coefficients(fit)[1:]]

    assert [row[:2] for row in rows] == [
        *(["a1", "q^-1"], ["a2", "q^-2"], ["b1", "q^-3"], ["b2", "q^-4"]),
    ]
    for row, value, std, robust in zip(rows, fit.theta, fit.std, fit.std_robust, strict=True):
        assert float(row[2]) == pytest.approx(value, abs=0.6 * std)
        assert row[3:] == [f"{std:.2g}", f"{robust:.2g}"]
    facts = model_facts(fit)
    assert facts["parameters"] == {
        name: {"value": value, "std": std, "std_robust": robust}
        for name, value, std, robust in zip(
            fit.names, fit.theta, fit.std, fit.std_robust, strict=True
        )
    }
    assert (facts["orders"], facts["Ts"], facts["N"]) == ({"na": 2, "nb": 2, "nk": 3}, 0.5, fit.N)
    names = ("noise_variance", "loss", "fpe", "aic", "mdl", "fit_percent")
    assert {name: facts[name] for name in names} == {name: getattr(fit, name) for name in names}
    assert facts["p_white"] == fit.whiteness


def test_a_short_model_has_the_deviation_that_applies(fit: Any) -> None:
    fit = replace(fit, covariance=np.eye(4) * 0.011**2, covariance_robust=np.eye(4) * 0.22**2)
    for p, which, std in ((0.001, "σ robust", "0.22"), (0.5, "σ", "0.011")):
        lines = short_model_lines(replace(fit, whiteness=p), roots=False)

        assert lines[1].endswith(f"; below, ± is {which}")
        a1, a2, b1, b2 = (
            f"{value:.{len(std) - 2}f}{NBSP}±{NBSP}{std}" for value in fit.theta.tolist()
        )
        assert lines[2:] == [f"  a1 …   {a1}, {a2}", f"  b1 …   {b1}, {b2}"]
    lines = short_model_lines(fit, roots=True)
    assert [line[:9] for line in lines[4:]] == ["  poles  ", "  zeros  "]


NONE = Roots(values=np.array([]), covariance=np.zeros((0, 2, 2)))
PAIR = np.diag([0.02, 0.003]) ** 2
ROOTS = Roots(
    values=np.array([0.5 + 0.25j, 0.5 - 0.25j, -0.75, 1.0]),
    covariance=np.array(
        [PAIR, PAIR, np.diag([0.04, 0.0]) ** 2, np.zeros((2, 2))],
    ),
)


def test_roots_are_shown_to_the_digits_of_the_least_deviation_and_a_pair_once() -> None:
    shown = model_output._roots(ROOTS).replace(NBSP, " ")
    of: Any = SimpleNamespace(poles=lambda: ROOTS, zeros=lambda: NONE)
    table = [line.split() for line in root_lines(of)[1:]]

    assert shown == "0.5000 ± 0.2500i (σ 0.02, 0.003), -0.750 ± 0.040, 1 (fixed)"
    assert table == [
        ["pole", "0.50000", "±", "0.25000i", "0.02", "0.003"],
        ["pole", "-0.75000", "0.04"],
        ["pole", "1.00000", "fixed"],
    ]
    assert model_output._roots(of.zeros()) == "none"


def _finding(about: str, level: Any = "warning") -> Finding:
    return Finding(level=level, about=about, text=f"text of {about}")


@pytest.mark.parametrize(
    ("doubts", "estimation", "advice", "lines", "acts"),
    [
        ("", "", "", [], ""),
        ("", "", "residuals", [], "residuals"),
        (
            "feedback",
            "",
            "feedback order",
            ["! feedback: text of feedback", "! order: text of order"],
            "feedback order",
        ),
        (
            "integrator",
            "",
            "level order",
            ["! integrator: text of integrator", "! order: text of order"],
            "integrator level order",
        ),
        ("", "level", "level order", ["! text of level", "! order: text of order"], "level order"),
        ("", "unstable", "integrator", ["! integrator: text of integrator"], "integrator"),
        ("", "unstable", "order", ["! text of unstable", "! order: text of order"], "order"),
        ("outliers", "outliers", "", ["! outliers: text of outliers"], "outliers"),
    ],
)
def test_each_finding_is_reported_once(
    doubts: str,
    estimation: str,
    advice: str,
    lines: list[str],
    acts: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    findings = [*map(_finding, advice.split()), _finding("delay", "good")]
    monkeypatch.setattr(model_output, "advice", lambda _: SimpleNamespace(findings=findings))
    of: Any = SimpleNamespace(findings=[warning(x, f"text of {x}") for x in estimation.split()])
    doubted = [_finding(about) for about in doubts.split()]

    assert advice_lines(of, doubted) == (lines or ["nothing to act on"])
    assert to_act_on(of, doubted) == set(acts.split())


def test_what_an_estimation_asks_for_is_acted_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_output, "advice", lambda _: SimpleNamespace(findings=[]))
    findings = [warning("not_converged", "x", "order"), warning("level", "x", "integrator")]
    of: Any = SimpleNamespace(findings=[*findings, warning("unstable", "x")])

    assert to_act_on(of, []) == {"order", "level"}


def _tests(**changes: Any) -> Any:
    of: dict[str, Any] = {"white": _white(0.4), "whiteness": 0.4, "on_estimation_data": False}
    of |= {"missing_dynamics": 0.3, "feedback": 0.2, "powerless": "", "e": np.array([1, np.nan])}
    of |= {"autocorrelation": np.array([1.0, 0.2, -0.2, 0.0]), "autocorrelation_band": 0.1}
    of |= {"cross_lags": np.arange(-2, 3), "cross_std": np.full(5, 0.1)}
    return SimpleNamespace(**of | {"cross_correlation": np.array([0, 0, 0.3, -0.3, 0])} | changes)


def test_the_tests_of_the_residuals_have_a_line_each() -> None:
    assert residual_lines(_tests()) == [
        "residuals on validation data, 1 samples; a p below 0.01 rejects",
        "  residuals white (p = 0.400, T)",
        "  no dynamics missing: p = 0.300",
        "  no feedback seen: p = 0.200",
    ]
    rejected = _tests(
        **{"white": _white(0.001), "missing_dynamics": np.nan, "feedback": 0.009},
        **{"powerless": "u rests", "on_estimation_data": True},
    )
    assert residual_lines(rejected) == [
        "residuals on estimation data, 1 samples; a p below 0.01 rejects",
        "  residuals coloured (p = 0.001, T): look at the noise model or the orders",
        "  no dynamics missing: too few samples or residuals for the test",
        "  no feedback seen: p = 0.009, rejected: look at the experiment, or the delay is too "
        "large",
        "  no power: u rests",
    ]


def test_lag_0_of_the_input_is_one_of_the_dynamics() -> None:
    """Outside are two of three lags of whiteness, two of three of the dynamics, and no other."""
    for changes, said in (
        ({}, "4 of 8 lags are outside"),
        ({"missing_dynamics": 0.001}, "2 of 5 lags are outside"),
        ({"whiteness": 0.001}, "2 of 5 lags are outside"),
        ({"feedback": 0.001}, "4 of 6 lags are outside"),
        ({"autocorrelation_band": 0.2, "missing_dynamics": 0.001}, ""),
    ):
        assert lags_outside(_tests(**changes))[: len(said) or 9] == said
    one = _tests(missing_dynamics=0.001, autocorrelation=np.array([1.0, 0.0, 0.0, 0.11]))
    assert lags_outside(one).startswith("1 of 5 lags is outside")


def test_an_answer_has_the_fits_and_the_deviation_to_trust() -> None:
    of: Any = SimpleNamespace(
        **{"heading": "ARX", "output": "alpha", "fit_percent": 91.239, "structure": "arx"},
        **{"whiteness": 0.4, "white": _white(0.4), "trusts_robust": False},
        trusts_coefficients=True,
        findings=(),
    )
    row: Any = SimpleNamespace(
        fit_percent=80.0, rms_error=0.01234, velocity_fit_percent=70.126, on_estimation_data=False
    )
    table: Any = type("Table", (list,), {"unit": "rad"})([row])

    alone = answer(of, None, None, [])
    validated = answer(of, table, _tests(), [])
    of.trusts_robust, of.white = True, _white(0.001)

    head = "ARX fits alpha to 91.24 % one step ahead; residuals white (p = 0.400, T): trust σ."
    assert alone.startswith(f"{head}\nA p below 0.01 rejects; --validate F2 tests the residuals")
    assert validated.startswith(
        f"{head}\nSimulated on the validation data it fits to 80.00 % (rms 0.01234 rad, velocity "
        "70.13 %).\nIts residuals pass: "
    )
    data_first = "trust σ robust, not σ; correct the data first"
    assert data_first in answer(of, None, None, [_finding("outliers")])
    of.findings = [_finding("level")]
    assert data_first in answer(of, None, None, [])
    of.findings = [_finding("gaps")]
    assert "trust σ robust, not σ; raise the orders" in answer(of, None, None, [])
    row.velocity_fit_percent = None
    assert simulated_to(row, "") == "80.00 % (rms 0.01234)"


@pytest.mark.parametrize(
    ("changes", "is_hinted"),
    [
        ({}, True),
        ({"integrator": True}, False),
        ({"structure": "arx"}, False),
        ({"output": "alpha"}, False),
    ],
)
def test_an_integrator_is_suggested_for_an_oe_model_of_the_angle_alone(
    changes: dict[str, Any], is_hinted: bool
) -> None:
    of: dict[str, Any] = {"structure": "oe", "output": "theta_1", "integrator": False}

    said = hint(SimpleNamespace(**of | changes))  # type: ignore[arg-type]

    assert said == ("the angle theta_1 integrates: try --integrator" if is_hinted else "")


def test_a_search_shows_five_models_and_two_more_reasons() -> None:
    found: Any = SimpleNamespace(table=lambda n: f"{n} models", reasons=list("abcde"))

    assert short_search_lines(found) == ["5 models", "- b", "- c"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "pass: white (p = 0.400, T), no dynamics missing (p = 0.300), no feedback seen (p"),
        (
            {"white": _white(0.001)},
            "do not pass: they are coloured (p = 0.001, T): look at the noi",
        ),
        ({"missing_dynamics": 0.001}, "do not pass: dynamics are missing (p = 0.001): look at the"),
        ({"feedback": 0.001}, "do not pass: there is feedback (p = 0.001): look at the experiment"),
        ({"feedback": 0.001, "missing_dynamics": 0.001}, "the test of feedback (p = 0.001) is not"),
        ({"powerless": "u is constant"}, "tests of its residuals have no power: u is constant"),
        ({"missing_dynamics": np.nan}, "Residuals white (p = 0.400, T); too few samples"),
    ],
)
def test_a_sentence_names_the_failed_tests_of_the_residuals(
    changes: dict[str, Any], said: str
) -> None:
    assert said in answers.tests_sentence(_tests(**changes))
