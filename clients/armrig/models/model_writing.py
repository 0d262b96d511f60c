"""A model as a JSON file: every number to its last digit, and the recording that it is of."""

from __future__ import annotations

import json
from dataclasses import fields
from importlib.metadata import version
from math import isfinite
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from armrig.models.estimate import Estimate, Start
from armrig.models.free_response import FreeResponse

FORMAT = "armrig model"
VERSION = 1


def save_fit(fit: Estimate, path: str | PathLike[str]) -> Path:
    """Write a model as JSON and return the path.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    path = Path(path)
    path.write_text(model_text(fit), encoding="utf-8")
    return path


def model_text(fit: Estimate) -> str:
    """Return what the file of a model holds."""
    content = {"format": FORMAT, "version": VERSION, "armrig": version("armrig")}
    content |= {f.name: _plain(getattr(fit, f.name)) for f in fields(fit)}
    return json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _plain(value: Any) -> Any:
    """Return a value as JSON has it; what is not finite as "nan", "inf" or "-inf"."""
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Start | FreeResponse):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, list | tuple):
        return [_plain(x) for x in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not isfinite(value):
        return str(value)
    return value
