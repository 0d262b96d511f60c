"""Clients of a rig's daemon."""

from __future__ import annotations

from typing import Any

from armrig_core.process.imports import homes, public

__all__ = list(homes(__name__))  # in the stub, `__init__.pyi`


def __getattr__(name: str) -> Any:
    """Return the object of a public name; only the first use of a name loads zenoh."""
    return public(__name__, name)
