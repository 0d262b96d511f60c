"""identify, validate and compare with several signals: the way that `next:` leads, and columns."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.cli import several_output
from armrig.cli.recorded_data import SignalChoice
from armrig.cli.several_next import after_compare, after_validate
from armrig.data.dataset import Signals
from armrig.validation.comparison import Comparison, ComparisonTable
from armrig.validation.residual_test import ResidualTest

from tests.clients.models.made_fits import made

P = np.array([[0.5, 0.004, 0.0005], [0.02, 1.0, np.nan]])
"""p values of two outputs and three inputs; 0.01 / 6 is 0.0017."""


def _tests(**changes: Any) -> Any:
    of = {"outputs": ("y", "z"), "inputs": ("u", "v", "w"), "missing_dynamics_by_pair": P}
    of |= {"feedback_by_pair": P[::-1], "missing_dynamics": 0.5, "feedback": 0.5}
    return SimpleNamespace(**of | changes)


def test_a_pair_fails_its_test_at_the_level_of_all_pairs_together() -> None:
    brief = list(ResidualTest.pair_lines(_tests()))
    every = list(ResidualTest.pair_lines(_tests(), every=True))
    missing = list(ResidualTest.pair_lines(_tests(missing_dynamics=0.009), every=True))

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
        "  w to z: no dynamics missing not tested",
    ]
    assert every[6:9] == [
        "  u to y: no feedback (p = 0.020)",
        "  v to y: no feedback (p = 1.000)",
        "  w to y: no feedback not tested",
    ]
    assert (len(every), missing) == (12, every[:6])


def test_the_tests_of_each_pair_are_in_json_under_its_names() -> None:
    from armrig.numerics.whiteness import Whiteness

    white = [Whiteness(p_value=p, test=f"test of {p}") for p in (0.3, 0.2, 0.1)]
    facts = several_output.test_facts(
        _tests(white=white[0], white_by_output=white[1:], missing_dynamics=0.4)
    )

    assert (facts["p_white"], facts["p_no_dynamics_missing"], facts["p_no_feedback"]) == (
        *(0.3, 0.4, 0.5),
    )
    assert facts["outputs"]["z"] == {"p_white": 0.1, "whiteness_test": "test of 0.1"}
    assert [(pair["output"], pair["input"]) for pair in facts["pairs"]] == [
        (output, input) for output in "yz" for input in "uvw"
    ]
    assert facts["pairs"][2]["p_no_dynamics_missing"] == 0.0005
    assert facts["pairs"][5]["p_no_feedback"] == 0.0005


def _table(horizon: int | None, **rms: list[float]) -> ComparisonTable:
    """Return a comparison of models by their errors of the outputs y and z."""
    model, data = made(), Signals(u=[0.0, 1.0], y=np.eye(2), Ts=1.0, outputs=["y", "z"])
    rows = [
        Comparison(
            name=name, output=output, unit=unit, fit_percent=100 - e, rms_error=e, y=np.zeros(2),
            velocity_fit_percent=None, on_estimation_data=False, model=model,
        )
        for name, errors in rms.items()
        for output, unit, e in zip("yz", ("rad", ""), errors, strict=True)
    ]  # fmt: skip
    return ComparisonTable(rows=tuple(rows), horizon=horizon, note="", data=data)


@pytest.mark.parametrize(
    ("horizon", "rms", "said"),
    [
        (None, {"a": [1, 5], "b": [2, 4]}, "Simulated, a has the least error of y and b has"),
        (None, {"a": [3, 5], "b": [2, 4]}, "Simulated, b has the least error of y and z."),
        (7, {"a": [3, np.nan], "b": [4, 9]}, "Predicted 7 ahead, a has the least error of y"),
        (2, {"a": [3, 5]}, "Predicted 2 ahead, a fits y to 97.00 % (rms 3 rad) and z to 95.00 %"),
    ],
)
def test_the_model_with_the_least_error_is_named_for_each_output(
    horizon: int | None, rms: dict[str, list[float]], said: str
) -> None:
    assert several_output.closest(_table(horizon, **rms)).startswith(said)


@pytest.mark.parametrize(
    ("source", "outputs", "wanted"),
    [
        ("", ("alpha", "theta_1"), "simulate F --model m.json --from 1 --to 9 -o simulate.png"),
        ("", ("alpha", "velocity"), "check F --signal alpha --detrend --from 1 --to 9"),
        ("csv:12", ("y", "z"), "check F --input w --signal alpha --detrend --from 1 --to 9"),
    ],
)
def test_a_validation_suggests_the_physics_or_the_poorest_channel(
    source: str, outputs: tuple[str, ...], wanted: str, capsys: pytest.CaptureFixture[str]
) -> None:
    tests: Any = SimpleNamespace(poorest_pair=("alpha", "w"))
    given = SignalChoice(signal=",".join(outputs), input="u,w", start=1, stop=9, detrend=True)
    fit: Any = SimpleNamespace(outputs=outputs)
    data: Any = SimpleNamespace(source=source)

    after_validate(fit, tests, data, Path("F"), Path("m.json"), given)

    assert capsys.readouterr().err == f"next: armrig {wanted}\n"


@pytest.mark.parametrize(
    ("source", "signal", "input_", "given"),
    [
        ("", None, None, ""),
        ("", "theta_1,alpha", None, ""),
        ("", "alpha,theta_1", None, " --signal alpha"),
        ("csv:12", "z,y", "v,w", " --input v --signal z"),
        ("csv:12", None, None, " --input u --signal theta_1"),
    ],
)
def test_a_comparison_suggests_the_first_output_and_the_first_input(
    source: str,
    signal: str | None,
    input_: str | None,
    given: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    data: Any = SimpleNamespace(source=source, outputs=("theta_1", "y"), inputs=("u", "v"))

    after_compare(data, Path("F"), SignalChoice(signal=signal, input=input_))

    assert capsys.readouterr().err == f"next: armrig check F{given}\n"
