"""Result of a check of data or of a model, as a value that a program can test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Asks = Literal["", "order", "integrator", "structure"]
"""Setting to change in the next estimation; "" if no setting must change."""

OWN_DATA = (
    "the models are judged on their own estimation data, which gives too good results: "
    "validate on other data"
)
"""Text of the finding that reports a comparison of models on their estimation data."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Result of one check."""

    level: Literal["good", "warning", "unusable"]
    """Severity: good, doubtful, or a reason not to identify from the data."""
    about: str
    """Subject of the check, one word that a program can compare."""
    text: str
    """Result of the check and, if the level is not "good", the remedy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimateFinding(Finding):
    """Finding of an estimation about its data or its result."""

    asks: Asks = ""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """Numbers in the text, by name."""


def warning(about: str, text: str, asks: Asks = "", **numbers: float) -> EstimateFinding:
    """Return a finding of level "warning"."""
    return EstimateFinding(level="warning", about=about, text=text, asks=asks, numbers=numbers)
