"""Merge of several experiments into one Dataset, or into one Signals object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, overload

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from armrig_core.process.calls import with_argument_checks

from armrig.data.dataset import Dataset, Signals
from armrig.data.experiments import Trend
from armrig.data.step import Step, codes_of, in_merged
from armrig.numerics.quantities import plural

_MAX_LISTED_LENGTHS = 8  # of merged parts, in a history
_SAME = ("Ts", "outputs", "inputs", "units", "input_units", "intersample", "input_scales")
"""Fields that are the same in all merged parts."""


@overload
def merge(parts: Sequence[Dataset]) -> Dataset: ...
@overload
def merge(parts: Sequence[Signals]) -> Signals: ...
@with_argument_checks
def merge(parts: Sequence[Any]) -> Dataset | Signals:
    """Return several experiments as one Dataset or Signals object that keeps them separate.

    Parameters
    ----------
    parts : sequence of Dataset or sequence of Signals
        At least one part. Ts, names and units are the same in all parts.

    Returns
    -------
    Dataset or Signals
        All samples in the order given, with the starts and the trends of all experiments. The
        reference r is kept if all parts have one.

    Raises
    ------
    ValueError
        The sequence is empty, or the parts differ in Ts, names or units.

    Examples
    --------
    >>> first, second, third = armrig.example_recording().dataset("alpha").split(3)
    >>> data = armrig.merge([first, third])
    >>> data.N, data.starts
    (2000, (0, 1000))
    """
    sequence: Any = parts
    kinds = {type(part) for part in (sequence if isinstance(sequence, Sequence) else (None,))}
    if len(kinds) > 1 or kinds - {Dataset, Signals}:
        raise InputTypeError(
            "merge takes one list of Datasets, merge([d1, d2]), or one list of Signals; for a "
            "recording, give recording.dataset() or recording.signals()"
        )
    if not parts:
        raise InputError("merge needs at least one Dataset, got none")
    each: list[Signals] = [data.signals() for data in parts]
    for name in _SAME:
        values = {getattr(data, name) for data in each}
        if len(values) > 1:
            raise InputError(
                f"merge needs the same {name} in all data, got {sorted(values, key=str)}; apply "
                "the same treatment to all before merging"
            )
    trends = [t for data in each for t in data.trends or [Trend() for _ in data.starts]]
    references = [data.r for data in each if data.r is not None]
    offsets = np.cumsum([0, *(data.N for data in each[:-1])])
    merged = each[0].replaced(
        step=None,
        u=np.concatenate([data.u for data in each]),
        y=np.concatenate([data.y for data in each]),
        valid=np.concatenate([data.valid for data in each]),
        r=np.concatenate(references) if len(references) == len(each) else None,
        starts=[int(o) + s for o, data in zip(offsets, each, strict=True) for s in data.starts],
        source="+".join(dict.fromkeys(data.source for data in each if data.source)),
        history=_merge_history(each),
        trends=trends if any(data.trends for data in each) else [],
    )
    return merged if kinds == {Signals} else merged.dataset()


def _merge_history(parts: Sequence[Signals]) -> tuple[str, ...]:
    """Return the history of merged data: common steps, then steps of each part, then the merge."""
    if len(parts) == 1:
        return parts[0].history
    common: list[str] = []
    for steps in zip(*(data.history for data in parts), strict=False):
        if len(set(steps)) > 1:
            break
        common.append(steps[0])
    part_steps = [
        Step(f"part {i}: {step}", in_merged(code))
        for i, data in enumerate(parts, 1)
        for step, code in list(zip(data.history, codes_of(data.history), strict=True))[
            len(common) :
        ]
    ]
    lengths = ", ".join(str(data.N) for data in parts[:_MAX_LISTED_LENGTHS])
    lengths += ", …" if len(parts) > _MAX_LISTED_LENGTHS else ""
    return (*common, *part_steps, f"merged {plural(len(parts), 'part')} of {lengths} samples")
