"""Reading of a model from its JSON file, with all digits of each number."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import MISSING, fields
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from armrig_core.bounded import read_text
from armrig_core.errors import FileError

from armrig.data.finding import EstimateFinding
from armrig.data.step import Step
from armrig.models.estimate import Form
from armrig.models.fit import Fit
from armrig.models.matrices import Matrices
from armrig.models.model_writing import FORMAT, VERSION
from armrig.models.polynomials import Polynomials
from armrig.models.quality import Start
from armrig.models.structure import FreeResponse
from armrig.numerics.inference import OutputQuality
from armrig.numerics.whiteness import Whiteness

FORMAT_OF_SEVERAL = "armrig-multivariable-model"
"""Format of models of several signals before version 2; its version is 1."""
MAX_BYTES = 1 << 26
"""Largest size of a file, in bytes. The file of a model with 1000 parameters is smaller."""
_COVARIANCES = ("covariance", "covariance_robust", "noise_covariance")
_ARRAYS = (*_COVARIANCES, "singular_values", "canonical_correlations")
_TUPLES = ("inputs", "outputs", "input_units", "units")
_NUMBERS = ("Ts", "curvature")


def load_fit(path: str | PathLike[str]) -> Fit:
    """Return the model in a file that `Fit.save` wrote, with the exact value of each number.

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
    return fit_of(text, str(path))


def fit_of(text: str, path: str) -> Fit:
    """Return the model in the text of a file.

    Parameters
    ----------
    path : str
        Name of the file, for messages.

    Raises
    ------
    FileError
        The text contains no model, has another format version, or is damaged.
    """
    try:
        content = json.loads(text) if text.lstrip().startswith("{") else None
        known = {FORMAT: VERSION, FORMAT_OF_SEVERAL: 1}
        if not isinstance(content, dict) or content.get("format") not in known:
            raise FileError(
                f"{path} is no model file; `armrig identify --save` and fit.save(path) write "
                "model files"
            )
        if not 1 <= content.get("version", 0) <= known[content["format"]]:
            raise FileError(
                f"{path} has format version {content.get('version')!r}, this armrig reads "
                f"{VERSION}; it was written by armrig {content.get('armrig')}"
            )
        fit = _restored(_renewed(content))
        d = fit.theta.size
        if any(c.shape != (d, d) for c in (fit.covariance, fit.covariance_robust)):
            raise FileError(
                f"{path} is a damaged model: it has {d} parameters, and covariances of another "
                "size; save it again"
            )
        repr(fit), fit.poles()  # using a damaged model raises an error
    except FileError:
        raise
    except Exception as err:
        raise FileError(
            f"{path} is a damaged model: {type(err).__name__}: {err}; save it again"
        ) from err
    return fit


def _renewed(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a file of an earlier version as the content of the present version."""
    if content["format"] == FORMAT_OF_SEVERAL:
        quality = [_renewed_quality(q) for q in content["quality"]]
        return content | {"specification": content["orders"], "quality": quality}
    if content["version"] == VERSION:
        return content
    old = content
    form = {"kind": "polynomials", "nk": [[old["nk"]]], "integrators": [old["integrator"]]}
    form |= {name: [[old[name]]] for name in "ABF"} | {name: [old[name]] for name in "CD"}
    return content | {
        "form": form,
        "outputs": [old["output"]],
        "units": [old["unit"]],
        "input_units": [old["input_unit"]],
        "noise_covariance": [[old["noise_variance"]]],
        "quality": [_renewed_quality(old)],
    }


def _renewed_quality(old: Mapping[str, Any]) -> dict[str, Any]:
    white = {"p_value": old["whiteness"], "test": old.get("whiteness_test", "")}
    return {name: old[name] for name in ("loss", "N", "fit_percent")} | {"white": white}


def _restored(content: dict[str, Any]) -> Fit:
    # Fields that a file of an earlier release lacks keep their defaults.
    needed = {f.name for f in fields(Fit) if f.default is f.default_factory is MISSING}
    values = {f.name: content[f.name] for f in fields(Fit) if f.name in {*content, *needed}}
    values |= {name: _array(values[name]) for name in _ARRAYS if name in values}
    values |= {name: tuple(values[name]) for name in _TUPLES if name in values}
    values |= {name: float(values[name]) for name in _NUMBERS if name in values}
    values["output_weights"] = tuple(map(float, values.get("output_weights", ())))
    values["form"] = _form(content["form"])
    values["quality"] = tuple(
        OutputQuality(
            loss=float(q["loss"]),
            N=q["N"],
            fit_percent=float(q["fit_percent"]),
            white=Whiteness(p_value=float(q["white"]["p_value"]), test=q["white"]["test"]),
        )
        for q in content["quality"]
    )
    values["starts"] = tuple(
        Start(**(start | {"loss": float(start["loss"])})) for start in content["starts"]
    )
    values["free"] = tuple(
        FreeResponse(
            transients=tuple(float(x) for x in free["transients"]),
            level=float(free["level"]),
            offset=float(free["offset"]),
        )
        for free in content.get("free", ())
    )
    steps = zip(content["history"], content["treatment"], strict=True)
    values["history"] = tuple(Step(text, code) for text, code in steps)
    values["findings"] = tuple(
        EstimateFinding(**(f | {"numbers": {k: float(x) for k, x in f["numbers"].items()}}))
        for f in content["findings"]
    )
    return Fit(**values)


def _form(content: dict[str, Any]) -> Form:
    if content["kind"] == "matrices":
        matrices = {name: _array(content[name]) for name in "ABCDK"}
        return Matrices(**matrices, nk=tuple(content["nk"]))
    rows = {name: tuple(tuple(map(_array, row)) for row in content[name]) for name in "ABF"}
    return Polynomials(
        A=rows["A"],
        B=rows["B"],
        C=tuple(map(_array, content["C"])),
        D=tuple(map(_array, content["D"])),
        F=rows["F"],
        nk=tuple(tuple(row) for row in content["nk"]),
        integrators=tuple(content["integrators"]),
    )


def _array(values: Any) -> Any:
    return np.array(_numbers(values), dtype=np.float64)


def _numbers(values: Any) -> Any:
    return [_numbers(v) for v in values] if isinstance(values, list) else float(values)
