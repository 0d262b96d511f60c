"""Findings about models that are validated on their own estimation data."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Protocol

from armrig.data.finding import OWN_DATA, EstimateFinding, warning
from armrig.data.step import span_of


class HasHistory(Protocol):
    """Data with their source and their treatment."""

    @property
    def source(self) -> str:
        """Hash of the file, or ""."""

    @property
    def history(self) -> tuple[str, ...]:
        """Steps of the treatment."""

    @property
    def Ts(self) -> float | None:
        """Sampling time, in s."""

    @property
    def N(self) -> int:
        """Number of samples."""


def findings_on_own_data(
    models: Iterable[tuple[str, Any]], data: HasHistory
) -> Iterator[EstimateFinding]:
    """Yield warnings about models whose estimation data are these data or overlap these data.

    Parameters
    ----------
    models : iterable of (str, model)
        Models with their names. A model without estimation data, such as the physical model, has no
        finding.
    """
    named = list(models)
    same = [name for name, model in named if model.estimated_from(data)]
    if same:
        yield warning("own data", OWN_DATA)
    for name, model in named:
        if name not in same and (both := overlap(model, data)) is not None:
            start, stop = both
            yield warning(
                "overlap",
                f"{name} was also estimated from {start:g} to {stop:g} s of the same file, which "
                "gives too good results: validate on other data",
                start=start,
                stop=stop,
            )


def overlap(model: Any, data: HasHistory) -> tuple[float, float] | None:
    """Return start and end, in s, of the overlap of a model's estimation data with these data.

    The times are relative to the first sample of the file. The result is None if there is no
    overlap. The result is also None if the data are from different files, or if one of the data
    sets contains several merged parts.
    """
    source = getattr(model, "source", "")
    if not source or source != data.source or data.Ts is None:
        return None
    ours, theirs = span_of(getattr(model, "history", ())), span_of(data.history)
    if ours is None or theirs is None:
        return None
    start = max(ours[0], theirs[0])
    stop = min(ours[1], theirs[1], theirs[0] + data.N * data.Ts)
    return (start, stop) if stop - start > 0.5 * data.Ts else None
