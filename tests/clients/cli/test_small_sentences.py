"""Sentences of options, questions, recorders and reports, each with its numbers and names."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import armrig
import pytest
from armrig.cli import main, printing
from armrig.cli.physics import cases, changes, physics_beside
from armrig.cli.usage_errors import _in_whole_units
from armrig.numerics.quantities import digits
from armrig.recordings import overview
from armrig_core.errors import OperationError
from armrig_core.rig.arm import ArmParameters


@pytest.mark.parametrize(
    ("name", "times", "is_doubted"),
    [
        *(("J_1", 99.0, False), ("J_1", 101.0, True), ("J_2", 1 / 99, False)),
        *(("J_2", 1 / 101, True), ("K_m", 1e-3, True), ("K_m", 1.0, False)),
    ],
)
def test_a_parameter_wrong_by_a_factor_of_100_causes_a_warning(
    name: str, times: float, is_doubted: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    handout = getattr(ArmParameters(), name)
    given = f"{name}={handout * times:.6g}"

    assert main(["simulate", "--set", given]) == 2

    value = float(given.partition("=")[2])
    doubt = f"--set {name}={value:g}: this is {digits(times, 2)} times the value"
    said = " ".join(capsys.readouterr().err.split())
    assert (doubt in said) == is_doubted
    assert (f"of the handout, {handout:g}; is it in SI units?" in said) == is_doubted


def test_changed_parameters_are_simulated_alone_and_together() -> None:
    J, R = {"J_1": 0.003}, {"R_m": 4.0}
    handout = ArmParameters()

    found = cases(["J_1=0.003", "R_m=4"])

    assert list(found.values()) == [handout, *(ArmParameters(**p) for p in (J, R, J | R))]
    assert list(found)[1:3] == ["J_1=0.003", "R_m=4"]
    assert list(cases(None).values()) == [handout]
    assert changes(["J_1=0.003", "R_m=4"]) == "J_1=0.003, R_m=4"
    assert physics_beside(None) == {"physics": handout}
    assert physics_beside(["R_m=4"]) == {"handout": handout, "R_m=4": ArmParameters(**R)}


@pytest.mark.parametrize(
    ("number", "unit", "whole"),
    [
        *(("500", "mV", "0.5"), ("20", "us", "2e-05"), ("20", "µs", "2e-05")),
        *(("3", "kHz", "3000"), ("5", "s", "5"), ("5", "m", "5"), ("-2", "V", "-2")),
        ("1.2.3", "ms", "1.2.3"),
    ],
)
def test_a_value_with_a_unit_prefix_is_converted_to_the_unit(
    number: str, unit: str, whole: str
) -> None:
    assert _in_whole_units(number, unit) == whole


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Give a terminal, whose columns a test may set; 0: there is none."""
    terminal = SimpleNamespace(columns=0)
    monkeypatch.setattr(printing, "_columns", lambda _: terminal.columns)
    return terminal


def test_a_question_leaves_space_for_its_answer(terminal: SimpleNamespace) -> None:
    text = "word " * 12

    for terminal.columns, widest in ((50, 34), (33, 17), (32, len(text)), (0, len(text))):
        lines = printing.question(text).split("\n")

        assert max(map(len, lines)) <= widest
        assert (len(lines) == 1) == (terminal.columns <= 32)
        assert not any(line.startswith(" ") for line in lines)


def test_an_action_requires_consent(
    typed: Callable[[str | None], None], capsys: pytest.CaptureFixture[str]
) -> None:
    typed("y\nn\n")
    printing.agree("first", yes=True)
    printing.agree("second", yes=False)
    with pytest.raises(OperationError, match="nothing was done"):
        printing.agree("third", yes=False)
    typed(None)
    with pytest.raises(OperationError, match="no terminal for the question: --yes agrees"):
        printing.agree("fourth", yes=False)
    assert capsys.readouterr().err == "second [y/N]:third [y/N]:"


def test_values_of_a_table_are_aligned(
    terminal: SimpleNamespace, capsys: pytest.CaptureFixture[str]
) -> None:
    printing.print_table(("a", "first"), ("longer", "one two three"))
    terminal.columns = 18
    printing.print_table(("longer", "one two three"))

    assert capsys.readouterr().out.splitlines() == [
        *("a       first", "longer  one two three", "longer  one two", "        three"),
    ]


def test_a_long_text_is_cut_at_its_end_and_a_spread_has_its_figures() -> None:
    long = "ab" * 500

    assert overview._clip(long) == long
    assert overview._clip(f"{long}c") == f"{long}…; --json shows all of it"
    spread: Any = SimpleNamespace(n=9, p50=1.26, p99=7.04, max=12.6)
    assert overview._percentiles(spread, 1, "of x") == "p50 1.3, p99 7.0, max 13 µs; of x"
    spread.n = 0
    assert overview._percentiles(spread, 1, "of x") == "too few samples"


@pytest.mark.parametrize(("name", "known"), [("dataset", "Dataset"), ("ARMAX", "armax")])
def test_a_misspelt_case_of_a_name_is_reported_with_the_right_name(name: str, known: str) -> None:
    with pytest.raises(AttributeError, match=rf"'{name}'; did you mean armrig\.{known}\?"):
        getattr(armrig, name)
