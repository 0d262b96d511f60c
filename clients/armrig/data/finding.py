"""A finding: what a check found in data or in a model, as a value that programs decide by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Asks = Literal["", "order", "integrator", "structure"]
"""What another estimation should change; "" if nothing, or another treatment of the data."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What one check found."""

    level: Literal["good", "warning", "unusable"]
    """Whether it stands in the way of identification."""
    about: str
    """What was checked, by a name of one word that programs decide by."""
    text: str
    """What was found and, where it is not good, what to do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimateFinding(Finding):
    """What an estimation found in its data or in its result."""

    asks: Asks = ""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """The figures in the text."""


def warning(about: str, text: str, asks: Asks = "", **numbers: float) -> EstimateFinding:
    """Return what an estimation warns of."""
    return EstimateFinding(level="warning", about=about, text=text, asks=asks, numbers=numbers)
