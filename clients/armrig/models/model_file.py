"""Reading of a model from its JSON file, with all digits of each number."""

from __future__ import annotations

import json
from dataclasses import MISSING, fields
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
from armrig.models.model_writing import FORMAT, VERSION
from armrig.models.structure import FreeResponse
from armrig.models.subspace_fit import SubspaceFit

MAX_BYTES = 1 << 26
"""Largest size of a file, in bytes. The file of a model with 1000 parameters is smaller."""
_KINDS = {"n4sid": SubspaceFit}
_ARRAYS = ("A", "B", "C", "D", "F", "covariance", "covariance_robust")
_SINGULAR = ("singular_values", "canonical_correlations")
_FIGURES = ("noise_variance", "loss", "Ts", "fit_percent", "whiteness")


def load_fit(path: str | PathLike[str]) -> Fit:
    """Return the model in a file that `Fit.save` wrote, with the exact value of each number.

    Raises
    ------
    FileError
        The file contains no model, has another format version, or is damaged.
    OSError
        The file cannot be read.
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
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            several = isinstance(content, dict) and "quality" in content
            raise FileError(
                f"{path} is a model of several signals; here give a model of one output and one "
                "input, such as fit['alpha', 'u'] of it (armrig.load_fit and fit.save in Python)"
                if several
                else f"{path} is no model file; `armrig identify --save` and fit.save(path) write "
                "model files"
            )
        if content.get("version") != VERSION:
            raise FileError(
                f"{path} has format version {content.get('version')!r}, this armrig reads "
                f"{VERSION}; it was written by armrig {content.get('armrig')}"
            )
        fit = _restored(content)
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


def _restored(content: dict[str, Any]) -> Fit:
    kind = _KINDS.get(content["structure"], Fit)
    # Fields that a file of an earlier release lacks keep their defaults.
    known = [f for f in fields(kind) if f.name in content or f.default is MISSING]
    values = {f.name: content[f.name] for f in known}
    arrays = [name for name in (*_ARRAYS, *_SINGULAR) if name in values]
    values |= {name: np.array(_numbers(values[name]), dtype=np.float64) for name in arrays}
    values |= {name: float(values[name]) for name in _FIGURES}
    values["starts"] = tuple(
        Start(**(start | {"loss": float(start["loss"])})) for start in values["starts"]
    )
    values["free"] = tuple(
        FreeResponse(
            transients=tuple(float(x) for x in free["transients"]),
            level=float(free["level"]),
            offset=float(free["offset"]),
        )
        for free in values["free"]
    )
    values["history"] = tuple(map(Step, content["history"], content["treatment"]))
    values["findings"] = tuple(map(_finding, content["findings"]))
    return kind(**values)


def _finding(content: dict[str, Any]) -> EstimateFinding:
    numbers = {name: float(x) for name, x in content["numbers"].items()}
    return EstimateFinding(**(content | {"numbers": numbers}))


def _numbers(values: Any) -> Any:
    return [_numbers(v) for v in values] if isinstance(values, list) else float(values)
