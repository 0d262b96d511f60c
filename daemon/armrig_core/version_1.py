"""What files and daemons of version 1 told by sentences alone, as today's codes.

A file or a reply of today carries a code, and no sentence of it comes here.
"""

from __future__ import annotations

from armrig_core.codes import TRY_AGAIN


def passes(error: str) -> bool:
    """Return whether a refusal of a daemon without codes passes by itself."""
    return error.endswith(TRY_AGAIN)
