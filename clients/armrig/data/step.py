"""A step of a treatment: a sentence for a person, with the code that programs decide by."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Self

MEAN = "mean"
"""Code of: the mean was removed."""
LINE = "line"
"""Code of: a straight line was removed."""


class Step(str):
    """A sentence of a history, which knows what was done."""

    __slots__ = ("code",)
    code: str

    def __new__(cls, text: str, code: str = "") -> Self:
        """Take the sentence, and the code where a program asks for the step."""
        step = super().__new__(cls, text)
        step.code = code
        return step


def codes_of(history: Iterable[str]) -> list[str]:
    """Return the code of each step, "" for a step that has none."""
    return [step.code if isinstance(step, Step) else "" for step in history]
