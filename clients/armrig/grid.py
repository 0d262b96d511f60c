"""The complete grid of a run's samples: a row for each that was due, whether it came or not."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from armrig_core.manifest import Manifest, Outcome
from numpy.typing import NDArray

# A grid is made for the missing samples, too: a file of two samples must not ask for 10^18 of them.
_MISSING_LIMIT, _MISSING_PER_SAMPLE = 200_000, 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Where the samples that came stand among those that were due."""

    k_first: int
    """Index of the first row."""
    N: int
    """Rows."""
    rows: NDArray[np.intp]
    """Row of each sample that came, rising."""

    @property
    def present(self) -> NDArray[np.bool_]:
        """(N,): the sample came."""
        present = np.zeros(self.N, np.bool_)
        present[self.rows] = True
        return present

    def hole(self, k_first: int, count: int) -> slice:
        """Return the rows of `count` samples from `k_first` on, those outside the grid left out."""
        begin, end = (min(max(k - self.k_first, 0), self.N) for k in (k_first, k_first + count))
        return slice(begin, end)


def grid(
    k: NDArray[np.uint64],
    manifest: Manifest,
    outcome: Outcome | None,
    gaps: Iterable[tuple[int, int]],
) -> Grid:
    """Return the grid of the samples `k` (n,), which rise strictly.

    It begins with the run, at the manifest's `k_first`, and ends with the last sample that was
    due: that of a complete run is the manifest's, a run that was stopped counts its own, and where
    the file was cut off it is the last that is told of. A manifest without `k_first` is older:
    then the grid is from the first sample to the last.

    Parameters
    ----------
    gaps : iterable of (int, int)
        First index and number of the missing samples that were recorded.

    Raises
    ------
    ValueError
        A sample lies outside the run, or far too many are missing.
    """
    begin, end = (int(k[0]), int(k[-1]) + 1) if k.size else (0, 0)
    if manifest.k_first >= 0:
        first, last = manifest.k_first, manifest.k_first + max(manifest.samples, 0)
        if k.size and not (first <= begin and end <= last):
            msg = f"its samples run from k={begin} to {end - 1}, those of the run from {first} to "
            msg += f"{last - 1}"
            raise ValueError(msg)
        told = [end, *(k_gap + count for k_gap, count in gaps), first]
        if outcome is not None:
            whole = outcome.outcome == "complete"
            told.append(last if whole else first + outcome.samples + outcome.missing)
        begin, end = first, min(max(told), last)
    if end - begin - k.size > _MISSING_LIMIT + _MISSING_PER_SAMPLE * k.size:
        msg = f"of the samples from k={begin} to {end - 1} {end - begin - k.size} are missing: too "
        msg += "many for a recording"
        raise ValueError(msg)
    rows = (k - np.uint64(begin)).astype(np.intp) if k.size else np.zeros(0, np.intp)
    return Grid(k_first=begin, N=end - begin, rows=rows)
