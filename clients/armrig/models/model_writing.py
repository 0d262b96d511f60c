"""Writing of a model as a JSON file, with all digits and the hash of the recording."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from importlib.metadata import version
from math import isfinite
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from armrig.data.step import codes_of
from armrig.models.estimate import Estimate, Start
from armrig.models.structure import FreeResponse

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
    """Return a model as the JSON text of its file."""
    content = {"format": FORMAT, "version": VERSION, "armrig": version("armrig")}
    content |= {f.name: plain(getattr(fit, f.name)) for f in fields(fit) if f.name != "findings"}
    content["treatment"] = codes_of(fit.history)
    content["findings"] = [
        {"about": f.about, "level": f.level, "asks": f.asks, "text": f.text}
        | {"numbers": plain(f.numbers)}
        for f in fit.findings
    ]
    return json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def plain(value: Any) -> Any:
    """Return a value for JSON; a number that is not finite becomes "nan", "inf" or "-inf"."""
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, Start | FreeResponse):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {name: plain(x) for name, x in value.items()}
    if isinstance(value, list | tuple):
        return [plain(x) for x in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not isfinite(value):
        return str(value)
    return value
