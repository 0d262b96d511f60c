"""Result of a check of data or of a model, as a value that a program can test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

Remedy = Literal[
    "",
    "check",
    "integrator",
    "level",
    "nk",
    "noise",
    "order",
    "outliers",
    "rails",
    "search",
    "structure",
]
"""Change of the next estimation; "" if no change is known.

- check: test the data before a model is estimated
- integrator: fix a pole at 1
- level: estimate the constant level of y, or remove it from the data
- nk: begin at the first lag with an effect in the data
- noise: take a structure with a noise model, or two stages, since a law controlled the run
- order: lower the orders
- outliers, rails: mark these samples missing
- search: search other orders and noise models
- structure: take OE with an integrator
"""

FEW_SAMPLES = 300
"""Number of samples below which a model, and its standard deviations, are inaccurate."""
OWN_DATA = (
    "the models are judged on their own estimation data, which gives too good results: "
    "validate on other data"
)
"""Text of the finding that reports a comparison of models on their estimation data."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Result of one check."""

    level: Literal["good", "warning", "unusable"]
    """Severity: good, doubtful or not checked, or a reason not to use the data."""
    about: str
    """Subject of the check, a code that a program can compare."""
    text: str
    """Result of the check and, if the level is not "good", the remedy."""
    remedy: Remedy = ""
    """Remedy as a code, for the next command."""
    numbers: Mapping[str, float] = field(default_factory=dict, hash=False)
    """Numbers in the text, by name."""


def lines_of(findings: Sequence[Finding], doubt: str = "!") -> str:
    """Return a line for each finding: a mark for its level, its subject and its text."""
    marks = {"good": " ", "warning": doubt, "unusable": "!"}
    rows = [(marks[f.level], f.about.replace("_", " "), f.text) for f in findings]
    width = max((len(about) for _, about, _ in rows), default=0)
    return "\n".join(f"{mark} {about:{width}}  {text}" for mark, about, text in rows)


def good(about: str, text: str, **numbers: float) -> Finding:
    """Return a finding of level "good"."""
    return Finding(level="good", about=about, text=text, numbers=numbers)


def warning(about: str, text: str, remedy: Remedy = "", **numbers: float) -> Finding:
    """Return a finding of level "warning"."""
    return Finding(level="warning", about=about, text=text, remedy=remedy, numbers=numbers)


def unusable(about: str, text: str, **numbers: float) -> Finding:
    """Return a finding of level "unusable"."""
    return Finding(level="unusable", about=about, text=text, numbers=numbers)


def few_samples(N: int, name: str = "") -> Iterator[Finding]:
    """Yield a warning if the data called `name` have less than `FEW_SAMPLES` samples."""
    if 0 < N < FEW_SAMPLES:
        text = f"{name} has {N} samples" if name else f"{N} samples"
        text += f": models from so few samples are poor; record {FEW_SAMPLES} or more"
        yield warning("samples", text, samples=N)
