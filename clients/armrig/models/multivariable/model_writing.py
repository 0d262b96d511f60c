"""Writing of a model with several inputs and outputs as a JSON file, with all digits."""

from __future__ import annotations

import json
from dataclasses import fields
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from armrig.data.step import codes_of
from armrig.models.model_writing import plain
from armrig.models.multivariable.matrices import Matrices
from armrig.models.multivariable.polynomials import Polynomials

if TYPE_CHECKING:
    from armrig.models.multivariable.fit import MultivariableFit

SEVERAL_FORMAT = "armrig-multivariable-model"
VERSION = 1
FORMS: dict[str, type[Matrices] | type[Polynomials]] = {
    "matrices": Matrices,
    "polynomials": Polynomials,
}
"""Classes of the parameters, by the names of the classes in a file."""
OWN_FIELDS = ("form", "quality", "findings")
"""Fields of a fit that are not plain values."""


def save_fit(fit: MultivariableFit, path: str | PathLike[str]) -> None:
    """Write a model as JSON; `load_fit` reads it.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    Path(path).write_text(model_text(fit), encoding="utf-8")


def model_text(fit: MultivariableFit) -> str:
    """Return a model as the JSON text of its file."""
    content: dict[str, Any] = {
        "format": SEVERAL_FORMAT,
        "version": VERSION,
        "armrig": version("armrig"),
    }
    content |= {
        f.name: plain(getattr(fit, f.name)) for f in fields(fit) if f.name not in OWN_FIELDS
    }
    (kind,) = (name for name, form in FORMS.items() if isinstance(fit.form, form))
    names = [f.name for f in fields(FORMS[kind])]
    content["form"] = {"kind": kind} | {name: plain(getattr(fit.form, name)) for name in names}
    content["quality"] = [
        {"loss": q.loss, "N": q.N, "fit_percent": plain(q.fit_percent)}
        | {"whiteness": plain(q.white.p_value), "whiteness_test": q.white.test}
        for q in fit.quality
    ]
    content["treatment"] = codes_of(fit.history)
    content["findings"] = [
        {"about": f.about, "level": f.level, "asks": f.asks, "text": f.text}
        | {"numbers": plain(f.numbers)}
        for f in fit.findings
    ]
    return json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
