"""Requirement on a step of the reference, which the file of a law contains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite, nan
from typing import Any

from armrig_core.errors import ParameterError

from armrig.numerics.quantities import digits

_QUANTITIES = {"overshoot": ("overshoot", "%"), "settling": ("5 % settling", "s")}
_TOLERANCE = 1e-9  # of a bound


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirement:
    """Largest overshoot and longest settling of a step; infinite without a bound.

    Raises
    ------
    ParameterError
        A bound is not a number above 0, or not at least 0 for the overshoot.
    """

    overshoot: float = inf
    """Largest value beyond the step, in percent of the step."""
    settling: float = inf
    """Longest time after which the output stays within 5 % of the step, in s."""

    def __post_init__(self) -> None:
        """Refuse bounds that no loop meets."""
        for name, bound in self._bounds.items():
            if not bound >= 0 or (name == "settling" and bound == 0):
                least = "more than 0 s" if name == "settling" else "0 % or more"
                raise ParameterError(name, f"{bound:g}", f"must be {least}")

    @property
    def _bounds(self) -> dict[str, float]:
        return {name: getattr(self, name) for name in _QUANTITIES}

    @property
    def facts(self) -> dict[str, float]:
        """Return the bounds by name, as the file of a law contains them."""
        return {name: bound for name, bound in self._bounds.items() if isfinite(bound)}

    def misses(self, figures: Mapping[str, float]) -> list[str]:
        """Return the names of the bounds that the figures exceed; a NaN exceeds each bound."""
        return [n for n, most in self.facts.items() if not figures[n] <= most * (1 + _TOLERANCE)]

    def rows(self, *figures: Mapping[str, float]) -> list[tuple[str, ...]]:
        """Return name, bound and figures of each quantity, as texts."""
        return [
            (
                _QUANTITIES[name][0],
                *(_text(name, values.get(name, nan)) for values in ({name: most}, *figures)),
            )
            for name, most in self.facts.items()
        ]

    def sentence(self, figures: Mapping[str, float], subject: str) -> str:
        """Return whether the figures of `subject` meet the requirement, as a sentence."""
        bounds = ", ".join(f"{quantity} at most {most}" for quantity, most in self.rows())
        if missed := self.misses(figures):
            texts = [f"{row[0]} {row[2]}" for row in self.rows(figures)]
            wrong = [text for name, text in zip(self.facts, texts, strict=True) if name in missed]
            return f"{subject} misses the requirement ({bounds}): {', '.join(wrong)}."
        return f"{subject} meets the requirement: {bounds}."


def requirement_of(design: Mapping[str, Any]) -> Requirement | None:
    """Return the requirement in the design of a law; None without one, or if it is none."""
    bounds = design.get("requirement")
    if not isinstance(bounds, dict) or not bounds or not {*bounds} <= {*_QUANTITIES}:
        return None
    if not all(isinstance(bound, int | float) and bound > 0 for bound in bounds.values()):
        return None
    return Requirement(**bounds)


def _text(name: str, value: float) -> str:
    if not isfinite(value):
        return "not reached" if value == inf else "not known"
    unit = _QUANTITIES[name][1]
    return f"{digits(value, 3)} {unit}"
