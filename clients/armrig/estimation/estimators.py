"""The estimators by the names of their structures."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from armrig.models.fit import Fit
from armrig.models.structure_table import KINDS

ESTIMATORS: dict[str, Callable[..., Fit]] = {
    name: getattr(import_module(f"armrig.estimation.{name}"), name) for name in KINDS
}
