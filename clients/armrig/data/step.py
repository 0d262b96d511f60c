"""Step of a treatment: a sentence for people, with a code for programs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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
OTHER_COLUMNS = "columns"
"""Code of a step that counts columns of changing numbers that are not in the data."""

CONTROLLED = "controlled"
"""First word of the code of a step that names the law of a run; the law's SHA-256 follows."""
BIASED = "biased"
"""Code of a note: coloured noise in the loop of a controlled run biases the result."""
TWO_STAGE = "two_stage"
"""Code of a step that replaced the input by its part that a reference causes."""

_PART = "part"
"""First word of the code of a step that selected a part; the part's start and end in s follow."""
_SEVERAL_PARTS = "parts"
"""Code of a step that selected a part, after this part was merged with other data."""
_SHOWN_DIGITS = 12


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


def law_step(law_sha256: str) -> Step:
    """Return the history step of data that were recorded under the law of this hash.

    The hash is "" if a client's program computed the input from the samples.
    """
    return Step(f"controlled by {laws_text([law_sha256])}", f"{CONTROLLED} {law_sha256}")


def laws_of(history: Iterable[str]) -> tuple[str, ...]:
    """Return the SHA-256 of the laws that controlled the data, each once; () without feedback."""
    words = (code.split(" ") for code in codes_of(history))
    return tuple(dict.fromkeys(word[1] for word in words if word[0] == CONTROLLED))


def laws_text(laws: Iterable[str]) -> str:
    """Return laws by their short hashes as text, such as: the law 4e361ae2a1fe."""
    names = [f"the law {law[:_SHOWN_DIGITS]}" if law else "a client's controller" for law in laws]
    return " and ".join(names)


def in_loop(history: Sequence[str], bias: str) -> tuple[str, ...]:
    """Return the note that data are from a loop, with the sentence `bias` on its effect.

    Without a law, or in the second of two stages, there is no note.
    """
    if not (laws := laws_of(history)) or TWO_STAGE in codes_of(history):
        return ()
    return (Step(f"controlled by {laws_text(laws)}: {bias}", BIASED),)


def loop_notes(history: Sequence[str], line: str = "armrig.bj(data, …)") -> tuple[str, ...]:
    """Return the note on the bias of an estimate without a noise model, from data under a law.

    `line` is an unbiased estimate to type.
    """
    bias = "coloured noise in the loop biases this estimate; use BJ or ARMAX, "
    return in_loop(history, f"{bias}{line}, or armrig.two_stage (--two-stage)")


def with_notes(lines: Iterable[str], notes: Iterable[str], mark: str) -> str:
    """Return the lines as text, then the notes; a note with the code BIASED is the first line."""
    notes = [*notes]
    codes = codes_of(notes)
    first = [f"{mark}: {note}" for note, code in zip(notes, codes, strict=True) if code == BIASED]
    last = [f"  {mark}: {note}" for note, code in zip(notes, codes, strict=True) if code != BIASED]
    return "\n".join([*first, *lines, *last])


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
