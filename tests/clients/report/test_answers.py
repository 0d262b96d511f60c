"""The answers of students: names and reasons for the handout's report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from armrig.report.answers import (
    MAX_NAME,
    MAX_REASONS,
    QUESTIONS,
    Answers,
    Student,
    questions_toml,
    read_answers,
)
from armrig.report.document import handout_report
from armrig.report.handout_study import handout_study
from armrig_core.errors import FileError


def answers(tmp_path: Path, text: str) -> Answers:
    """Read a file with this text."""
    path = tmp_path / "reasons.toml"
    path.write_text(text, encoding="utf-8")
    return read_answers(path)


def test_the_file_of_questions_can_be_read_as_answers(tmp_path: Path) -> None:
    text = questions_toml("reasons.toml")

    found = answers(tmp_path, text)

    assert found == Answers(students=(Student(), Student()))
    for number, question in QUESTIONS.items():
        assert f'# {number} {question.title}: {question.asks}\n"{number}" = ' in text


def test_names_and_reasons_are_read(tmp_path: Path) -> None:
    found = answers(
        tmp_path,
        """
        students = [{name = " Ada ", registration_number = "1"}, {name = "Bo"}]
        [reasons]
        "2.1" = "\\n Why\\n\\nnot.\\n"
        "2.2" = " "
        """,
    )

    assert found == Answers(
        students=(Student(name="Ada", registration_number="1"), Student(name="Bo")),
        reasons={"2.1": "Why\n\nnot."},
    )


def test_a_name_and_reasons_of_the_greatest_length_are_accepted(tmp_path: Path) -> None:
    name, reasons = "é" * MAX_NAME, "x" * MAX_REASONS

    found = answers(
        tmp_path, f'students = [{{name = " {name}"}}]\n[reasons]\n"2.1" = "{reasons}\\n"'
    )

    assert found == Answers(students=(Student(name=name),), reasons={"2.1": reasons})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[reason]", 'unknown key "reason"; known are students, reasons'),
        ('[reasons]\n"5.1" = ""', 'reasons: unknown key "5.1"; known are 2.1, 2.2'),
        ("[[students]]\nnam = 1", 'students: unknown key "nam"; known are name, registration'),
        ("students = 1", r"students: give a table \[\[students\]\]"),
        ("reasons = 1", r"reasons: give a table \[reasons\]"),
        ("[[students]]\n" * 3, "3 students: the handout's cover has room for 2"),
        ('[reasons]\n"2.1" = 3', "2.1 = 3: each value is a text in quotes, such as reg"),
        (
            f'[reasons]\n"2.1" = "{"x" * (MAX_REASONS + 1)}"',
            "2.1 has 4001 characters: at most 4000",
        ),
        ('[reasons]\n"2.1" = "\\u001b[1m"', "2.1 has characters that cannot be printed"),
        ("[reasons", "not a TOML file: "),
        (
            "[[students]]\nregistration_number = 900101-1234",
            'not a TOML file: .*; each value is a text in quotes, such as reg.* = "900101-1234"',
        ),
        ("[[students]]\nregistration_number = 9001011234", ".*, of at most 80 characters"),
    ],
)
def test_a_wrong_answer_is_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(FileError, match=rf"reasons\.toml: {message}"):
        answers(tmp_path, text)


def test_a_missing_file_is_refused_with_the_command_that_writes_it(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"`armrig report --handout --questions .*` writes it"):
        read_answers(tmp_path / "none.toml")


@pytest.mark.exhaustive
def test_markup_in_an_answer_is_text(tmp_path: Path) -> None:
    wild = '#image("/etc/passwd") *a* $x$ \\ #panic() `b'
    given = Answers(
        students=(Student(name="#panic()", registration_number="*1*"),),
        reasons={"2.1": wild},
    )

    handout_report(handout_study(), tmp_path / "r.pdf", answers=given, source=tmp_path / "source")

    values = json.loads((tmp_path / "source" / "data.json").read_text(encoding="utf-8"))
    assert [s["reasons"] for s in values["sections"] if s["number"] == "2.1"] == [[wild]]
    assert [text for _, text in values["cover"]["fields"]] == ["#panic()", "*1*", "", "", ""]
