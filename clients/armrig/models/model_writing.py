"""Writing of a model as a JSON file, with all digits and the hash of the recording."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from importlib.metadata import version
from math import isfinite
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from armrig.data.step import codes_of
from armrig.models.estimate import Minimisation, PastProjection
from armrig.models.matrices import Matrices
from armrig.models.polynomials import Polynomials
from armrig.models.transfer_function import TransferFunction

if TYPE_CHECKING:
    from armrig.models.fit import Fit

FORMAT = "armrig model"
VERSION = 2
"""Version 1 contained the polynomials of one input and one output at its top level."""
FORMS: dict[str, type[Matrices] | type[Polynomials] | type[TransferFunction]] = {
    "matrices": Matrices,
    "polynomials": Polynomials,
    "transfer function": TransferFunction,
}
"""Classes of the parameters, by the names of the classes in a file."""
PARTS: dict[str, type[Minimisation] | type[PastProjection]] = {
    "search": Minimisation,
    "projection": PastProjection,
}
"""Classes of the parts of a model whose fields are at the top level of a file."""


def save_fit(fit: Fit, path: str | PathLike[str]) -> None:
    """Write a model as JSON; raises OSError if the file cannot be written."""
    Path(path).write_text(model_text(fit), encoding="utf-8")


def model_text(fit: Fit) -> str:
    """Return a model as the JSON text of its file."""
    (kind,) = (name for name, form in FORMS.items() if isinstance(fit.form, form))
    content: dict[str, Any] = {"format": FORMAT, "version": VERSION, "armrig": version("armrig")}
    content |= _plain(fit)
    content["form"] = {"kind": kind} | content["form"]
    content["treatment"] = codes_of(fit.history)
    return json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _plain(value: Any) -> Any:
    """Return a value for JSON; a number that is not finite becomes "nan", "inf" or "-inf"."""
    if is_dataclass(value):
        content: dict[str, Any] = {}
        for f in fields(value):
            x = getattr(value, f.name)
            if kind := PARTS.get(f.name):
                content |= _plain(x or kind())  # in a file, its fields are those of the model
            else:
                content[f.name] = _plain(x)
        return content
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {name: _plain(x) for name, x in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(x) for x in value]
    if isinstance(value, float) and not isfinite(value):
        return str(value)
    return value
