"""Lines about a model: its numbers with their deviations, its tests, and what to act on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.cli import model_output
from armrig.data.finding import Finding
from armrig.numerics.whiteness import Whiteness
from armrig.validation import answer as answers
from armrig.validation.answer import answer, simulation
from armrig.validation.residual_test import ResidualTest


def _white(p: float) -> Whiteness:
    return Whiteness(p_value=p, test="T")


def _finding(about: str, level: Any = "warning") -> Finding:
    return Finding(level=level, about=about, text=f"text of {about}")


@pytest.fixture
def advised(monkeypatch: pytest.MonkeyPatch) -> list[Finding]:
    """Give the findings of the advice, which a test may extend."""
    findings: list[Finding] = []
    monkeypatch.setattr(model_output, "advice", lambda _: SimpleNamespace(findings=findings))
    return findings


@pytest.mark.parametrize(
    ("doubts", "advice", "said"),
    [
        ("", "", "nothing"),
        ("", "residuals", "nothing else"),
        ("feedback", "feedback order", "feedback order"),
        ("integrator", "level order", "integrator order"),
        ("", "level poor_fit", "level poor_fit"),
    ],
)
def test_each_finding_is_reported_once(
    doubts: str, advice: str, said: str, advised: list[Finding]
) -> None:
    advised += [*map(_finding, advice.split()), _finding("delay", "good")]
    fit: Any = None
    doubted = [_finding(about) for about in doubts.split()]

    lines = [f"! {x.replace('_', ' ')}: text of {x}" for x in said.split()]
    lines = [f"{said} to act on"] if said.startswith("nothing") else lines
    assert model_output.advice_lines(fit, doubted) == lines


def _tests(**changes: Any) -> Any:
    of: dict[str, Any] = {"white": _white(0.4), "on_estimation_data": False}
    of |= {"missing_dynamics": 0.3, "feedback": 0.2, "e": np.array([1, np.nan])}
    of |= {"powerless": "", "blind": "", "larger": "", "laws": ()}
    of |= {"autocorrelation": np.array([1.0, 0.2, -0.2, 0.0]), "autocorrelation_band": 0.1}
    of |= {"cross_lags": np.arange(-2, 3), "cross_std": np.full(5, 0.1), "outputs": ("y",)}
    of |= {"missing_dynamics_by_pair": np.full((1, 1), 0.3), "white_by_output": (_white(0.4),)}
    return SimpleNamespace(**of | {"cross_correlation": np.array([0, 0, 0.3, -0.3, 0])} | changes)


P = np.array([[0.5, 0.004, 0.0005], [0.02, 1.0, np.nan]])
"""p values of two outputs and three inputs; 0.01 / 6 is 0.0017."""


def _pairs(**changes: Any) -> Any:
    of = {"outputs": ("y", "z"), "inputs": ("u", "v", "w"), "missing_dynamics_by_pair": P}
    of |= {"feedback_by_pair": P[::-1], "missing_dynamics": 0.5, "feedback": 0.5, "laws": ()}
    return SimpleNamespace(**of | changes)


def test_a_pair_fails_its_test_at_the_level_of_all_pairs_together() -> None:
    brief = list(ResidualTest.pair_lines(_pairs()))
    every = list(ResidualTest.pair_lines(_pairs(), every=True))
    missing = list(ResidualTest.pair_lines(_pairs(missing_dynamics=0.009), every=True))

    untested = "not tested, because u is constant or the samples are few"
    assert brief == [
        "  w to y: dynamics missing (p < 0.001)",
        "  w to z: feedback, or a delay too large (p < 0.001)",
    ]
    assert every[:6] == [
        "  u to y: no dynamics missing (p = 0.500)",
        "  v to y: no dynamics missing (p = 0.004)",
        "  w to y: dynamics missing (p < 0.001)",
        "  u to z: no dynamics missing (p = 0.020)",
        "  v to z: no dynamics missing (p = 1.000)",
        f"  w to z: dynamics missing: {untested}",
    ]
    assert every[6:9] == [
        "  u to y: no feedback (p = 0.020)",
        "  v to y: no feedback (p = 1.000)",
        f"  w to y: feedback: {untested}",
    ]
    assert (len(every), missing) == (12, every[:6])


def test_the_tests_of_each_pair_are_in_json_with_its_names() -> None:
    white = [_white(p) for p in (0.3, 0.2, 0.1)]
    tests = _pairs(
        **{"white_by_output": white[1:], "missing_dynamics": 0.4, "powerless": "", "blind": ""},
        **{"error_ratio": 1.0, "larger_errors": 0.5, "white": _white(0.3)},
    )
    rows: Any = [
        SimpleNamespace(output=name, fit_percent=p, rms_error=1 - p, velocity_fit_percent=None,
                        on_estimation_data=False)
        for name, p in (("y", 0.75), ("z", 0.5))
    ]  # fmt: skip
    data: Any = SimpleNamespace(source="csv:12")

    facts = model_output.residual_facts(data, rows, tests)

    assert (facts["outputs"], facts["fit_percent"]) == (["y", "z"], [0.75, 0.5])
    assert (facts["rms_error"], facts["velocity_fit_percent"]) == ([0.25, 0.5], [None, None])
    assert (facts["p_white"], facts["p_no_dynamics_missing"], facts["p_no_feedback"]) == (
        *(0.3, 0.4, 0.5),
    )
    assert facts["p_white_by_output"] == [0.2, 0.1]
    assert [(of["output"], of["input"]) for of in facts["channels"]] == [
        (output, input) for output in "yz" for input in "uvw"
    ]
    assert facts["channels"][2]["p_no_dynamics_missing"] == 0.0005
    assert facts["channels"][5]["p_no_feedback"] == 0.0005


def test_lag_0_of_the_input_counts_among_the_dynamics() -> None:
    """Outside are two of three lags of whiteness, two of three of the dynamics, and no other."""
    for changes, said in (
        ({}, "4 of 8 lags are outside"),
        ({"missing_dynamics": 0.001}, "2 of 5 lags are outside"),
        ({"white": _white(0.001)}, "2 of 5 lags are outside"),
        ({"feedback": 0.001}, "4 of 6 lags are outside"),
        ({"autocorrelation_band": 0.2, "missing_dynamics": 0.001}, ""),
    ):
        assert model_output.lags_outside(_tests(**changes))[: len(said) or 9] == said
    one = _tests(missing_dynamics=0.001, autocorrelation=np.array([1.0, 0.0, 0.0, 0.11]))
    assert model_output.lags_outside(one).startswith("1 of 5 lags is outside")


def test_the_output_has_the_fits_and_the_trustworthy_deviation() -> None:
    quality = SimpleNamespace(fit_percent=91.239, white=_white(0.4))
    of: Any = SimpleNamespace(
        **{"heading": "ARX", "outputs": ("alpha",), "ny": 1, "structure": "arx"},
        **{"quality": (quality,), "trusts_robust": False},
        trusts_coefficients=True,
        findings=(),
        history=(),
    )
    row: Any = SimpleNamespace(
        output="alpha",
        fit_percent=80.0,
        rms_error=0.01234,
        unit="rad",
        velocity_fit_percent=70.126,
        on_estimation_data=False,
    )
    table: Any = SimpleNamespace(rows=[row])

    alone = answer(of, None, None, [])
    validated = answer(of, table, _tests(), [])
    of.trusts_robust, quality.white = True, _white(0.001)

    head = "ARX fits alpha to 91.24 % one step ahead; residuals white (p = 0.400, T): trust σ."
    assert alone.startswith(f"{head}\nA p below 0.01 rejects; --validate F2 tests the residuals")
    assert validated.startswith(
        f"{head}\nSimulated on the validation data it fits alpha to 80.00 % (rms 0.01234 rad, "
        "velocity 70.13 %).\nIts residuals pass: "
    )
    data_first = "trust σ robust, not σ; correct the data first"
    assert data_first in answer(of, None, None, [_finding("outliers")])
    assert "; record 300 samples or more first." in answer(of, None, None, [_finding("samples")])
    first, *_ = answer(of, None, None, [_finding("feedback")]).splitlines()
    assert first.endswith(". But the data show feedback, or a direct term: see below.")
    of.findings = [_finding("level")]
    assert data_first in answer(of, None, None, [])
    of.findings = [_finding("gaps")]
    assert "trust σ robust, not σ; raise the orders" in answer(of, None, None, [])
    row.velocity_fit_percent, row.unit = None, ""
    assert simulation([row]) == "alpha to 80.00 % (rms 0.01234)"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "pass: white (p = 0.400, T), no dynamics missing (p = 0.300), no feedback (p"),
        ({"white": _white(0.001)}, "do not pass: coloured (p = 0.001, T): look at the noise model"),
        ({"missing_dynamics": 0.001}, "do not pass: dynamics missing (p = 0.001): look at the ord"),
        ({"feedback": 0.001}, "do not pass: feedback, or a delay too large (p = 0.001): look at"),
        ({"feedback": 0.001, "missing_dynamics": 0.001}, "the test of feedback (p = 0.001) is not"),
        ({"larger": "errors grow"}, "do not pass: errors grow; passed: white (p = 0.400, T), no"),
        ({"powerless": "u is constant"}, "tests of its residuals have no power: u is constant"),
        ({"missing_dynamics": np.nan}, "residuals pass: dynamics missing: not tested, because u"),
        (
            {"white": _white(np.nan)},
            "residuals pass: not tested (too few, or all zero); passed: no",
        ),
        (
            {"blind": "u is slow"},
            "residuals pass: the data do not show whether dynamics are mi",
        ),
    ],
)
def test_a_sentence_names_the_failed_tests_of_the_residuals(
    changes: dict[str, Any], said: str
) -> None:
    assert said in answers.tests_sentence(_tests(**changes))
