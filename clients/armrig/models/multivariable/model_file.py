"""Reading of a model, with one or several inputs and outputs, from its JSON file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from armrig_core.bounded import read_text
from armrig_core.errors import FileError

from armrig.data.finding import EstimateFinding
from armrig.data.step import Step
from armrig.models.estimate import Start
from armrig.models.fit import Fit
from armrig.models.model_file import MAX_BYTES, fit_of
from armrig.models.multivariable.fit import Form, MultivariableFit
from armrig.models.multivariable.matrices import Matrices
from armrig.models.multivariable.model_writing import OWN_FIELDS, SEVERAL_FORMAT, VERSION
from armrig.models.multivariable.polynomials import Polynomials
from armrig.numerics.inference import OutputQuality
from armrig.numerics.whiteness import Whiteness

_ARRAYS = ("covariance", "covariance_robust", "noise_covariance")
_TEXTS = ("inputs", "outputs", "input_units", "units")


def load_fit(path: str | PathLike[str]) -> Fit | MultivariableFit:
    """Return the model in a file that `fit.save` wrote, with the exact value of each number.

    Returns
    -------
    Fit or MultivariableFit
        A `Fit`, or a `MultivariableFit` for a model of several inputs or outputs.

    Raises
    ------
    FileError
        The file contains no model, has another format version, or is damaged.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> import armrig
    >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
    >>> fit.save("alpha.json")
    >>> loaded = armrig.load_fit("alpha.json")
    >>> loaded.heading, bool((loaded.theta == fit.theta).all())
    ('OE(nb=3, nf=3, nk=1)', True)
    """
    path = Path(path)
    try:
        text = read_text(path, MAX_BYTES)
    except FileError as err:
        raise FileError(
            f"{path}: {err}; a model is what `armrig identify --save` and fit.save(path) write"
        ) from err
    try:
        content = json.loads(text) if text.lstrip().startswith("{") else None
    except ValueError:
        content = None
    if not isinstance(content, dict) or content.get("format") != SEVERAL_FORMAT:
        return fit_of(text, str(path))
    if content.get("version") != VERSION:
        raise FileError(
            f"{path} has format version {content.get('version')!r}, this armrig reads {VERSION}; "
            f"it was written by armrig {content.get('armrig')}"
        )
    try:
        fit = _restored(content)
        repr(fit)  # using a damaged model raises an error
    except Exception as err:
        raise FileError(
            f"{path} is a damaged model: {type(err).__name__}: {err}; save it again"
        ) from err
    return fit


def _restored(content: dict[str, Any]) -> MultivariableFit:
    values = {f.name: content[f.name] for f in fields(MultivariableFit) if f.name not in OWN_FIELDS}
    values |= {name: np.array(_numbers(values[name]), dtype=np.float64) for name in _ARRAYS}
    values |= {name: tuple(values[name]) for name in _TEXTS}
    values["starts"] = tuple(
        Start(**(start | {"loss": float(start["loss"])})) for start in values["starts"]
    )
    values["output_weights"] = tuple(map(float, values["output_weights"]))
    steps = zip(content["history"], content["treatment"], strict=True)
    values["history"] = tuple(Step(text, code) for text, code in steps)
    values["form"] = _form(content["form"])
    values["quality"] = tuple(_qualities(content))
    values["findings"] = tuple(
        EstimateFinding(**(f | {"numbers": {k: float(x) for k, x in f["numbers"].items()}}))
        for f in content["findings"]
    )
    fit = MultivariableFit(**values)
    shape = (fit.theta.size,) * 2
    if (fit.covariance.shape, fit.covariance_robust.shape) != (shape, shape):
        raise ValueError(f"it has {fit.theta.size} parameters, and covariances of another size")
    return fit


def _form(content: dict[str, Any]) -> Form:
    values = {name: x for name, x in content.items() if name != "kind"}
    if content["kind"] == "matrices":
        arrays = {name: np.array(_numbers(values[name])) for name in "ABCDK"}
        return Matrices(**arrays, nk=tuple(values["nk"]))
    rows = {name: tuple(tuple(map(_vector, row)) for row in values[name]) for name in "ABF"}
    return Polynomials(
        A=rows["A"],
        B=rows["B"],
        C=tuple(map(_vector, values["C"])),
        D=tuple(map(_vector, values["D"])),
        F=rows["F"],
        nk=tuple(tuple(row) for row in values["nk"]),
        integrators=tuple(values["integrators"]),
    )


def _qualities(content: dict[str, Any]) -> Iterator[OutputQuality]:
    for q in content["quality"]:
        white = Whiteness(p_value=float(q["whiteness"]), test=q["whiteness_test"])
        yield OutputQuality(
            loss=float(q["loss"]), N=q["N"], fit_percent=float(q["fit_percent"]), white=white
        )


def _vector(values: list[Any]) -> Any:
    return np.array(_numbers(values), dtype=np.float64)


def _numbers(values: Any) -> Any:
    return [_numbers(v) for v in values] if isinstance(values, list) else float(values)
