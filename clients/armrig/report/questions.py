"""The questions that the handout asks, and the file in which students answer them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """An assignment, and the reasons that the student has to give."""

    title: str
    """Subject of the assignment."""
    asks: str
    """Reasons that armrig cannot give."""


QUESTIONS: Final = {
    "2.1": Question(
        title="Mathematical model",
        asks="the three phases in your own words; why the simplifications are allowed",
    ),
    "2.2": Question(
        title="Step response",
        asks="the slope at time 0, in your own words; your Simulink model",
    ),
    "2.3": Question(
        title="Two parameters changed",
        asks="why these two parameters; what else you tried (`armrig model --set J_1=…`)",
    ),
    "3.1": Question(
        title="Sampling time",
        asks="the method that you chose, and the sampling time that you used",
    ),
    "3.2": Question(
        title="Choice of parametrisation",
        asks="the structure and orders that you take, and what speaks for them",
    ),
    "3.3": Question(
        title="Black box",
        asks="the model that you choose, and those that you tried (`armrig identify --search`)",
    ),
    "3.4": Question(
        title="Against the physics",
        asks="which model is best, for what; differences and similarities",
    ),
    "3.5": Question(
        title="Grey box: the inertia J",
        asks="what you held fixed, and whether friction may be neglected",
    ),
    "3.6": Question(
        title="Covariance and the length of the data",
        asks="the trend, and how you explain it",
    ),
    "3.7": Question(
        title="Open loop",
        asks="what in the input and output data you infer it from",
    ),
    "3.8": Question(
        title="No input delay",
        asks="what in the input and output data you infer it from",
    ),
    "4.1": Question(
        title="Forward Euler",
        asks="your choice of the step, and what varying it shows",
    ),
    "4.2": Question(
        title="AB(2)",
        asks="your choice of the step, and what varying it shows",
    ),
    "4.3": Question(
        title="Trapezoidal rule",
        asks="your choice of the step, and what varying it shows",
    ),
    "4.4": Question(
        title="Heun, RK(2)",
        asks="your choice of the step, and what varying it shows",
    ),
}
"""By the handout's number of the assignment, in its order."""

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
    """Return the text of a file with all questions of the handout, and room for the answers.

    Parameters
    ----------
    file : str
        Name of the file, as its first lines give it to the next command.
    """
    asked = (
        f'\n# {number} {question.title}: {question.asks}\n"{number}" = """\n"""\n'
        for number, question in QUESTIONS.items()
    )
    return _HEAD.format(file=file) + "".join(asked)
