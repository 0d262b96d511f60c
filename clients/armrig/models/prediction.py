"""Structure of a model, and checks of the data that are compared with it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.errors import InputError, InputTypeError

from armrig.data.dataset import Dataset, Signals
from armrig.data.finding import OWN_DATA, Finding, warning
from armrig.data.step import span_of
from armrig.models.structure import Structure

if TYPE_CHECKING:
    from armrig.models.fit import Fit


def structure_of(model: Fit) -> Structure:
    """Return the structure of a model; its orders do not count the root of the integrator."""
    inside = {"a": 0, "f": 0, model.integrating: 1}
    return Structure(
        na=model.A.size - 1 - inside["a"],
        nb=(model.B.size - model.nk,),
        nc=model.C.size - 1,
        nd=model.D.size - 1,
        nf=(model.F.size - 1 - inside["f"],),
        nk=(model.nk,),
        integrator=model.integrating,
        offset=model.offset,
    )


def _single(data: Dataset | Signals) -> Dataset:
    return data if isinstance(data, Dataset) else data.dataset()


def require_same_signals(model: Fit, data: Dataset | Signals) -> None:
    """Refuse data that differ from the model in signals, units or sampling time.

    For one input and one output, an empty name matches any name, and an empty unit any unit. The
    names u and y count as empty.
    """
    if (model.ny, model.nu) != (1, 1):
        _require_same_channels(model, data)
        return
    if not isinstance(data, Dataset | Signals):
        raise InputTypeError(
            f"data is a {type(data).__name__}: give a Dataset; for an input, use fit.simulate(u)"
        )
    dataset = _single(data)
    _require_same_Ts(model, dataset.Ts)
    output, input = model.output, model.inputs[0]
    _require_same_signal(
        "output",
        (output, model.unit),
        (dataset.output, dataset.unit),
        f"recording.dataset(output={output!r})",
    )
    _require_same_signal(
        "input",
        (input, model.input_units[0]),
        (dataset.input, dataset.input_unit),
        f"signals.dataset({output!r}, {input!r})",
    )


def _require_same_signal(
    role: str, of_model: tuple[str, str], of_data: tuple[str, str], remedy: str
) -> None:
    """Refuse another name or another unit of the only signal of a role."""
    names, units = (set(pair) for pair in zip(of_model, of_data, strict=True))
    if len(names - {"", "u" if role == "input" else "y"}) > 1 or len(units - {""}) > 1:
        ours, theirs = (f"{name} [{unit or '–'}]" for name, unit in (of_model, of_data))
        raise InputError(
            f"the model's {role} is {ours} and the data contain {theirs}; validate with the "
            f"model's {role}, {remedy}"
        )


def _require_same_channels(model: Fit, data: object) -> None:
    if not isinstance(data, Signals):
        raise InputTypeError(
            f"data is a {type(data).__name__}: give Signals with {', '.join(model.outputs)} and "
            f"{', '.join(model.inputs)}; for inputs alone, use fit.simulate(u)"
        )
    _require_same_Ts(model, data.Ts)
    for side, ours, theirs in (
        ("outputs", model.outputs, data.outputs),
        ("inputs", model.inputs, data.inputs),
    ):
        if ours != theirs:
            raise InputError(
                f"the model's {side} are {', '.join(ours)} and the data have {', '.join(theirs)}; "
                "choose them with signals.channels(outputs, inputs)"
            )


def _require_same_Ts(model: Fit, Ts: float) -> None:
    if model.Ts and not np.isclose(model.Ts, Ts, rtol=1e-9, atol=0.0):
        raise InputError(
            f"the model has Ts={model.Ts:g} s and the data have Ts={Ts:g} s; "
            "identify and validate at the same rate"
        )


def findings_on_own_data(
    models: Iterable[tuple[str, Any]], data: Dataset | Signals
) -> Iterator[Finding]:
    """Yield warnings about models whose estimation data are these data or overlap these data.

    The models are given with their names. A model without estimation data, such as the physical
    model, has no finding.
    """
    named_models = list(models)
    same = [name for name, model in named_models if model.estimated_from(data)]
    if same:
        yield warning("own data", OWN_DATA)
    for name, model in named_models:
        if name not in same and (both := _overlap(model, data)) is not None:
            start, stop = both
            yield warning(
                "overlap",
                f"{name} was also estimated from {start:g} to {stop:g} s of the same file, which "
                "gives too good results: validate on other data",
                start=start,
                stop=stop,
            )


def _overlap(model: Any, data: Dataset | Signals) -> tuple[float, float] | None:
    """Return start and end, in s of the file, of the overlap of a model's data with these data."""
    source = getattr(model, "source", "")
    if not source or source != data.source:
        return None
    ours, theirs = span_of(getattr(model, "history", ())), span_of(data.history)
    if ours is None or theirs is None:
        return None
    start = max(ours[0], theirs[0])
    stop = min(ours[1], theirs[1], theirs[0] + data.N * data.Ts)
    return (start, stop) if stop - start > 0.5 * data.Ts else None
