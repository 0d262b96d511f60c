"""Study of recordings, and its report as a document."""

from __future__ import annotations

from typing import Any

from armrig_core.process.imports import homes, public

__all__ = list(homes(__name__))  # in the stub, `__init__.pyi`


def __getattr__(name: str) -> Any:
    """Return a public object; load typst only now, because a study does not need typst."""
    return public(__name__, name)
