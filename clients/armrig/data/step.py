"""A step of a treatment: a sentence for a person, with the code that programs decide by."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """Level and slope of u and of y; a slope is 0 where only the mean was taken."""

    u_level: float = 0.0
    """Value of u's line at the experiment's first sample, in u's unit."""
    u_slope: float = 0.0
    """In u's unit per s."""
    y_level: float = 0.0
    """Value of y's line at the experiment's first sample, in y's unit."""
    y_slope: float = 0.0
    """In y's unit per s."""

    def u(self, t: Vector) -> Vector:
        """Return u's line at t (n,) in s from the experiment's first sample."""
        return np.asarray(self.u_level + self.u_slope * t)

    def y(self, t: Vector) -> Vector:
        """Return y's line at t (n,) in s from the experiment's first sample."""
        return np.asarray(self.y_level + self.y_slope * t)

    def later(self, seconds: float) -> Trend:
        """Return the same lines, as they count from a first sample that is so much later."""
        return Trend(
            u_level=self.u_level + self.u_slope * seconds,
            u_slope=self.u_slope,
            y_level=self.y_level + self.y_slope * seconds,
            y_slope=self.y_slope,
        )

    def __add__(self, other: Trend) -> Trend:
        """Return both together: what was taken in two steps."""
        names = [field.name for field in fields(self)]
        return Trend(**{name: getattr(self, name) + getattr(other, name) for name in names})
