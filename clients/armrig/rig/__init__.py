"""Clients of a rig's daemon."""

from __future__ import annotations

from typing import Any

from armrig_core.public_names import homes, public

__all__ = list(homes(__name__))  # in the stub, `__init__.pyi`


def __getattr__(name: str) -> Any:
    """Return a public name; zenoh is loaded only when a name is used."""
    return public(__name__, name)
