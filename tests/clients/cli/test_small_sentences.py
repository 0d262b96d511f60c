"""Sentences of options, questions, recorders and reports, each with its numbers and names."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import armrig
import numpy as np
import pytest
import typer
from armrig.cli import main, options, record, recording_info
from armrig.cli.options import agree, print_table, question, warned
from armrig.cli.parameters import cases, changes, physics_beside
from armrig.cli.reporting import _report_ignored
from armrig.cli.usage_errors import _in_whole_units
from armrig_core.arm import ArmParameters
from armrig_core.codes import COMPLETE
from armrig_core.errors import InputError, OperationError

from tests.clients.made_recordings import of_the_arm, written


@pytest.mark.parametrize(
    ("name", "times", "is_doubted"),
    [
        *(("J_1", 99.0, False), ("J_1", 101.0, True), ("J_2", 1 / 99, False)),
        *(("J_2", 1 / 101, True), ("K_m", 1e-3, True), ("K_m", 1.0, False)),
    ],
)
def test_a_parameter_a_hundred_times_too_large_or_too_small_is_doubted(
    name: str, times: float, is_doubted: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    handout = getattr(ArmParameters(), name)
    given = f"{name}={handout * times:.6g}"

    assert main(["simulate", "--set", given, "--from", "1"]) == 2

    doubt = f"--set {name}={float(given.partition('=')[2]):g}: this is {times:.2g} times the value"
    said = " ".join(capsys.readouterr().err.split())
    assert (doubt in said) == is_doubted
    assert (f"of the handout, {handout:g}; is it in SI units?" in said) == is_doubted


@pytest.mark.parametrize(
    ("given", "unit"), [("K_lin=2Nm", "N m/rad"), ("R_m=4 Ω", "Ω"), ("N=15x", "")]
)
def test_a_value_with_its_unit_is_answered_with_the_handout_s_own(given: str, unit: str) -> None:
    name = given.partition("=")[0]
    with pytest.raises(typer.BadParameter) as refused:
        changes([given])

    said = str(refused.value)
    assert said.startswith(f"--set {given}: give the number alone")
    assert said.endswith(f", such as --set {name}={getattr(ArmParameters(), name):g}")
    assert bool(unit) == (", in " in said)


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
def test_a_value_with_a_prefix_is_offered_in_whole_units(
    number: str, unit: str, whole: str
) -> None:
    assert _in_whole_units(number, unit) == whole


def test_a_question_leaves_room_for_the_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    text = "word " * 12

    for columns, widest in ((50, 34), (33, 17), (32, len(text)), (0, len(text))):
        monkeypatch.setattr(options, "_columns", lambda _, columns=columns: columns)
        lines = question(text).split("\n")

        assert max(map(len, lines)) <= widest
        assert (len(lines) == 1) == (columns <= 32)
        assert not any(line.startswith(" ") for line in lines)


def test_nothing_is_done_without_agreement(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr("typer.confirm", lambda text, err: asked.append(text) or "yes" in text)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))

    agree("no", yes=True)
    agree("yes", yes=False)
    with pytest.raises(OperationError, match="nothing was done"):
        agree("no", yes=False)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: False))
    with pytest.raises(OperationError, match="no terminal for the question: --yes agrees"):
        agree("yes", yes=False)
    assert asked == ["yes", "no"]


def test_values_stand_below_each_other(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    print_table(("a", "first"), ("longer", "one two three"))
    monkeypatch.setattr(options, "_columns", lambda _: 18)
    print_table(("longer", "one two three"))

    assert capsys.readouterr().out.splitlines() == [
        *("a       first", "longer  one two three", "longer  one two", "        three"),
    ]


@pytest.mark.parametrize(
    ("name", "truncated", "said"),
    [
        ("a.mcap", True, "a.mcap: cut\n"),
        ("a.mcap.active", True, "a.mcap.active: still being recorded, or the daemon was killed; "),
        ("a.mcap.active", False, ""),
    ],
)
def test_the_damage_of_a_recording_is_printed(
    name: str, truncated: bool, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    one = SimpleNamespace(path=Path(name), truncated=truncated, damage="cut")

    assert warned(one) is one

    err = capsys.readouterr().err
    assert err.startswith(f"armrig: {said}") if said else not err


def _recorded_file(name: str) -> Any:
    return SimpleNamespace(path=Path(name), samples=len(name), missing=2, outcome="complete")


def test_a_remote_recording_that_ends_early_names_its_last_file(
    capsys: pytest.CaptureFixture[str],
) -> None:
    files = [_recorded_file("a.mcap"), _recorded_file("a.2.mcap")]
    failed: Any = SimpleNamespace(code="failed")
    for done, ending, said in (
        (files, failed, "armrig: recorded up to the error: a.2.mcap, the last of 2 files\n"),
        (files[:1], failed, "armrig: recorded up to the error: a.mcap\n"),
        ([], failed, ""),
        (files, COMPLETE, ""),
    ):
        ended: list[Any] = []
        recording: Any = SimpleNamespace(done=done, finish=ended.append)

        record._finish(recording, ending)

        assert (capsys.readouterr().err, ended) == (said, [ending])


def test_a_remote_recording_replaces_no_file(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").touch()
    (tmp_path / "b.mcap.active").touch()

    assert record._checked(tmp_path / "c.mcap") == tmp_path / "c.mcap"
    for name, said in (
        ("a.mcap", "a.mcap exists"),
        ("b.mcap", "b.mcap.active exists"),
        ("c.csv", "ends in .mcap"),
    ):
        with pytest.raises(InputError, match=f"-o {tmp_path / name}: .*{said}"):
            record._checked(tmp_path / name)


def test_a_report_names_the_recordings_that_give_no_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = {kind: of_the_arm(np.full(60, 1.0), experiment=kind) for kind in ("step-a", "blackbox")}
    kinds = {"s": "step-a", "a": "blackbox", "b": "blackbox", "c": "blackbox"}
    files = [written(tmp_path, data[kind], f"{name}.mcap") for name, kind in kinds.items()]

    _report_ignored([armrig.load(file) for file in files])

    said = " ".join(capsys.readouterr().err.split())
    used = "the models are estimated from a.mcap and validated on b.mcap"
    assert f"c.mcap is only listed in the report: {used}" in said
    assert said.count("is only listed") == 1


def test_a_long_text_is_cut_at_its_end_and_a_spread_has_its_figures() -> None:
    long = "ab" * 500

    assert recording_info._clipped(long) == long
    assert recording_info._clipped(f"{long}c") == f"{long}…; --json shows all of it"
    spread = SimpleNamespace(n=9, p50=1.26, p99=7.04, max=12.6)
    assert recording_info._lateness(spread, "exchange").startswith("p50 1.3, p99 7.0, max 13 µs; l")
    assert recording_info._lateness(spread, "scheduled").startswith(
        "p50 1.3, p99 7.0, max 13 µs; a"
    )
    assert recording_info._jitter(spread).startswith("p50 1, p99 7, max 13 µs; spread")
    spread.n = 0
    assert recording_info._lateness(spread, "exchange") == "too few samples"


@pytest.mark.parametrize(("name", "known"), [("dataset", "Dataset"), ("ARMAX", "armax")])
def test_a_name_of_the_package_in_another_case_is_answered_with_the_right_one(
    name: str, known: str
) -> None:
    with pytest.raises(AttributeError, match=rf"'{name}'; did you mean armrig\.{known}\?"):
        getattr(armrig, name)
