"""Merge of several experiments into one Dataset, or into one Signals object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, overload

from armrig_core.calls import checked_call
from armrig_core.errors import InputError, InputTypeError

from armrig.data.dataset import Dataset, merged_datasets
from armrig.data.signals import Signals, merged_signals


@overload
def merge(parts: Sequence[Dataset]) -> Dataset: ...
@overload
def merge(parts: Sequence[Signals]) -> Signals: ...
@checked_call
def merge(parts: Sequence[Any]) -> Dataset | Signals:
    """Return several experiments as one Dataset or Signals object that keeps them separate.

    Parameters
    ----------
    parts : sequence of Dataset or sequence of Signals
        At least one part. Ts, names and units are the same in all parts.

    Returns
    -------
    Dataset or Signals
        All samples in the order given, with the starts of all experiments.

    Raises
    ------
    ValueError
        The sequence is empty, or the parts differ in Ts, names or units.

    Examples
    --------
    >>> import armrig
    >>> first, second, third = armrig.example_recording().dataset("alpha").split(3)
    >>> data = armrig.merge([first, third])
    >>> data.N, data.starts
    (2000, (0, 1000))
    """
    given: Any = parts
    kinds = {type(part) for part in (given if isinstance(given, Sequence) else (None,))}
    if kinds - {Dataset} and kinds - {Signals}:
        raise InputTypeError(
            "merge takes one list of Datasets, merge([d1, d2]), or one list of Signals; for a "
            "recording, give recording.dataset() or recording.signals()"
        )
    if not parts:
        raise InputError("merge needs at least one Dataset, got none")
    return merged_signals(parts) if kinds == {Signals} else merged_datasets(parts)
