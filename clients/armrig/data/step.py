"""Step of a treatment: a sentence for people, with a code for programs."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf
from typing import Self

MEAN = "mean"
"""Code of a step that removed the mean."""
LINE = "line"
"""Code of a step that removed a straight line."""
DOUBT = "doubt"
"""Code of a step that may be a misreading of a file, or that names a fault of its data."""
OTHER_INPUTS = "inputs"
"""Code of a step that names columns that switch like an input, and are not in the data."""

_PART = "part"
"""First word of the code of a step that selected a part; the part's start and end in s follow."""
_SEVERAL_PARTS = "parts"
"""Code of a step that selected a part, after this part was merged with other data."""


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


def took(text: str, start: float, stop: float) -> Step:
    """Return the history step of a selection from `start` to `stop`, in s from the first sample."""
    return Step(text, f"{_PART} {start:.9g} {stop:.9g}")


def in_merged(code: str) -> str:
    """Return the code that a step gets when its data are merged with other data."""
    return _SEVERAL_PARTS if code.startswith(f"{_PART} ") else code


def span_of(history: Iterable[str]) -> tuple[float, float] | None:
    """Return the start and the end of the data, in s from the start of their recording or file.

    If no step selected a part, the result is (0, inf). If several parts were merged, the result is
    None.
    """
    start, stop = 0.0, inf
    for code in codes_of(history):
        kind, *ends = code.split(" ")
        if kind == _SEVERAL_PARTS:
            return None
        if kind == _PART:
            a, b = map(float, ends)
            start, stop = start + a, min(stop, start + b)
    return start, stop
