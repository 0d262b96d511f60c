"""Step of a treatment: a sentence for people, with a code for programs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Self

MEAN = "mean"
"""Code of a step that removed the mean."""
LINE = "line"
"""Code of a step that removed a straight line."""


class Step(str):
    """A sentence of a history, with the code of its treatment."""

    __slots__ = ("code",)
    code: str

    def __new__(cls, text: str, code: str = "") -> Self:
        """Make a step from its sentence and, if a program must recognise the step, its code."""
        step = super().__new__(cls, text)
        step.code = code
        return step


def codes_of(history: Iterable[str]) -> list[str]:
    """Return the code of each step, "" for a step without a code."""
    return [step.code if isinstance(step, Step) else "" for step in history]
