"""The gaps of a recording for a person to read: a line for each second that has some."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from math import floor
from typing import TYPE_CHECKING

from armrig.numerics.quantities import plural

if TYPE_CHECKING:
    from armrig.recordings.daemon_reports import Gap


def gap_lines(gaps: Iterable[Gap]) -> list[str]:
    """Return what is missing, at most one line a second; the counts are whole."""
    return [_gap_line(list(some)) for _, some in groupby(gaps, key=lambda gap: floor(gap.t))]


def _gap_line(gaps: list[Gap]) -> str:
    count = sum(gap.count for gap in gaps)
    samples = plural(count, "sample")
    reasons = ", ".join(dict.fromkeys(gap.reason for gap in gaps))
    if len(gaps) == 1:
        return f"{samples} at {gaps[0].t:.3f} s, {reasons}"
    return f"{samples} in {len(gaps)} gaps from {gaps[0].t:.3f} s to {gaps[-1].t:.3f} s, {reasons}"
