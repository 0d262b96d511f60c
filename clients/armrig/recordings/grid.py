"""Complete grid of a run's samples, with a row for each sample that was due, even if missing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np
from armrig_core.commands.codes import OutcomeCode
from armrig_core.errors import InputError
from armrig_core.recording_file.budget import SAMPLES_LIMIT, DamageError
from armrig_core.recording_file.manifest import Manifest, Outcome
from numpy.typing import NDArray

MISSING_LIMIT, _MISSING_PER_SAMPLE = 200_000, 10
"""Limit of missing samples: a fixed number, plus a number for each sample that arrived.

Without a limit, a file of two samples could demand a grid of 10^18 rows.
"""
TS_LEAST_S, TS_LIMIT_S = 1e-6, 86_400.0
"""Shortest sampling time, and exclusive upper limit of the sampling time, in s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleGrid:
    """Positions of the arrived samples in the sequence of all samples that were due."""

    k_first: int
    """Index of the first row."""
    N: int
    """Number of rows."""
    present: NDArray[np.bool_]
    """Mask (N,), True if the sample arrived."""
    taken: slice
    """Slice of the arrived samples that are in the grid."""

    def filled(self, gaps: Iterable[tuple[int, int, float]]) -> NDArray[np.float64]:
        """Return for each row the value of the gap that contains it, (N,); NaN outside all gaps.

        Each gap has a first index, a number of samples and a value. Parts of gaps outside the grid
        are ignored. If gaps overlap, the last gap in `gaps` counts. Each row is written once, even
        if several gaps contain it.
        """
        values = np.full(self.N, np.nan)
        # Tuples (first row, -i, end row, value) of the gaps i, sorted.
        edges: list[tuple[int, int, int, float]] = []
        for i, (k_gap, count, value) in enumerate(gaps):
            begin, end = (min(max(k - self.k_first, 0), self.N) for k in (k_gap, k_gap + count))
            if begin < end:
                edges.append((begin, -i, end, value))
        edges.sort()
        open_gaps: list[tuple[int, int, float]] = []  # a heap; later gaps in `gaps` come first
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
) -> SampleGrid:
    """Return the grid of the samples `k` (n,), which must increase strictly.

    The grid begins with the manifest's `k_first` and ends with the last sample that was due. For a
    complete run, the last sample follows from the number of samples in the manifest. For a stopped
    run, the last sample follows from the numbers of samples in the outcome. If the file is cut off,
    the grid ends with the last sample or gap record. In an older recording, whose manifest has no
    `k_first`, the grid reaches from `k[0]` to `k[-1]`.

    Each gap record has the index of the first missing sample, and the number of missing samples.
    The grid is limited to the indices `between`: the first index, and the index after the last.

    Raises ValueError if a sample is outside the run, or more samples are missing than the limit
    allows.
    """
    begin, end = (int(k[0]), int(k[-1]) + 1) if k.size else (0, 0)
    if manifest.k_first >= 0:
        first = manifest.part_k_first if manifest.part > 1 else manifest.k_first
        last = manifest.k_first + max(manifest.samples, 0)
        if k.size and not (first <= begin and end <= last):
            raise InputError(
                f"its samples are k={begin} to {end - 1}, but the samples of the run are "
                f"k={first} to {last - 1}"
            )
        ends = [end, *(k_gap + count for k_gap, count in gaps), first]
        if outcome is not None:
            is_complete = outcome.code == OutcomeCode.COMPLETE
            ends.append(last if is_complete else first + outcome.samples + outcome.missing)
        begin, end = first, min(max(ends), last)
    begin = max(begin, between[0])
    end = max(min(end, between[1]), begin)
    taken = slice(*np.searchsorted(k, np.array([begin, end], np.uint64)).tolist())
    k = k[taken]
    missing_limit = MISSING_LIMIT + _MISSING_PER_SAMPLE * k.size
    if end - begin - k.size > missing_limit or end - begin > SAMPLES_LIMIT:
        raise InputError(
            f"{end - begin - k.size} of the samples from k={begin} to {end - 1} are missing: too "
            "many for a recording"
        )
    present = np.ones(end - begin, np.bool_)
    if k.size < present.size:
        present[:] = False
        present[(k - np.uint64(begin)).astype(np.intp)] = True
    return SampleGrid(k_first=begin, N=end - begin, present=present, taken=taken)


def check_sampling_time(manifest: Manifest) -> None:
    """Raise DamageError if the sampling time in a manifest is outside the limits."""
    if not TS_LEAST_S <= manifest.Ts < TS_LIMIT_S:
        raise DamageError(
            f"its manifest contains Ts={manifest.Ts!r} s, which must be from 1 µs to below a day"
        )
