"""A study of recordings, told as a document."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from armrig.report.data_facts import treatment
    from armrig.report.document import report

__all__ = ["report", "treatment"]


def __getattr__(name: str) -> Any:
    """Return a public name; only now typst is loaded, which a study does without."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from armrig.report import data_facts, document

    return getattr(data_facts if name == "treatment" else document, name)
