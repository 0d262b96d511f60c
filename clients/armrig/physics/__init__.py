"""Equations of the rig: systems, sampled models, numerical integration, and fits to data."""

from __future__ import annotations

from typing import Any

from armrig_core.process.imports import homes, public

__all__ = list(homes(__name__))  # in the stub, `__init__.pyi`


def __getattr__(name: str) -> Any:
    """Return a public object; its module is loaded at the first use."""
    return public(__name__, name)


def __dir__() -> list[str]:
    return __all__
