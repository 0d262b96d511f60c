"""The complete grid of a run's samples: a row for each that was due, whether it came or not."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np
from armrig_core.codes import OutcomeCode
from armrig_core.errors import InputError
from armrig_core.manifest import Manifest, Outcome
from armrig_core.recording_file.budget import SAMPLES_LIMIT, DamageError
from numpy.typing import NDArray

MISSING_LIMIT, _MISSING_PER_SAMPLE = 200_000, 10
"""Samples that may be missing, and so many more for each that came.

The grid has rows for them: a file of two samples must not ask for 10^18 rows.
"""
TS_LEAST_S, TS_LIMIT_S = 1e-6, 86_400.0
"""No sampling time is shorter than the first, or as long as the second, in s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Where the samples that came stand among those that were due."""

    k_first: int
    """Index of the first row."""
    N: int
    """Rows."""
    present: NDArray[np.bool_]
    """(N,): the sample came."""
    taken: slice
    """Which of the samples given those are."""

    def filled(self, gaps: Iterable[tuple[int, int, float]]) -> NDArray[np.float64]:
        """Return (N,): the value of the gap that a row lies in, NaN outside of all.

        What lies outside the grid is left out. Of gaps that overlap the last given counts. Each row
        is written once, however many gaps claim it.

        Parameters
        ----------
        gaps : iterable of (int, int, float)
            First index, number of samples, and value of each.
        """
        values = np.full(self.N, np.nan)
        # Rows where a gap begins or ends, rising; between two of them the latest open one counts.
        edges: list[tuple[int, int, int, float]] = []
        for i, (k_gap, count, value) in enumerate(gaps):
            begin, end = (min(max(k - self.k_first, 0), self.N) for k in (k_gap, k_gap + count))
            if begin < end:
                edges.append((begin, -i, end, value))
        edges.sort()
        open_gaps: list[tuple[int, int, float]] = []  # a heap: the last given first
        row = 0
        for begin, order, end, value in [*edges, (self.N, 1, self.N, np.nan)]:
            while open_gaps and row < begin:
                _, until, held = open_gaps[0]
                if until > row:
                    values[row : min(until, begin)] = held
                    row = min(until, begin)
                if until <= row:
                    heappop(open_gaps)
            row = begin
            heappush(open_gaps, (order, end, value))
        return values


def grid(
    k: NDArray[np.uint64],
    manifest: Manifest,
    outcome: Outcome | None,
    gaps: Iterable[tuple[int, int]],
    between: tuple[int, int] = (0, 1 << 63),
) -> Grid:
    """Return the grid of the samples `k` (n,), which rise strictly.

    It begins with the run, at the manifest's `k_first`, and ends with the last sample that was
    due: that of a complete run is the manifest's, a run that was stopped counts its own, and where
    the file was cut off it is the last of those in its samples and gap records. A manifest without
    `k_first` is older: then the grid is from the first sample to the last.

    Parameters
    ----------
    gaps : iterable of (int, int)
        First index and number of the missing samples that were recorded.
    between : (int, int)
        First row wanted, and the one behind the last; the grid has no others.

    Raises
    ------
    ValueError
        A sample lies outside the run, or far too many are missing.
    """
    begin, end = (int(k[0]), int(k[-1]) + 1) if k.size else (0, 0)
    if manifest.k_first >= 0:
        first, last = first_of(manifest), manifest.k_first + max(manifest.samples, 0)
        if k.size and not (first <= begin and end <= last):
            raise InputError(
                f"its samples run from k={begin} to {end - 1}, those of the run from {first} to "
                f"{last - 1}"
            )
        ends = [end, *(k_gap + count for k_gap, count in gaps), first]
        if outcome is not None:
            whole = outcome.code == OutcomeCode.COMPLETE
            ends.append(last if whole else first + outcome.samples + outcome.missing)
        begin, end = first, min(max(ends), last)
    begin = max(begin, between[0])
    end = max(min(end, between[1]), begin)
    taken = slice(*np.searchsorted(k, np.array([begin, end], np.uint64)).tolist())
    k = k[taken]
    missing_limit = MISSING_LIMIT + _MISSING_PER_SAMPLE * k.size
    if end - begin - k.size > missing_limit or end - begin > SAMPLES_LIMIT:
        raise InputError(
            f"of the samples from k={begin} to {end - 1} {end - begin - k.size} are missing: too "
            "many for a recording"
        )
    present = np.ones(end - begin, np.bool_)
    if k.size < present.size:
        present[:] = False
        present[(k - np.uint64(begin)).astype(np.intp)] = True
    return Grid(k_first=begin, N=end - begin, present=present, taken=taken)


def first_of(manifest: Manifest) -> int:
    """Return the index of the first sample that was due in a file; -1 where it does not say."""
    return manifest.part_k_first if manifest.part > 1 else manifest.k_first


def check_sampling_time(manifest: Manifest) -> None:
    """Raise DamageError where a recording says of a sampling time that none has."""
    if not TS_LEAST_S <= manifest.Ts < TS_LIMIT_S:
        raise DamageError(
            f"its manifest says Ts={manifest.Ts!r} s, which must be from 1 µs to below a day"
        )
