"""Reading of a model from its JSON file, with all digits of each number."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import MISSING, fields
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any, get_type_hints

import msgspec
import numpy as np
from armrig_core.errors import FileError
from armrig_core.process.bounded import read_text

from armrig.data.step import Step
from armrig.models.fit import Fit
from armrig.models.matrices import Matrices
from armrig.models.model_writing import FORMAT, FORMS, PARTS, VERSION
from armrig.numerics.quantities import plural

FORMAT_OF_SEVERAL = "armrig-multivariable-model"
"""Format of models of several signals before version 2; its version is 1."""
MAX_BYTES = 1 << 26
"""Largest size of a file, in bytes. The file of a model with 1000 parameters is smaller."""


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
    """Return the model in the text of a file, as `load_fit`; messages name the file by `path`."""
    try:
        content = json.loads(text) if text.lstrip().startswith("{") else None
        latest_versions = {FORMAT: VERSION, FORMAT_OF_SEVERAL: 1}
        if not isinstance(content, dict) or content.get("format") not in latest_versions:
            raise FileError(
                f"{path} is no model file; `armrig identify --save` and fit.save(path) write "
                "model files"
            )
        if content.get("version") not in range(1, latest_versions[content["format"]] + 1):
            raise FileError(
                f"{path} has format version {content.get('version')!r}, this armrig reads "
                f"{VERSION}; it was written by armrig {content.get('armrig')}"
            )
        # Release 0.2.0 called the remedy "asks".
        findings = [
            {"remedy": x.get("asks", "")} | x if isinstance(x, dict) else x
            for x in content["findings"]
        ]
        fit = _build_fit(_upgrade_content(content) | {"findings": findings})
        if fault := _fault(fit):
            raise _damage_error(path, fault)
        repr(fit), fit.poles()  # using a damaged model raises an error
    except FileError:
        raise
    except json.JSONDecodeError as err:
        raise _damage_error(path, f"line {err.lineno} is not JSON: {err.msg}") from err
    except KeyError as err:
        raise _damage_error(path, f"{err.args[0]} is missing") from err
    except msgspec.ValidationError as err:
        raise _damage_error(path, str(err)) from err
    except Exception as err:
        raise _damage_error(path, f"its fields do not match each other: {err}") from err
    return fit


def _fault(fit: Fit) -> str:
    """Return what is wrong with the numbers of a model; "" if nothing is."""
    d, form = fit.theta.size, fit.form
    if any(c.shape != (d, d) for c in (fit.covariance, fit.covariance_robust)):
        return f"it has {plural(d, 'parameter')}, and covariances of another size"
    if not (np.isfinite(fit.theta).all() and 0 <= fit.Ts < np.inf):
        return "a parameter or Ts is no finite number"
    Lambda = fit.noise_covariance
    if Lambda.shape != (fit.ny, fit.ny) or not (Lambda.diagonal() >= 0).all():
        return f"noise_covariance does not have {fit.ny} variances"
    if isinstance(form, Matrices):
        return ""
    of_y = [p for i, row in enumerate(form.A) for p in row[i : i + 1]]
    if not all(p.size and p[0] == 1 for p in (*of_y, *form.C, *form.D, *chain(*form.F))):
        return "a polynomial A, C, D or F does not begin with 1"
    early = (
        p[:k]
        for row, delays in zip(form.B, form.nk, strict=True)
        for p, k in zip(row, delays, strict=True)
    )
    return "B has coefficients before the lag nk" if any(p.any() for p in early) else ""


def _damage_error(path: str, fault: str) -> FileError:
    return FileError(
        f"{path} is a damaged model: {fault}; save the model again with fit.save(path), or "
        "estimate it again with `armrig identify --save`"
    )


def _upgrade_content(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a file of an earlier version as the content of the present version."""
    if content["format"] == FORMAT_OF_SEVERAL:
        quality = [_upgrade_quality(q) for q in content["quality"]]
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
        "quality": [_upgrade_quality(old)],
    }


def _upgrade_quality(old: Mapping[str, Any]) -> dict[str, Any]:
    white = {"p_value": old["whiteness"], "test": old.get("whiteness_test", "")}
    return {name: old[name] for name in ("loss", "N", "fit_percent")} | {"white": white}


def _build_fit(content: dict[str, Any]) -> Fit:
    form = content["form"]
    kind = form.get("kind") if isinstance(form, dict) else form
    if kind not in FORMS:
        raise msgspec.ValidationError(f"form: Expected the kind {' or '.join(FORMS)}, got {kind!r}")
    hints = get_type_hints(Fit) | {"form": FORMS[kind]}
    # Fields that a file of an earlier release lacks keep their defaults.
    needed = {f.name for f in fields(Fit) if f.default is f.default_factory is MISSING}
    needed |= {"history", "findings"}
    values = {
        f.name: _value(f.name, content[f.name], hints[f.name])
        for f in fields(Fit)
        if f.name not in PARTS and f.name in {*content, *needed}
    }
    values |= {name: _part(part, content) for name, part in PARTS.items()}
    if not values["projection"].horizon:
        values["projection"] = None
    steps = zip(values["history"], content["treatment"], strict=True)
    values["history"] = tuple(Step(text, code) for text, code in steps)
    return Fit(**values)


def _part(kind: type[Any], content: dict[str, Any]) -> Any:
    """Return a part of a model, whose fields are at the top level of a file."""
    hints = get_type_hints(kind)
    names = [f.name for f in fields(kind) if f.name in content or f.name == "starts"]
    return kind(**{name: _value(name, content[name], hints[name]) for name in names})


def _value(name: str, content: Any, kind: Any) -> Any:
    """Return a field of a model from its JSON, in which "nan", "inf" and "-inf" are numbers."""
    try:
        return msgspec.convert(content, kind, strict=False, dec_hook=_array)
    except msgspec.ValidationError as err:
        raise msgspec.ValidationError(f"{name}: {err}") from err


def _array(_: type[Any], content: Any) -> Any:
    """Return nested lists of numbers as an array."""
    return np.array(_numbers(content), dtype=np.float64)


def _numbers(content: Any) -> Any:
    return [_numbers(x) for x in content] if isinstance(content, list) else float(content)
