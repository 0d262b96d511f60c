"""Part of data between two times."""

from __future__ import annotations

from math import ceil

from armrig_core.errors import InputError

from armrig.data.dataset import Dataset, Signals


def between(data: Dataset | Signals, start: float | None, stop: float | None) -> Dataset | Signals:
    """Return the samples with start <= t < stop, in s from the first sample."""
    part = sample_range(data, start, stop)
    return data if (start, stop) == (None, None) else data[part]


def sample_range(data: Dataset | Signals, start: float | None, stop: float | None) -> slice:
    """Return the range of the samples with start <= t < stop; refuse an empty range."""
    Ts = data.Ts or 1.0
    first, end = (None if t is None else ceil(min(t / Ts, data.N) - 1e-6) for t in (start, stop))
    if (start or 0) < 0 or (first or 0) >= (data.N if end is None else min(end, data.N)):
        msg = f"no samples from --from {start or 0:g} s on"
        msg += f" to --to {stop:g} s" if stop is not None else ""
        raise InputError(f"{msg}: the data last {data.N * Ts:g} s")
    return slice(first, end)
