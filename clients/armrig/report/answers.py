"""Names and reasons that students add to the handout's report."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from armrig_core.errors import FileError
from armrig_core.process.bounded import CONFIGURATION_LIMIT, read_text
from armrig_core.process.printable import printable
from armrig_core.process.toml_file import toml_tables

from armrig.numerics.quantities import plural

MAX_STUDENTS: Final = 2
"""Largest number of students: the handout's cover has this number of lines for names."""
MAX_NAME, MAX_REASONS = 80, 4000
"""Largest number of characters of a name, and of the reasons for one assignment.

The limits keep the report within ten pages.
"""
_KEYS: Final = ("name", "registration_number")
_QUOTED: Final = 'each value is a text in quotes, such as registration_number = "900101-1234"'


@dataclass(frozen=True, slots=True, kw_only=True)
class Student:
    """A student who hands in the report."""

    name: str = ""
    registration_number: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """Names of the students, and their reasons for each assignment."""

    students: tuple[Student, ...] = ()
    reasons: dict[str, str] = field(default_factory=dict)
    """Reasons by the number of the assignment in the handout; empty reasons are left out."""


def read_answers(path: Path) -> Answers:
    """Read the answers in a file that `armrig report --handout --questions` wrote.

    Raises
    ------
    FileError
        The file cannot be read, a key is unknown, or a value is too long or is not a text.
    """
    try:
        tables = toml_tables(read_text(path, CONFIGURATION_LIMIT))
    except FileNotFoundError as err:
        msg = f"{path}: there is no such file; `armrig report --handout --questions {path}` "
        raise FileError(f"{msg}writes it") from err
    except FileError as err:
        raise FileError(f"{path}: {err}; {_QUOTED}") from err
    except OSError as err:
        raise FileError(f"{path}: {err.strerror or err}") from err
    try:
        return _answers(tables)
    except FileError as err:
        raise FileError(f"{path}: {err}") from err


def _answers(tables: dict[str, Any]) -> Answers:
    _check_keys(tables, ("students", "reasons"), "")
    students, reasons = tables.get("students", []), tables.get("reasons", {})
    if not isinstance(students, list) or not all(isinstance(s, dict) for s in students):
        raise FileError("students: give a table [[students]] for each student")
    if len(students) > MAX_STUDENTS:
        raise FileError(
            f"{len(students)} students: the handout's cover has room for {MAX_STUDENTS}"
        )
    if not isinstance(reasons, dict):
        raise FileError(
            'reasons: give a table [reasons] with one text for each assignment, such as "2.1"'
        )
    for student in students:
        _check_keys(student, _KEYS, "students: ")
    _check_keys(reasons, tuple(QUESTIONS), "reasons: ")
    return Answers(
        students=tuple(
            Student(**{key: _text(s, key, MAX_NAME) for key in _KEYS if key in s}) for s in students
        ),
        reasons={
            number: text for number in reasons if (text := _text(reasons, number, MAX_REASONS))
        },
    )


def _check_keys(table: dict[str, Any], keys: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in keys:
            raise FileError(f'{where}unknown key "{printable(key)}"; known are {", ".join(keys)}')


def _text(table: dict[str, Any], key: str, most: int) -> str:
    """Return a text in `table` without surrounding space; raise FileError if it is not valid."""
    value = table[key]
    if not isinstance(value, str):
        raise FileError(f"{key} = {value!r:.40}: {_QUOTED}, of at most {plural(most, 'character')}")
    text = value.strip()
    if len(text) > most:
        raise FileError(f"{key} has {plural(len(text), 'character')}: at most {most} are allowed")
    if not all(c.isprintable() or c.isspace() for c in text):
        raise FileError(f"{key} has characters that cannot be printed: give plain text")
    return text


class Question(NamedTuple):
    """Title of an assignment, and the reasons that armrig cannot write for the student."""

    title: str
    asks: str


QUESTIONS: Final = {
    "2.1": Question(
        "Mathematical model",
        "the three phases in your own words; why the simplifications are allowed",
    ),
    "2.2": Question(
        "Step response",
        "why the response has its slope at time 0, in your own words; your Simulink model",
    ),
    "2.3": Question(
        "Two parameters changed",
        "why these two parameters; what else you tried (`armrig model --set NAME=…`)",
    ),
    "3.1": Question(
        "Sampling time", "the method that you chose, and the sampling time that you used"
    ),
    "3.2": Question(
        "Choice of parametrisation",
        "the structure and orders that you choose, and the evidence for them",
    ),
    "3.3": Question(
        "Black box",
        "the model that you choose, and those that you tried (`armrig identify --search`)",
    ),
    "3.4": Question(
        "Comparison with the physics",
        "which model is best for which purpose; differences and similarities",
    ),
    "3.5": Question(
        "Grey box: the inertia J", "what you held fixed, and whether friction may be neglected"
    ),
    "3.6": Question("Covariance and the length of the data", "the trend, and how you explain it"),
    "3.7": Question("Open loop", "the evidence for open loop in the input and output data"),
    "3.8": Question("No input delay", "the evidence against a delay in the input and output data"),
    "4.1": Question("Forward Euler", "your choice of the step, and the effect of other steps"),
    "4.2": Question("AB(2)", "your choice of the step, and the effect of other steps"),
    "4.3": Question("Trapezoidal rule", "your choice of the step, and the effect of other steps"),
    "4.4": Question("Heun, RK(2)", "your choice of the step, and the effect of other steps"),
}
"""Questions by the number of the assignment, in the order of the handout."""

_HEAD = '''\
# Names and reasons for the handout's report. After filling them in:
#   armrig report --handout --answers {file} RECORDINGS
# An answer may have several lines between """ and """; an empty line begins a paragraph.

[[students]]
name = ""
registration_number = ""

[[students]]
name = ""
registration_number = ""

[reasons]
'''


def questions_toml(file: str) -> str:
    """Return the text of a file with all questions of the handout and space for the answers.

    The first lines contain the command that reads the file, which is called `file`.
    """
    questions = (
        f'\n# {number} {question.title}: {question.asks}\n"{number}" = """\n"""\n'
        for number, question in QUESTIONS.items()
    )
    return _HEAD.format(file=file) + "".join(questions)
